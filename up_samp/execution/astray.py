"""Robots off their paths or places, where no command led them: who is kept away, by one rule."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from up_samp.execution.build import Dependencies
from up_samp.execution.graph import At, Event
from up_samp.execution.lives import DriveCells, Life, Piece, Stay, concerned, kept_apart
from up_samp.execution.meetings import moving
from up_samp.execution.state import FloorState, Strayed, TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import pose_at
from up_samp.model import Configuration
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.motion.fleet.conflicts import Swept, conflicting_cells
from up_samp.motion.fleet.paths import resting_path


@dataclass(frozen=True)
class Overrun:
    """``robot`` is where its commands cannot have led it, in ``motion`` (``""``: at rest): surely
    ``by`` m beyond a gate that is closed, or (negative) that far behind where it had already come
    to, so that others may be where it is now; or ``off`` m off its path, or its place.

    ``held`` are robots that are kept away from it, ``met`` those that may touch it already.
    """

    robot: str
    motion: str
    by: float
    held: tuple[str, ...] = ()
    met: tuple[str, ...] = ()
    off: float = 0.0

    def __str__(self) -> str:
        if self.off > 0:
            where = f"its path of '{self.motion}'" if self.motion else "its place"
            return f"'{self.robot}' is {self.off:.3f} m off {where}"
        if self.by > 0:
            return f"'{self.robot}' is {self.by:.3f} m beyond a closed gate of '{self.motion}'"
        return f"'{self.robot}' is {-self.by:.3f} m behind where it was in '{self.motion}'"


def place_of(state: FloorState, life: Life) -> Piece | None:
    """Return the motion in which an object is, or the rest (``None``: it is not known where)."""
    way = state.of_object.get(life.object)
    for piece in life.pieces:
        if way is None and isinstance(piece, Stay) and _stands(state, life, piece):
            return piece
        if way is not None and piece.activity == way.activity:
            return piece
    return None


def coming_to(state: FloorState, life: Life) -> list[Piece]:
    """Return where an activity under way is about to set an object (a lift: it may be there)."""
    going = TaskPhase.RUNNING
    return [p for p in life.pieces if _put(p) and state.phase[_put(p)] is going]


def led_by(life: Life, piece: Piece) -> str:
    """Return the activity that leads an object to where it is (``""``: it is there at first)."""
    if piece.enter is not None:
        return piece.enter.activity
    if piece.activity:
        return piece.activity
    before = life.pieces[: life.pieces.index(piece)]
    return next((p.activity for p in reversed(before) if p.activity), "")


def pose_in(state: FloorState, piece: Piece) -> Configuration:
    """Return where an object is by what it told last, in a piece of its life."""
    if isinstance(piece, DriveCells):
        return pose_at(piece.path, state.ways[piece.key].told)
    return piece.pose


def beside(life: Life, piece: Piece | None) -> list[DriveCells]:
    """Return the motion that a piece is, or those before and after it."""
    if piece is None or isinstance(piece, DriveCells):
        return list(life.drives) if piece is None else [piece]
    k = life.pieces.index(piece)
    before = [p for p in life.pieces[:k] if isinstance(p, DriveCells)]
    return [*before[-1:], *[p for p in life.pieces[k:] if isinstance(p, DriveCells)][:1]]


def kept_away(
    state: FloorState, dependencies: Dependencies, robot: str
) -> tuple[Overrun | None, dict[tuple[str, str], float]]:
    """Return whether a robot is where nobody led it, and how far (m) others' motions may go then
    (by activity and object): as far as they keep clear of wherever it may be, and of its way back
    to its gate. What is set down there without a motion of its own goes nowhere (0 m), nor does the
    robot itself.
    """
    way, life = state.of_object.get(robot), dependencies.lives[robot]
    by, strayed = 0.0 if way is None else state.astray(way), state.strayed.get(robot)
    if not by and strayed is None:
        return None, {}
    error, margin = state.errors[robot], dependencies.graph.margin
    margin = max(margin, min(margin, TOLERANCES.margin) + error + max(state.errors.values()))
    held: dict[str, None] = {}
    met: dict[str, None] = {}
    lifted = {_put(piece): 0.0 for piece in life.pieces if _to_come(state, piece)}
    bars = {(activity, robot): most for activity, most in lifted.items()}
    here = place_of(state, life)
    areas = list(_areas(state, life, here, by, strayed))
    for other, piece, low, high in _in_the_way(state, dependencies, life, here, areas, margin):
        if _to_come(state, piece):
            held[other], bars[_put(piece), other] = None, 0.0
            continue
        if isinstance(piece, Stay):
            met[other] = None
            continue
        its = state.ways[piece.key]
        running = state.phase[its.activity] is TaskPhase.RUNNING
        if running and its.told - its.error > high:
            continue
        inside = running and its.told + its.error >= low
        (met if inside else held)[other] = None
        bar = its.told if inside else max(0.0, low - its.error)
        bars[piece.key] = min(bar, bars.get(piece.key, bar))
    motion, off = "" if way is None else way.activity, 0.0 if strayed is None else strayed.off
    kept = tuple(n for n in held if n not in met)
    return Overrun(robot, motion, by, kept, tuple(met), off), bars


def _areas(
    state: FloorState, life: Life, here: Piece | None, by: float, strayed: Strayed | None
) -> Iterator[Swept]:
    """Yield what a robot may take up that is off its path, or astray ``by`` m along it."""
    if strayed is not None:
        body = here.path.body if isinstance(here, DriveCells) else life.body
        yield moving(resting_path(body, strayed.pose))
    if not by or not isinstance(here, DriveCells):
        return
    way, error = state.ways[here.key], state.errors[life.object]
    gate = state.closed(way)
    along = [way.told - error, way.told + error]
    if gate is not None:
        along.append(state.nominal(gate))
    # it still comes to rest, or is led back to where it was
    along.append(state.braking(way) + error if by > 0 else way.progress + error)
    edges, whole = here.path.edges, moving(here.path)
    hit = (edges[:-1] <= max(along)) & (edges[1:] >= min(along))
    yield Swept(np.ascontiguousarray(whole.table[hit]), whole.hull)


def _in_the_way(
    state: FloorState,
    dependencies: Dependencies,
    life: Life,
    here: Piece | None,
    areas: list[Swept],
    margin: float,
) -> Iterator[tuple[str, Piece, float, float]]:
    """Yield (object, piece, from, to) where others are, or will be, within a margin (m) of areas:
    between ``from`` and ``to`` (m) of their piece.
    """
    k = None if here is None else life.pieces.index(here)
    for other in dependencies.lives.values():
        near = np.zeros(len(other.pieces), dtype=np.bool_)
        for area in areas:
            near |= _near(area, other.boxes, margin)
        for m in np.flatnonzero(near).tolist() if other is not life else ():
            piece = other.pieces[m]
            if _over(state, other, piece) or (k is not None and not _apart(life, k, other, m)):
                continue
            for area in areas:
                for _, first, last in conflicting_cells(area, moving(piece.path), margin):
                    if isinstance(piece, Stay):
                        yield other.object, piece, 0.0, 0.0
                    else:
                        edges = piece.path.edges
                        yield other.object, piece, float(edges[first]), float(edges[last + 1])


def _apart(life: Life, k: int, other: Life, m: int) -> bool:
    """Return whether piece ``k`` of a life and piece ``m`` of another must not meet, both at rest,
    too: where one is that rests elsewhere than it should, no plan has looked.
    """
    if isinstance(life.pieces[k], Stay) and isinstance(other.pieces[m], Stay):
        return kept_apart(life, life.drives, other, other.drives)
    return concerned(life, k, other, m)


def _near(area: Swept, boxes: FloatArray, margin: float) -> BoolArray:
    """Return which boxes (n, 4) a swept area may come near."""
    cells = area.table[:, 1]
    reach = (cells[:, 7] + cells[:, 8]).max() + area.hull.radius + margin
    low, high = cells[:, :2].min(axis=0) - reach, cells[:, :2].max(axis=0) + reach
    return np.asarray(np.all((boxes[:, :2] <= high) & (boxes[:, 2:] >= low), axis=1))


def _over(state: FloorState, life: Life, piece: Piece) -> bool:
    """Return whether a motion is over, or an object does not rest where it does in a piece, and is
    not to be set there either.
    """
    if piece.activity:
        return state.phase[piece.activity] is TaskPhase.DONE
    return not _stands(state, life, piece) and not _to_come(state, piece)


def _put(piece: Piece) -> str:
    """Return the activity that sets an object where it rests in a piece, without a motion of it or
    of who carries it (``""``: none does).
    """
    enter = piece.enter
    return enter.activity if enter is not None and enter.at is At.END else ""


def _to_come(state: FloorState, piece: Piece) -> bool:
    """Return whether an object is still to be set where it rests in a piece."""
    return _put(piece) != "" and state.phase[_put(piece)] is not TaskPhase.DONE


def _stands(state: FloorState, life: Life, stay: Piece) -> bool:
    """Return whether an object may rest where it does in a piece of its life."""
    m = life.pieces.index(stay)
    before, after = life.pieces[:m], life.pieces[m + 1 :]
    over = all(state.phase[p.activity] is TaskPhase.DONE for p in before if p.activity)
    later = all(state.phase[p.activity] is TaskPhase.WAITING for p in after if p.activity)
    put = stay.enter is None or _happened(state, stay.enter)
    return over and later and put and not (stay.leave is not None and _happened(state, stay.leave))


def _happened(state: FloorState, event: Event) -> bool:
    """Return whether an object has been put, or taken away, by what ends in an event (a ride takes
    its load away from where it begins on).
    """
    phase = state.phase[event.activity]
    return phase is TaskPhase.DONE or (event.at is At.REACH and phase is TaskPhase.RUNNING)
