"""Where every object is at every time (Definition 8 of the SAMP paper)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from up_samp.model.arrays import FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.collisions import JudgedShape, Track
from up_samp.validation.paths import pose_gap
from up_samp.validation.scene import (
    CarriedLoad,
    JudgedMotion,
    JudgedScene,
    Jump,
    between,
    carried_along,
)
from up_samp.validation.se3 import Solid, track_of
from up_samp.validation.tolerances import TOLERANCES

Motions = Mapping[str, tuple[FloatArray, FloatArray]]
"""Times (s) and poses of each task, by its name."""


def same_height(one: float, other: float) -> bool:
    """Return whether two heights (m) are one floor's."""
    return abs(one - other) <= 1e-6


@dataclass(frozen=True)
class Piece:
    """A time [since, until] (s) of an object's life: driven by ``task`` or at rest (until open)."""

    track: Track
    since: float
    until: float
    task: JudgedMotion | None
    shape: JudgedShape | Solid
    """The object's body, with what holds its load."""
    moves: tuple[float, float] | None = None
    """When the trajectory of ``task`` really leads from place to place: what is before and after
    is waiting (``None``: it does not move at all).
    """
    height: float = 0.0
    """Of the map (m) that it is on."""

    def level(self, other: Piece) -> bool:
        """Return whether both are on maps of one height."""
        return same_height(self.height, other.height)

    def during(self, low: float, high: float) -> tuple[float, float] | None:
        """Return the part of [low, high] that this piece fills, ``None`` if none."""
        a, b = max(low, self.since), min(high, self.until)
        if a > b or (a == b and self.task is None and b == self.until):
            return None
        return a, b


@dataclass(frozen=True)
class _LifeEvent:
    """A drive ``[start, end]`` (``task``; ``ride``: as its load) or a jump (``start == end``), in
    units.
    """

    start: int
    end: int
    task: JudgedMotion | None = None
    jump: Jump | None = None
    ride: CarriedLoad | None = None

    @property
    def activity(self) -> str:
        """The activity that it belongs to."""
        source = self.task or self.jump
        assert source is not None
        return source.activity


def build_lives(
    scene: JudgedScene, motions: Motions, seconds: float, found: list[Violation]
) -> dict[str, list[Piece]]:
    """Return the pieces of each object's life in order; breaks in it are added to ``found``."""
    events: dict[str, list[_LifeEvent]] = defaultdict(list)
    for task in scene.tasks:
        events[task.object].append(_LifeEvent(task.start, task.end, task=task))
    tasks = {task.name: task for task in scene.tasks}
    for ride in scene.rides:
        task = tasks[ride.task]
        events[ride.load].append(_LifeEvent(task.start, task.end, task=task, ride=ride))
    for jump in scene.jumps:
        events[jump.object].append(_LifeEvent(jump.time, jump.time, jump=jump))
    lives = {}
    for name in scene.movables:
        ordered = sorted(events[name], key=lambda e: (e.start, e.end, e.task is None))
        found.extend(_overlaps(name, ordered))
        lives[name] = list(_live(name, ordered, scene, motions, seconds, found))
    return lives


def _overlaps(name: str, events: list[_LifeEvent]) -> Iterator[Violation]:
    """Rule 16: one activity at a time moves an object. Two drives may touch, if the later one takes
    time.
    """
    for i, one in enumerate(events):
        for other in events[i + 1 :]:
            if other.start > one.end:
                break
            text = _clash(name, one, other)
            if text is not None:
                activities = (one.activity, other.activity)
                yield Violation("overlap", text, activities, (name,), float(other.start))


def _clash(name: str, one: _LifeEvent, other: _LifeEvent) -> str | None:
    """Return what is wrong with two events of an object that are not apart, ``other`` the later."""
    if one.task is not None and other.task is not None:
        if one.end == other.start < other.end:
            return None
        return f"{one.task.what} and {other.task.what} at the same time"
    if one.task is not None:
        if one.activity == other.activity:
            return None
        return f"{other.activity} sets {name} at {other.start}, during {one.task.what}"
    if other.task is not None:
        if one.start == other.start:
            return None  # it is there from this instant on, and drives off
        return f"{one.activity} sets {name} at {one.start}, during {other.task.what}"
    return f"{one.activity} and {other.activity} set {name} at {one.start}"


