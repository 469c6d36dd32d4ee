"""Conflict zones: where two objects' motions exclude each other, and who passes first.

For two motions the *obstacle* is the set of cell pairs in which the swept footprints, with the
margin, are not shown to be apart (conservative, :mod:`up_samp.motion.fleet.conflicts`). The plan
is a monotone curve that passes each connected component of it on one side; all curves that pass
every component on the same side as the plan are one homotopy class, and the sides say who has
priority (Gregoire, Bonnabel & de La Fortelle, "Priority-based coordination of robots", 2014, and
"Robust multirobot coordination using priority encoded homotopic constraints", 2013).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from up_samp.execution.graph import MEETING, At, Edge, Event, Narrow
from up_samp.execution.lives import DriveCells, Life, Piece, Stay, concerned, errors_of, pairs_of
from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.fleet.conflicts import Swept, conflicting_cells
from up_samp.motion.fleet.paths import Path, hull_of, through_zones

Component = tuple[str, str, int]
"""A component of two objects' obstacle: (one, other, number)."""

Key = Component | int
"""What may be one way or the other: a component, by whether its ``one`` goes first, or a choice by
its number, by whether it is as planned.
"""


EFFORTS = (
    (0, 1.0, 1.0),
    (1, 1.0, 1.0),
    (1, 0.5, 1.0),
    (0, 0.0, 1.0),
    (1, 0.0, 1.0),
    (2, 0.0, 0.5),
    (3, 0.0, 0.25),
    (4, 0.0, 0.1),
    (5, 0.0, 0.0),
)
"""(Halvings of the cells, share of what reports may be wrong by, share of the margin) until the
plan is seen to pass the obstacle."""


@dataclass(frozen=True, eq=False)
class Meeting:
    """The obstacle of two pieces ``a`` of ``one`` and ``b`` of ``other`` (cells from 0).

    ``rows`` (n, 3) are (cell of a, first cell of b, last cell of b); ``one_first`` (n,) says
    whether the plan lets ``a`` leave its cell before ``b`` enters; ``component`` (n,) numbers the
    connected components of the two lives' whole obstacle.
    """

    one: Life
    k: int
    other: Life
    m: int
    path_a: Path
    path_b: Path
    rows: IntArray
    one_first: BoolArray
    margin: float
    component: IntArray
    wanted: float
    """The margin that should be kept; ``margin`` is the one that is."""
    met: BoolArray
    """(n,) whether the plan's times let both be there, see ``leaving`` in :func:`meetings_of`."""
    memo: dict[tuple[object, object], object] = field(default_factory=dict)
    """Steps, once they were asked for: of components by their sides, and of what is left."""

    @cached_property
    def components(self) -> tuple[int, ...]:
        """The numbers of the components that it is part of."""
        return tuple(sorted({int(c) for c in self.component}))

    @property
    def pair(self) -> tuple[str, str]:
        """The names of the two objects."""
        return self.one.object, self.other.object

    @property
    def keys(self) -> frozenset[Key]:
        """The components that it is part of."""
        return frozenset((*self.pair, c) for c in self.components)

    @property
    def activities(self) -> frozenset[str]:
        """The activities in which its pieces are driven."""
        return frozenset({self.a.activity, self.b.activity} - {""})

    @property
    def untimed(self) -> dict[Key, bool]:
        """The components that the plan's times do not order, and whether ``one`` goes first."""
        met = zip(self.component[self.met], self.one_first[self.met], strict=True)
        return {(*self.pair, int(c)): bool(first) for c, first in met}

    @property
    def a(self) -> Piece:
        """The piece of ``one``."""
        return self.one.pieces[self.k]

    @property
    def b(self) -> Piece:
        """The piece of ``other``."""
        return self.other.pieces[self.m]


