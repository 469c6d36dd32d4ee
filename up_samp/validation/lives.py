"""Trajectories of a plan, given or read from UP paths (do both agree?), and by them where every
object is at every time (Definition 8 of the SAMP paper).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from unified_planning.model.motion import SE2WithControlsPath

from up_samp.model import Trajectory, check_time
from up_samp.model.arrays import FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.collisions import JudgedShape, Track, pieces_of
from up_samp.validation.scene import (
    CarriedLoad,
    JudgedMotion,
    JudgedScene,
    Jump,
    between,
    carried_along,
)
from up_samp.validation.se3 import Solid, track_of
from up_samp.validation.tolerances import JUDGING_GRACE, TOLERANCES

_CHUNK = 20_000
"""Pieces of a path between two looks at the clock."""


def path_of(plan: Any, task: JudgedMotion) -> Any | None:
    """Return the UP path that a plan holds for a motion constraint.

    Found by the activity's name: an activity as a dictionary key is lost when it is changed.
    """
    paths = getattr(plan, "motion_paths", None) or {}
    of_task = (
        path
        for (activity, constraint), path in paths.items()
        if activity.name == task.activity and constraint == task.constraint
    )
    return next(of_task, None)


def read_trajectory(
    task: JudgedMotion,
    path: Any | None,
    given: Mapping[str, Trajectory] | None,
    start: float,
    found: list[Violation],
) -> tuple[FloatArray, FloatArray] | None:
    """Return times (s) and poses of a motion, ``None`` (and a violation) if there are none.

    Where trajectories are ``given``, they have to be complete: the path is only read without.
    """
    derived = None
    if isinstance(path, SE2WithControlsPath):
        derived = integrate(path, start, task.what, found)
    if given is not None and task.name in given:
        times = np.asarray(given[task.name].times, dtype=float)
        poses = np.asarray(given[task.name].poses, dtype=float)
        if not (np.isfinite(times).all() and np.isfinite(poses).all()):
            found.append(Violation("trajectory", f"{task.what}: a time or pose is not finite"))
            return None
        if path is not None:
            found.extend(_disagreement(task, path, derived, times, poses))
        return times, poses
    if derived is None or given is not None:
        found.append(Violation("trajectory", f"{task.what} has no timed trajectory"))
        return None
    return derived


def integrate(
    path: Any, start: float, what: str, found: list[Violation]
) -> tuple[FloatArray, FloatArray] | None:
    """Turn (pose, v m/s, omega rad/s, duration s) pieces into samples.

    Each piece is driven with constant twist; it has to end at the next piece's pose. The speed of
    a piece of up to 0.1 s counts as its mean, that of a longer one as really constant.
    """
    if not path.path:
        found.append(Violation("trajectory", f"{what}: its path is empty"))
        return None
    rows = _rows(path.path)
    if not np.isfinite(rows).all():
        found.append(Violation("trajectory", f"{what}: a number of its path is not finite"))
        return None
    x, y, theta, v, omega, duration = rows.T
    duration = np.maximum(duration, 0.0)
    end, turn = _driven(rows, v, omega, duration)
    miss = np.hypot(end[:-1, 0] - x[1:], end[:-1, 1] - y[1:])
    bend = np.remainder(theta[1:] - theta[:-1] - turn[:-1] + math.pi, math.tau) - math.pi
    wrong = np.flatnonzero((miss > TOLERANCES.joint) | (np.abs(bend) > TOLERANCES.joint))
    if len(wrong):
        i = int(wrong[0])
        text = f"{what}: the controls of piece {i} of its path do not lead to the next"
        off = f"(off by {miss[i]:.3g} m, {abs(bend[i]):.3g} rad)"
        found.append(Violation("path", f"{text} pose {off}"))
        return None
    # go on from the stated poses: errors must not add up
    stated = np.column_stack((x, y, np.cumsum(np.append(theta[:1], turn[:-1] + bend))))
    short = (duration <= TOLERANCES.sampling + 1e-9) | ((v == 0) & (omega == 0))
    count = np.where(short, 1, np.ceil(duration / 0.05)).astype(int) * (duration > 0)
    before = np.cumsum(count) - count
    piece = np.repeat(np.arange(len(rows)), count)
    part = duration[piece] * (np.arange(len(piece)) + 1 - before[piece]) / count[piece]
    since = np.cumsum(np.append(start, duration))
    times = np.append(start, since[piece] + part)
    poses = np.empty((len(times), 3))
    poses[1:, :2], turned = _driven(stated[piece], v[piece], omega[piece], part)
    poses[1:, 2] = stated[piece, 2] + turned
    poses[before] = stated  # of several at one instant the last
    return times, poses


def _driven(
    begin: FloatArray, v: FloatArray, omega: FloatArray, seconds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where (n, 2) constant controls lead to from poses (x, y, theta, ...), and the turns
    (n,) on the way.
    """
    half = omega * seconds / 2
    chord = v * seconds * np.sinc(half / math.pi)  # of an arc
    ahead = begin[:, 2] + half
    xy = begin[:, :2] + np.column_stack((chord * np.cos(ahead), chord * np.sin(ahead)))
    return xy, 2 * half


