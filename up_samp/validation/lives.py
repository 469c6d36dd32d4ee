"""Where every object is at every time (Definition 8 of the SAMP paper)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.validation.paths import pose_gap
from up_samp.validation.scene import Jump, Scene, Task
from up_samp.validation.se3 import AnyTrack, SpaceTrack, track_of
from up_samp.validation.tracks import Track
from up_samp.validation.verdict import Violation

FloatArray = npt.NDArray[np.float64]
Motions = Mapping[str, tuple[FloatArray, FloatArray]]
"""Times (s) and poses of each task, by its name."""

TOLERANCE = 1e-3
"""Poses that are this near (m, rad) are the same."""


@dataclass(frozen=True)
class Piece:
    """A time [since, until] (s) of an object's life: driven by ``task`` or at rest (until open)."""

    track: AnyTrack
    since: float
    until: float
    task: Task | None

    def during(self, low: float, high: float) -> tuple[float, float] | None:
        """Return the part of [low, high] that this piece fills, ``None`` if none."""
        a, b = max(low, self.since), min(high, self.until)
        if a > b or (a == b and self.task is None and b == self.until):
            return None
        return a, b


@dataclass(frozen=True)
class _Event:
    """A drive ``[start, end]`` (``task``) or a jump (``start == end``), in units."""

    start: int
    end: int
    task: Task | None = None
    jump: Jump | None = None


def build_lives(
    scene: Scene, motions: Motions, seconds: float, found: list[Violation]
) -> dict[str, list[Piece]]:
    """Return the pieces of each object's life in order; breaks in it are added to ``found``."""
    events: dict[str, list[_Event]] = defaultdict(list)
    for task in scene.tasks:
        events[task.object].append(_Event(task.start, task.end, task=task))
    for jump in scene.jumps:
        events[jump.object].append(_Event(jump.time, jump.time, jump=jump))
    lives = {}
    for name in scene.movables:
        ordered = sorted(events[name], key=lambda e: (e.start, e.end, e.task is None))
        found.extend(_overlaps(name, ordered))
        lives[name] = list(_live(name, ordered, scene, motions, seconds, found))
    return lives


def _overlaps(name: str, events: list[_Event]) -> Iterator[Violation]:
    """Rule 16: one activity at a time moves an object."""
    for i, one in enumerate(events):
        for other in events[i + 1 :]:
            if other.start > one.end:
                break
            if one.task is not None and other.task is not None:
                text = f"{one.task.what} and {other.task.what} at the same time"
                yield Violation("overlap", text)
            elif one.task is not None and other.jump is not None:
                if one.task.activity != other.jump.activity:
                    text = f"{other.jump.activity} sets {name} at {other.start}"
                    yield Violation("overlap", f"{text}, during {one.task.what}")
            elif one.jump is not None and other.jump is not None:
                text = f"{one.jump.activity} and {other.jump.activity} set {name} at {one.start}"
                yield Violation("overlap", text)
            elif one.jump is not None and other.task is not None:
                text = f"{one.jump.activity} sets {name} at {one.start}, during {other.task.what}"
                yield Violation("overlap", text)


def _live(
    name: str,
    events: list[_Event],
    scene: Scene,
    motions: Motions,
    seconds: float,
    found: list[Violation],
) -> Iterator[Piece]:
    """Walk through the events of one object's life."""
    radius = scene.shapes[name].radius
    here = scene.pose(scene.initial[name]) if name in scene.initial else None
    since, driven_by = -math.inf, ""
    for event in events:
        start, end = event.start * seconds, event.end * seconds
        if here is not None:
            yield Piece(_resting(here, radius), since, start, None)
        if event.jump is not None:
            target = scene.pose(event.jump.place)
            if driven_by == event.jump.activity and here is not None:
                if pose_gap(here, target) > TOLERANCE:
                    text = f"{driven_by} drives {name} to {_show(here)} but sets it to"
                    found.append(Violation("teleport", f"{text} {_show(target)}"))
                target = here
            here, driven_by = target, ""
        elif event.task is not None and event.task.name in motions:
            times, poses = motions[event.task.name]
            found.extend(_continuity(event.task, here, poses))
            yield Piece(track_of(times, poses, radius), start, end, event.task)
            here, driven_by = tuple(poses[-1].tolist()), event.task.activity
        since = end
    if here is not None:
        yield Piece(_resting(here, radius), since, math.inf, None)


def _continuity(
    task: Task, here: tuple[float, ...] | None, poses: FloatArray
) -> Iterator[Violation]:
    first = tuple(poses[0].tolist())
    if here is None:
        yield Violation("continuity", f"{task.what}: it is nowhere (no initial configuration)")
    elif pose_gap(here, first) > TOLERANCE:
        text = f"{task.what}: its motion starts at {_show(first)} but it is at {_show(here)}"
        yield Violation("continuity", text)


def _resting(pose: tuple[float, ...], radius: float) -> AnyTrack:
    if len(pose) == 7:
        return SpaceTrack.resting(pose, radius)
    return Track.resting((pose[0], pose[1], pose[2]), radius)


def _show(pose: tuple[float, ...]) -> str:
    return f"({', '.join(f'{v:.3f}' for v in pose)})"