def narrow_places(meetings: Iterable[Meeting], margin: float) -> tuple[Narrow, ...]:
    """Return where meetings do not keep the margin (m) that they should; ``margin`` is the one that
    was asked for.
    """
    rounding = min(margin, TOLERANCES.margin)
    found: dict[tuple[tuple[str, str], tuple[str, str]], Narrow] = {}
    for meeting in meetings:
        if meeting.margin >= meeting.wanted:
            continue
        movers = bool(meeting.one.drives) + bool(meeting.other.drives)
        path_a, path_b = meeting.a.path, meeting.b.path
        cell = _runs(path_a, path_b, meeting.wanted)[0, 0]
        x, y = path_a.poses_at(path_a.edges[cell : cell + 1])[0][:2]
        kept = max(0.0, meeting.margin - rounding) / movers
        key = meeting.pair, (meeting.a.activity, meeting.b.activity)
        if key not in found or kept < found[key].kept:
            found[key] = Narrow(*key, (float(x), float(y)), kept)
    return tuple(found.values())


def meetings_of(
    lives: Mapping[str, Life],
    margin: float = TOLERANCES.margin,
    localisation: float = 0.0,
    leaving: Container[str] = (),
) -> list[Meeting]:
    """Return all meetings of different objects; :class:`ProblemError` where the plan collides.

    Bodies that are told to be so much apart may be nearer, by ``localisation`` (m), or by its own
    error, for each of the two that drives. Where the margin (m) is less than that and rounding
    (``TOLERANCES.margin``), it grows to it, where the plan keeps so much; less where it does not
    (see :attr:`Meeting.wanted`). A meeting without rows is one that only the grown margin has.
    ``leaving``: activities of which it is not known when they begin: who comes to where somebody
    rests until then comes later than that one, and waits until it has gone.
    """
    found, errors = [], errors_of(lives, localisation)
    for pair in pairs_of(lives):
        apart = sum(errors[life.object] for life in pair if life.drives)
        found += _numbered(_pair(*pair, margin, apart, leaving))
    return found


def _pair(
    one: Life, other: Life, margin: float, apart: float, leaving: Container[str]
) -> list[Meeting]:
    p, q = one.boxes, other.boxes
    grown = max(0.0, min(margin, TOLERANCES.margin) + apart - margin)
    margins = margin, grown
    margin += grown
    near = (
        (p[:, None, 0] <= q[None, :, 2] + margin)
        & (q[None, :, 0] <= p[:, None, 2] + margin)
        & (p[:, None, 1] <= q[None, :, 3] + margin)
        & (q[None, :, 1] <= p[:, None, 3] + margin)
    )
    found = []
    for k, m in np.argwhere(near):
        if not concerned(one, int(k), other, int(m)):
            continue
        rests = _left_by(one, int(k), leaving), _left_by(other, int(m), leaving)
        meeting = _meeting(one, int(k), other, int(m), margins, rests)
        if meeting is not None:
            found.append(meeting)
    return found


def _left_by(life: Life, k: int, leaving: Container[str]) -> bool:
    """Return whether a piece is a rest that ends when one of some activities begins."""
    drives = any(after.activity in leaving for after in life.pieces[k + 1 : k + 2])
    return drives and isinstance(life.pieces[k], Stay)


def _meeting(
    one: Life,
    k: int,
    other: Life,
    m: int,
    margins: tuple[float, float],
    rests: tuple[bool, bool],
) -> Meeting | None:
    a, b = one.pieces[k], other.pieces[m]
    wanted = sum(margins)
    for level, grown, share in EFFORTS:
        if grown and not margins[1]:
            continue
        margin = margins[0] * share + margins[1] * grown
        path_a, path_b = a.cut(level), b.cut(level)
        rows = _runs(path_a, path_b, margin)
        if len(rows) == 0 and margin >= wanted:
            return None
        enter_a, leave_a = a.of_cells(path_a)
        enter_b, leave_b = b.of_cells(path_b)
        first = leave_a[rows[:, 0]] <= enter_b[rows[:, 1]] + TOLERANCES.late
        last = leave_b[rows[:, 2]] <= enter_a[rows[:, 0]] + TOLERANCES.late
        met, came = ~(first | last), (enter_a[rows[:, 0]], enter_b[rows[:, 1]])
        known = rests[0] & (came[0] < came[1]) | rests[1] & (came[1] < came[0])
        if np.all(known | ~met):
            first |= met & (came[0] < came[1])
            nothing = np.zeros(len(rows), dtype=np.int64)
            return Meeting(
                one, k, other, m, path_a, path_b, rows, first, margin, nothing, wanted, met
            )
    at = float(enter_a[rows[np.argmax(met), 0]])
    raise ProblemError(
        f"the plan lets '{one.object}' and '{other.object}' meet at about {at:.2f} s "
        f"({a.activity or 'resting'}; {b.activity or 'resting'}): no order of them can be kept"
    )