def _rows(pieces: Any) -> FloatArray:
    """Return pieces as rows (x, y, theta, v, omega, duration)."""
    parts = []
    for first in range(0, len(pieces), _CHUNK):
        check_time(JUDGING_GRACE)
        part = pieces[first : first + _CHUNK]
        parts.append(np.array([(p[0], p[1], p[2], v, w, d) for p, v, w, d in part], dtype=float))
    return np.concatenate(parts)


def _disagreement(
    task: JudgedMotion,
    path: Any,
    derived: tuple[FloatArray, FloatArray] | None,
    times: FloatArray,
    poses: FloatArray,
) -> list[Violation]:
    """Compare a trajectory with the path of the same motion (waiting before it starts aside)."""
    if isinstance(path, SE2WithControlsPath):
        if derived is None or poses.shape[1] != 3:
            return []
        shift = _departure(times, poses) - _departure(*derived)
        track = Track(times, poses, 0.0)
        stated = track.poses_at(derived[0] + shift)
        off = float(_difference(stated, derived[1]).max())
    else:
        stated = np.array([tuple(p) for p in path.path], dtype=float)
        if len(stated) == 0 or stated.shape[1] != poses.shape[1]:
            return [Violation("path", f"{task.what}: its path does not fit its trajectory")]
        off = _in_order(stated, poses)
    if off > TOLERANCES.agreement:
        text = f"{task.what}: its path and its trajectory are {off:.3g} (m, rad) apart"
        return [Violation("path", text)]
    return []


def _departure(times: FloatArray, poses: FloatArray) -> float:
    """Return when a planar trajectory begins to move."""
    moving = np.flatnonzero(~pieces_of(times, poses).at_rest)
    return float(times[moving[0]]) if len(moving) else float(times[0])


