"""From obstacles to staircases: "this robot may go beyond there once that one has come to here"."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from up_samp.execution.graph import At, Event
from up_samp.execution.lives import Drive, Piece
from up_samp.execution.meetings import Meeting, cell_times
from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import MotionModel, UnsupportedError
from up_samp.motion.fleet.paths import Path

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Step:
    """``then`` (leaving a point, or a change) waits for ``first`` (reaching one, or a change).

    ``where`` is a point (x, y; m) near which the two would meet.
    """

    first: Event
    then: Event
    first_time: float
    then_time: float
    where: tuple[float, float]


def steps_of(
    meeting: Meeting, *, stride: float | None = None, without: Container[int] = ()
) -> list[Step]:
    """Return the steps of a meeting on the side on which the plan passes it.

    Steps less than ``stride`` m apart (default: half of the body's radius) are joined where
    the plan allows: the later exit is waited for at the earlier entry. Components ``without`` are
    left out.
    """
    left_out = tuple(c for c in meeting.components if c in without)
    key = (stride, left_out)
    if key not in meeting.memo:
        wanted = ~np.isin(meeting.component, left_out)
        found = list(_side(meeting, meeting.one_first & wanted, True, stride))
        found += _side(meeting, ~meeting.one_first & wanted, False, stride)
        meeting.memo[key] = found
    return list(cast("list[Step]", meeting.memo[key]))


def switched(meeting: Meeting, component: int, one_first: bool) -> list[Step]:
    """Return the steps of one component on the given side, whatever the plan does."""
    key = (component, one_first)
    if key not in meeting.memo:
        chosen = meeting.component == component
        meeting.memo[key] = list(_side(meeting, chosen, one_first, None, planned=False))
    return list(cast("list[Step]", meeting.memo[key]))


def _side(
    meeting: Meeting,
    chosen: npt.NDArray[np.bool_],
    one_first: bool,
    stride: float | None,
    *,
    planned: bool = True,
) -> Iterator[Step]:
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
    out_times = cell_times(leaver, p)[1]
    in_times = cell_times(enterer, q)[0]
    reach = 0.5 * min(life.hull.radius, follower.hull.radius) if stride is None else stride
    allowed = in_times if planned else np.full(len(in_times), np.inf)
    for gone, entered in _joined(steps, p, out_times, allowed, reach):
        first, then = _exit(leaver, p, gone), _entry(enterer, q, entered)
        if first is None or then is None:
            continue
        pose = q.poses[0] if q.cells == 0 else q.poses_at(q.edges[entered : entered + 1])[0]
        entered_at, gone_at = float(in_times[entered]), float(out_times[gone])
        if isinstance(enterer, Drive):
            entered_at = float(enterer.left(np.array([then.progress]))[0])
        if planned and gone_at > entered_at + 2 * TOLERANCES.late:
            raise UnsupportedError(
                f"'{follower.object}' cannot stop on its way, but the plan lets it begin before "
                f"{first}: no executive could hold it back"
            )
        yield Step(first, then, gone_at, entered_at, (float(pose[0]), float(pose[1])))


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
    if isinstance(piece, Drive):
        return Event(At.REACH, piece.activity, piece.object, _rounded(path.edges[cell + 1]))
    return piece.leave


def _entry(piece: Piece, path: Path, cell: int) -> Event | None:
    """Return the event that enters a cell (``None``: the motion before the rest says it)."""
    if isinstance(piece, Drive):
        progress = float(path.edges[cell])
        if path.body.kinematics.model is MotionModel.CONTROL:
            progress = float(path.s[path.stop & (path.s <= progress + 1e-9)][-1])
        return Event(At.LEAVE, piece.activity, piece.object, _rounded(progress))
    return piece.enter


def _rounded(progress: float) -> float:
    return round(float(progress), 6) + 0.0