def _runs(path_a: Path, path_b: Path, margin: float) -> IntArray:
    rows = np.asarray(conflicting_cells(moving(path_a), moving(path_b), margin))
    # cells of paths alone are counted from 0, rests are none of them
    one, other = (p.entries[1 : max(2, p.cells + 1)] - 1 for p in (path_a, path_b))
    return through_zones(rows, one, other)


def moving(path: Path) -> Swept:
    """Return what a path sweeps without its rests: these are pieces of their own. (The table of a
    rest has only rests.)
    """
    table = path.swept.table[1:-1] if path.cells else path.swept.table[:1]
    return Swept(np.ascontiguousarray(table), path.hull)


def _numbered(meetings: list[Meeting]) -> list[Meeting]:
    """Number the connected components of one pair's obstacle (cells touching at corners, too)."""
    if not meetings:
        return []
    from scipy.sparse import coo_matrix  # a tenth of a second, for those who execute alone
    from scipy.sparse.csgraph import connected_components

    spans = _on_lives(meetings)
    order = np.lexsort((spans[:, 2], spans[:, 0]))
    # rows of neighbouring strips are connected where they touch: a sweep from low to high
    touching = []
    for place, i in enumerate(order):
        for j in order[place + 1 :]:
            if spans[j, 0] > spans[i, 1] + 1e-9:
                break
            if spans[j, 2] <= spans[i, 3] + 1e-9 and spans[i, 2] <= spans[j, 3] + 1e-9:
                touching.append((i, j))
    count = len(spans)
    one, other = np.array(touching, dtype=np.int64).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    numbers = connected_components(graph, directed=False)[1]
    found, at = [], 0
    for meeting in meetings:
        part = numbers[at : at + len(meeting.rows)]
        at += len(meeting.rows)
        found.append(replace(meeting, component=part, memo={}))
    return found


def _on_lives(meetings: list[Meeting]) -> FloatArray:
    """Return all rows as (low, high, low, high): piece number plus share, of both lives."""
    parts = []
    for meeting in meetings:
        n, m = max(1, meeting.path_a.cells), max(1, meeting.path_b.cells)
        rows = meeting.rows
        parts.append(
            np.stack(
                [
                    meeting.k + rows[:, 0] / n,
                    meeting.k + (rows[:, 0] + 1) / n,
                    meeting.m + rows[:, 1] / m,
                    meeting.m + (rows[:, 2] + 1) / m,
                ],
                axis=1,
            )
        )
    return np.concatenate(parts)


# ------------------ From obstacles to staircases
# "This robot may go beyond there once that one has come to here".


def steps_of(meeting: Meeting, *, without: Container[int] = ()) -> list[Edge]:
    """Return the steps of a meeting on the side on which the plan passes it: leaving a point (or a
    change) waits for reaching one (or a change).

    Steps less than half of the body's radius apart are joined where the plan allows: the later exit
    is waited for at the earlier entry. Components ``without`` are left out.
    """
    left_out = tuple(c for c in meeting.components if c in without)
    key = ("planned", left_out)
    if key not in meeting.memo:
        wanted = ~np.isin(meeting.component, left_out)
        found = list(_side(meeting, meeting.one_first & wanted, True))
        found += _side(meeting, ~meeting.one_first & wanted, False)
        meeting.memo[key] = found
    return list(cast("list[Edge]", meeting.memo[key]))


def switched(meeting: Meeting, component: int, one_first: bool) -> list[Edge]:
    """Return the steps of one component on the given side, whatever the plan does."""
    key = (component, one_first)
    if key not in meeting.memo:
        chosen = meeting.component == component
        meeting.memo[key] = list(_side(meeting, chosen, one_first, planned=False))
    return list(cast("list[Edge]", meeting.memo[key]))