def _difference(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return how far poses are apart: the larger of metres and radians (quaternions: by sign)."""
    if a.shape[-1] == 7:
        position = np.linalg.norm(a[..., :3] - b[..., :3], axis=-1)
        plus = np.linalg.norm(a[..., 3:] - b[..., 3:], axis=-1)
        minus = np.linalg.norm(a[..., 3:] + b[..., 3:], axis=-1)
        return np.asarray(np.maximum(position, 2 * np.minimum(plus, minus)))
    position = np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1])
    angle = np.abs(np.remainder(a[..., 2] - b[..., 2] + math.pi, math.tau) - math.pi)
    return np.asarray(np.maximum(position, angle))


def passes(
    times: FloatArray, poses: FloatArray, target: FloatArray, since: int, tolerance: float
) -> tuple[int | None, float]:
    """Return the first piece from ``since`` on that comes within ``tolerance`` of a pose, and how
    near the trajectory comes to it. Between samples the nearest of eleven poses counts.
    """
    nearest = math.inf
    track = Track(times, poses, 0.0) if poses.shape[1] == 3 else None
    reach = _difference(poses[since:], target)
    # the way to the next sample bounds how much nearer a piece can come
    steps = _difference(poses[since + 1 :], poses[since:-1])
    for k, distance in enumerate(reach):
        nearest = min(nearest, float(distance))
        if distance <= tolerance:
            return since + k, nearest
        if track is None or k >= len(steps) or distance > 2 * steps[k] + tolerance:
            continue
        ends = times[since + k], times[since + k + 1]
        between = track.poses_at(np.linspace(*ends, 11))
        inner = float(_difference(between, target).min())
        nearest = min(nearest, inner)
        if inner <= tolerance:
            return since + k, nearest
    return None, nearest


def _in_order(stated: FloatArray, poses: FloatArray) -> float:
    """Return how far the poses of a path are from a trajectory, met in their order.

    The trajectory is looked at ten times as finely as it is sampled.
    """
    if len(stated) == len(poses):
        apart = float(_difference(stated, poses).max())
        if apart <= TOLERANCES.agreement / 2:  # pose by pose
            return apart
    share = np.linspace(0, 1, 11)[1:, None]
    steps = np.diff(poses, axis=0)
    between = poses[:-1, None] + share * steps[:, None]
    dense = np.concatenate((poses[:1], between.reshape(-1, poses.shape[1])))
    worst, at = 0.0, 0
    for pose in stated:
        for window in (dense[at : at + 200], dense[at:]):
            gaps = _difference(window, pose)
            near = np.flatnonzero(gaps <= TOLERANCES.agreement / 2)
            if len(near):
                break
        step = int(near[0]) if len(near) else int(gaps.argmin())
        worst = max(worst, float(gaps[step]))
        at += step
    return worst


def pose_gap(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Return how far two poses are apart: the larger of metres and radians."""
    return float(_difference(np.array(a, dtype=float), np.array(b, dtype=float)))


# ------------------ Where every object is


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

    def during(self, low: float, high: float) -> tuple[float, float] | None:
        """Return the part of [low, high] that this piece fills, ``None`` if none."""
        a, b = max(low, self.since), min(high, self.until)
        if a > b or (a == b and self.task is None and b == self.until):
            return None
        return a, b


@dataclass(frozen=True)
class _LifeEvent:
    """A drive (``task``; ``ride``: as its load), or a jump (``start == end``); times in units."""

    start: int
    end: int
    activity: str
    task: JudgedMotion | None = None
    jump: Jump | None = None
    ride: CarriedLoad | None = None


def build_lives(
    scene: JudgedScene, motions: Motions, seconds: float, found: list[Violation]
) -> dict[str, list[Piece]]:
    """Return the pieces of each object's life in order; breaks in it are added to ``found``."""
    events: dict[str, list[_LifeEvent]] = defaultdict(list)
    for task in scene.tasks:
        drive = _LifeEvent(task.start, task.end, task.activity, task)
        events[task.object].append(drive)
        for ride in scene.rides:
            if ride.task == task.name:
                events[ride.load].append(replace(drive, ride=ride))
    for jump in scene.jumps:
        events[jump.object].append(_LifeEvent(jump.time, jump.time, jump.activity, jump=jump))
    lives = {}
    for name in scene.movables:
        ordered = sorted(events[name], key=lambda e: (e.start, e.end, e.task is None))
        found.extend(_overlaps(name, ordered))
        lives[name] = list(_live(name, ordered, scene, motions, seconds, found))
    return lives


def _overlaps(name: str, events: list[_LifeEvent]) -> Iterator[Violation]:
    """Rule 16: one activity at a time moves an object; drives touch if the later takes time."""
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