def _live(
    name: str,
    events: list[_LifeEvent],
    scene: JudgedScene,
    motions: Motions,
    seconds: float,
    found: list[Violation],
) -> Iterator[Piece]:
    """Walk through the events of one object's life."""
    own = scene.shapes[name]
    here = scene.pose(scene.initial[name]) if name in scene.initial else None
    height = scene.height(scene.initial[name]) if name in scene.initial else 0.0
    since, driven_by = -math.inf, ""
    for event in events:
        start, end = event.start * seconds, event.end * seconds
        if here is not None:
            yield Piece(resting(here, own.radius), since, start, None, own, height=height)
        if event.jump is not None:
            target = scene.pose(event.jump.place)
            if driven_by == event.jump.activity and here is not None:
                moved = not same_height(height, scene.height(event.jump.place))
                if moved or pose_gap(here, target) > TOLERANCES.pose:
                    text = f"{driven_by} drives {name} to {_show(here)} but sets it to"
                    found.append(Violation("teleport", f"{text} {_show(target)}"))
                target = here
            here, driven_by, height = target, "", scene.height(event.jump.place)
        elif event.task is not None and event.task.name in motions:
            times, poses = motions[event.task.name]
            moves, task, shape = _moving(times, poses), event.task, own
            floor = scene.height(event.task.places[0])
            if event.ride is None:
                shape = _held(scene, event.task)
                goal, by = tuple(poses[-1].tolist()), event.task.activity
            else:
                poses = carried_along(poses, event.ride.offset)
                task = replace(event.task, object=name)
                goal, by = scene.pose(event.ride.goal), ""
            first = tuple(poses[0].tolist())
            found.extend(_continuity(event.task, event.ride, (here, height), (first, floor)))
            here, driven_by, height = goal, by, floor
            track = track_of(times, poses, max(own.radius, shape.radius))
            yield Piece(track, start, end, task, shape, moves, height)
        since = end
    if here is not None:
        yield Piece(resting(here, own.radius), since, math.inf, None, own, height=height)


def _held(scene: JudgedScene, task: JudgedMotion) -> JudgedShape | Solid:
    """Return the object of a task, with what holds its loads where they are not one polygon."""
    loads = []
    for ride in scene.rides:
        shape = scene.shapes[ride.load]
        if ride.task == task.name and isinstance(shape, JudgedShape):
            loads.append((shape, ride.offset))
    carrier = scene.shapes[task.object]
    if loads and isinstance(carrier, JudgedShape):
        return between(carrier, loads) or carrier
    return carrier


def _moving(times: FloatArray, poses: FloatArray) -> tuple[float, float] | None:
    """Return from when to when (s) a trajectory moves: without waits at its beginning and end."""
    steps = np.flatnonzero(np.abs(np.diff(poses, axis=0)).max(axis=1, initial=0.0) > 0)
    if len(steps) == 0:
        return None
    return float(times[steps[0]]), float(times[steps[-1] + 1])


def _continuity(
    task: JudgedMotion,
    ride: CarriedLoad | None,
    here: tuple[tuple[float, ...] | None, float],
    first: tuple[tuple[float, ...], float],
) -> Iterator[Violation]:
    """A drive begins at ``first`` (a pose, and its map's height), where its object is: ``here``; a
    load is taken from where it stands.
    """
    (pose, height), (wanted, floor) = here, first
    tolerance = TOLERANCES.pose if ride is None else 2 * TOLERANCES.pose
    off = pose is None or pose_gap(pose, wanted) > tolerance
    if not off and same_height(height, floor):
        return
    if ride is not None:
        text = f"its load {ride.load} has to be at {_show(wanted)} but is "
        text += "nowhere" if pose is None else f"at {_show(pose)}"
    elif pose is None:
        text = "it is nowhere (no initial configuration)"
    elif off:
        text = f"its motion starts at {_show(wanted)} but it is at {_show(pose)}"
    else:
        text = f"its motion is {floor:g} m up but it is {height:g} m up"
    names, at = ((task.object,), None) if ride is None else ((task.object, ride.load), task.start)
    yield Violation("continuity", f"{task.what}: {text}", (task.activity,), names, at)


def resting(pose: tuple[float, ...], radius: float) -> Track:
    """Return the track of a body that rests at a pose."""
    return track_of(np.zeros(1), np.array([pose], dtype=float), radius)


def _show(pose: tuple[float, ...]) -> str:
    return f"({', '.join(f'{v:.3f}' for v in pose)})"