def _side(
    meeting: Meeting,
    chosen: BoolArray,
    one_first: bool,
    *,
    planned: bool = True,
) -> Iterator[Edge]:
    """Yield the edges of ``chosen`` pairs of cells where one of the two (or the other) is first:
    the second one may go beyond its gate as soon as (lag 0) the first one has come out.
    """
    rows = meeting.rows[chosen]
    if len(rows) == 0:
        return
    if one_first:
        # other's cell j0 is entered after one has left cell i
        exits, entries = rows[:, 0], rows[:, 1]
        life, leaver, p = meeting.one, meeting.a, meeting.path_a
        follower, enterer, q = meeting.other, meeting.b, meeting.path_b
    else:
        exits, entries = rows[:, 2], rows[:, 0]
        life, leaver, p = meeting.other, meeting.b, meeting.path_b
        follower, enterer, q = meeting.one, meeting.a, meeting.path_a
    steps = _corners(exits, entries)
    out_times = leaver.of_cells(p)[1]
    in_times = enterer.of_cells(q)[0]
    reach = 0.5 * min(hull_of(one.body).radius for one in (life, follower))
    allowed = in_times if planned else np.full(len(in_times), np.inf)
    pairs = []
    for gone, entered in _joined(steps, p, out_times, allowed, reach):
        first, then = _exit(leaver, p, gone), _entry(enterer, q, entered)
        if first is not None and then is not None:
            pairs.append((gone, entered, first, then))
    if not pairs:
        return
    cells = [entered for _, entered, _, _ in pairs]
    where = q.poses_at(q.edges[cells]) if q.cells else np.repeat(q.poses[:1], len(pairs), axis=0)
    begun = in_times[cells]
    if planned and isinstance(enterer, DriveCells):
        begun = enterer.left(np.array([then.progress for *_, then in pairs]))
    for (gone, _, first, then), (x, y, _), begins in zip(pairs, where, begun, strict=True):
        if planned and out_times[gone] > begins + 2 * TOLERANCES.late:
            raise UnsupportedError(
                f"'{follower.object}' cannot stop on its way, but the plan lets it begin before "
                f"{first}: no executive could hold it back"
            )
        who = f"{meeting.one.object} and {meeting.other.object}"
        yield Edge(first, then, 0.0, MEETING, f"{who} would meet near ({x:.1f}, {y:.1f})")


def _corners(exits: IntArray, entries: IntArray) -> list[tuple[int, int]]:
    """Return (exit, entry) by entry, only those that ask for more than all before them."""
    order = np.lexsort((-exits, entries))
    found: list[tuple[int, int]] = []
    most = -1
    for i in order:
        if exits[i] > most:
            most = int(exits[i])
            found.append((most, int(entries[i])))
    return found


def _joined(
    steps: Sequence[tuple[int, int]],
    p: Path,
    out_times: FloatArray,
    in_times: FloatArray,
    reach: float,
) -> list[tuple[int, int]]:
    if reach <= 0.0 or p.cells == 0:
        return list(steps)
    found: list[tuple[int, int]] = []
    at = 0
    while at < len(steps):
        gone, entered = steps[at]
        begin = p.edges[gone + 1]
        ahead = at + 1
        while ahead < len(steps):
            later = steps[ahead][0]
            if (
                p.edges[later + 1] > begin + reach
                or out_times[later] > in_times[entered] + TOLERANCES.late
            ):
                break
            gone = later
            ahead += 1
        found.append((gone, entered))
        at = ahead
    return found


def _exit(piece: Piece, path: Path, cell: int) -> Event | None:
    """Return the event after which a cell is free (``None``: the motion after the rest says it)."""
    if isinstance(piece, DriveCells):
        return Event(At.REACH, piece.activity, piece.object, _rounded(path.edges[cell + 1]))
    return piece.leave


def _entry(piece: Piece, path: Path, cell: int) -> Event | None:
    """Return the event that enters a cell (``None``: the motion before the rest says it)."""
    if isinstance(piece, DriveCells):
        progress = float(path.edges[cell])
        if path.body.mobility.own_law:
            progress = float(path.s[path.stop & (path.s <= progress + 1e-9)][-1])
        return Event(At.LEAVE, piece.activity, piece.object, _rounded(progress))
    return piece.enter


def _rounded(progress: float) -> float:
    return round(float(progress), 6) + 0.0
