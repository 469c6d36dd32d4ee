"""Loads that travel with what carries them: which activities say so, and as which body.

An activity that drives an object and has a motion effect on another one *carries* that one. Where
the load stands to its carrier at the end as it stood at the start, it travels with it: the two are
one body (docs/semantics.md). Elsewhere it is set down by other means, as the effect says.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from up_samp.model import (
    Body,
    Configuration,
    Kinematics,
    Movable,
    UnsupportedError,
)
from up_samp.model.frames import Frame
from up_samp.model.graphs import grouped
from up_samp.model.snapshot import ChangeTask, MotionTask, Ride, Term, TermKind

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


SAME = 1e-3
"""Relative poses this near (m, rad) are the same: as near as a plan has to come to a pose."""
GRAIN = 1e-6
"""Gaps between robot and load below twice this (m) are rounding, and closed."""

STAY = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RideFloor:
    """What a problem says of objects and configurations (``heights``: of their maps, m)."""

    objects: Mapping[str, Movable]
    configurations: Mapping[str, Configuration]
    initial: Mapping[str, str]
    heights: Mapping[str, float]

    def planar(self, name: str) -> bool:
        """Return whether an object moves in the plane."""
        return not self.objects[name].body.flies


def find_rides(
    tasks: Sequence[MotionTask], changes: Sequence[ChangeTask], floor: RideFloor
) -> tuple[list[MotionTask], list[ChangeTask]]:
    """Return the tasks with the loads that travel with them, and the changes that are no rides.

    :raises UnsupportedError: where it hangs on decisions whether a load travels, or who carries it.
    """
    of_activity = grouped(tasks, lambda task: task.activity)
    put = [(t.object, t.terms[-1]) for t in tasks] + [(c.object, c.term) for c in changes]
    rides: dict[MotionTask, list[Ride]] = {}
    left = []
    for change in changes:
        found = [
            (task, ride)
            for task in of_activity.get(change.activity, ())
            for ride in _rides(task, change, put, floor)
        ]
        if len(found) > 1:
            raise UnsupportedError(
                f"activity '{change.activity}': '{change.object}' would travel with "
                f"{' and '.join(repr(t.object) for t, _ in found)}; one of them has to carry it"
            )
        if not found:
            left.append(change)
        for task, ride in found:
            rides.setdefault(task, []).append(ride)
    laden = [_with(task, tuple(rides.get(task, ()))) for task in tasks]
    _check_lists(laden)
    return laden, left


def laden_bodies(tasks: Iterable[MotionTask], floor: RideFloor) -> dict[tuple[str, int], Body]:
    """Return robot and loads as one body, for each task (activity, index) with loads."""
    found = {}
    for task in tasks:
        if task.rides:
            parts = [(floor.objects[r.load].body, r.offset) for r in task.rides]
            body = floor.objects[task.object].body
            _check_along(task, body, [load for load, _ in parts])
            found[task.activity, task.index] = laden_body(body, parts)
    return found


def laden_body(body: Body, loads: Sequence[tuple[Body, Configuration]]) -> Body:
    """Return a body with ``loads`` at poses in its frame, as one."""
    heights, limits = [body.height, *(load.height for load, _ in loads)], body.kinematics
    for load, offset in loads:
        if load.kinematics.drives_along:
            limits = _together(limits, load.kinematics, offset)
    outline, high, low = _joined(body, loads), max(heights), min(heights)
    return replace(body, footprint=outline, height=high, low=low, kinematics=limits)


def _together(mine: Kinematics, its: Kinematics, at: Configuration) -> Kinematics:
    """Return the limits of a body and one that drives along at a pose in its frame. A quarter of
    that one's acceleration is for what pulls it outwards in turns.
    """
    off = math.hypot(*at[:2])
    omega = min(mine.omega_max, its.omega_max, math.sqrt(its.a_max / 4 / max(off, SAME)))
    v_max, reach = min(mine.v_max, its.v_max), max(mine.reach, off)
    a_max = min(mine.a_max, its.a_max - omega**2 * off)
    parts = (*(mine.parts or ((STAY, mine),)), (at, its))
    return replace(mine, v_max=v_max, a_max=a_max, omega_max=omega, reach=reach, parts=parts)


def _with(task: MotionTask, rides: tuple[Ride, ...]) -> MotionTask:
    """Return a task with its rides: what rides is no obstacle to it, listed or not."""
    if not rides:
        return task
    loads = {ride.load for ride in rides}
    lists = [None if s is None else s - loads for s in (task.static, task.dynamic)]
    return replace(task, static=lists[0], dynamic=lists[1], rides=rides)


def _check_lists(tasks: Sequence[MotionTask]) -> None:
    """Raise where a motion has to keep clear of a load that travels, but not of its carrier."""
    pairs = {(task.object, ride.load) for task in tasks for ride in task.rides}
    for task in tasks:
        heeded = task.moved.union(task.avoid or ())
        for carrier, load in sorted(pairs):
            if load in (task.dynamic or ()) and carrier not in heeded:
                raise UnsupportedError(
                    f"activity '{task.activity}' lists the dynamic obstacle '{load}' but not "
                    f"'{carrier}', which carries it: robot and load are one body, so list both"
                )


def _check_along(task: MotionTask, body: Body, loads: Sequence[Body]) -> None:
    """Raise where a load drives along with what cannot be driven along with."""
    if not any(load.kinematics.drives_along for load in loads):
        return
    text = f"activity '{task.activity}': what drives along (drives_along) with '{task.object}' "
    if not body.mobility.sideways:
        raise UnsupportedError(text + "could not follow it: it is no SE2 body")
    if any(part.kinematics.zones for part in (body, *loads)):
        raise UnsupportedError(text + "is not supported together with zones")


def _rides(
    task: MotionTask, change: ChangeTask, put: Iterable[tuple[str, Term]], floor: RideFloor
) -> list[Ride]:
    """Return the ride that a task and a motion effect of its activity make, if they do. ``put``:
    what drives and effects lead objects to.
    """
    load = change.object
    if load == task.object or not (floor.planar(load) and floor.planar(task.object)):
        return []
    start, goal, to = task.terms[0], task.terms[-1], change.term
    if goal == to and goal.kind is not TermKind.CONSTANT:
        return [Ride(task.activity, load, start, to, STAY)]
    places = _places(load, put, floor)
    ends = _offsets(goal, [to], floor)
    if all(t.kind is TermKind.CONSTANT for t in (start, goal, to)):
        if not ends:
            return []
        offset = ends[0][0]
        near = [p for o, p in _offsets(start, places, floor) if _gap(o, offset) <= SAME]
        return [Ride(task.activity, load, near[0], to, offset)] if near else []
    begins = [o for o, _ in _offsets(start, places, floor)]
    if any(_gap(o, p) <= SAME for (o, _), p in itertools.product(ends, begins)):
        raise UnsupportedError(
            f"activity '{task.activity}': whether '{load}' travels with '{task.object}' hangs on "
            "decisions; state one activity for each pair of places"
        )
    return []


def _places(load: str, put: Iterable[tuple[str, Term]], floor: RideFloor) -> list[Term]:
    """Return where a load may be: at first, and where drives and effects lead it."""
    found = [term for name, term in put if name == load]
    if load in floor.initial:
        found.insert(0, Term(TermKind.CONSTANT, floor.initial[load]))
    return list(dict.fromkeys(found))


def _offsets(
    base: Term, others: Iterable[Term], floor: RideFloor
) -> list[tuple[Configuration, Term]]:
    """Return the poses of ``others`` in the frame of ``base``, for all that these may be."""
    found: list[tuple[Configuration, Term]] = []
    named = itertools.chain.from_iterable(_names(other, floor) for other in others)
    for one, name in itertools.product(_names(base, floor), named):
        frame, pose = floor.configurations[one], floor.configurations[name]
        if abs(floor.heights.get(one, 0.0) - floor.heights.get(name, 0.0)) > SAME:
            continue
        found.append((Frame(*frame).seen(pose), Term(TermKind.CONSTANT, name)))
    return list(dict.fromkeys(found))


def _names(term: Term, floor: RideFloor) -> list[str]:
    if term.kind is not TermKind.CONSTANT:
        return [n for n, pose in floor.configurations.items() if len(pose) == 3]
    return [term.name] if len(floor.configurations[term.name]) == 3 else []


def _gap(one: Configuration, other: Configuration) -> float:
    turned = abs(math.remainder(one[2] - other[2], math.tau))
    return max(math.dist(one[:2], other[:2]), turned)


def _joined(
    body: Body, loads: Sequence[tuple[Body, Configuration]]
) -> tuple[tuple[float, float], ...]:
    """Return the outline of robot and loads: their union where that is one polygon without holes,
    else their convex hull (what holds them together is somewhere in between).
    """
    import shapely  # engines that are only named need no geometry

    shapes = [body.footprint, *(Frame(*at).points(b.footprint) for b, at in loads)]
    parts = [shapely.Polygon(shape) for shape in shapes]
    outline = shapely.union_all(parts)
    if not _simple(outline):
        closed = shapely.union_all([p.buffer(GRAIN, join_style="mitre") for p in parts])
        outline = closed.buffer(-GRAIN, join_style="mitre")
    if not _simple(outline):
        outline = shapely.union_all(parts).convex_hull
    ring = shapely.remove_repeated_points(outline.exterior, GRAIN / 10).coords[:-1]
    return tuple((float(x), float(y)) for x, y in ring)


def _simple(outline: BaseGeometry) -> bool:
    return outline.geom_type == "Polygon" and not outline.interiors
