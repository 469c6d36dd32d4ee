"""Judge a plan with motions: Definitions 8 and 9 of the SAMP paper.

The numbered rules in comments are those of ``docs/semantics.md``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from up_samp.model import ProblemError, Trajectory, UnsupportedError, check_time
from up_samp.model.arrays import FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.collisions import JudgedShape, Track
from up_samp.validation.kinematics import motion_violations, speeds_on_way
from up_samp.validation.lives import (
    Piece,
    build_lives,
    passes,
    path_of,
    pose_gap,
    read_trajectory,
    resting,
    same_height,
)
from up_samp.validation.scene import JudgedMotion, JudgedScene, Obstacle, carried_along
from up_samp.validation.schedule import (
    Judged,
    Verdict,
    evaluate_metric,
    judge_decisions,
    judge_schedule,
)
from up_samp.validation.se3 import hits, meets_map
from up_samp.validation.timeline import Decisions
from up_samp.validation.tolerances import JUDGING_GRACE, TOLERANCES
from up_samp.validation.zones import zone_violations


def validate_plan(
    problem: Any,
    plan: Any,
    trajectories: Mapping[str, Trajectory] | None = None,
    *,
    seconds_per_unit: float | None = None,
) -> Verdict:
    """Judge a UP ``MotionSchedule`` of a ``SchedulingMotionProblem``: schedule and motions.

    ``trajectories`` maps activities to trajectories in plan time (s; ``activity#k`` for an
    activity's k-th further motion constraint). Without it they are ``plan.trajectories``, or read
    from the plan's ``SE2WithControlsPath`` paths, starting at their activities' starts. Where a
    plan holds both, they have to agree. A unit of the schedule is ``seconds_per_unit`` s (None: as
    the plan says, else 1). Rules: ``docs/semantics.md``. Raises ``UnsupportedError`` for
    what has no rule there, ``ProblemError`` for a wrong problem.
    """
    if seconds_per_unit is None:
        seconds_per_unit = getattr(plan, "seconds_per_unit", 1.0)
    if not 0 < seconds_per_unit < math.inf:
        raise ProblemError(f"seconds_per_unit must be positive, not {seconds_per_unit}")
    judged = judge_schedule(problem, plan)
    return _with_motions(problem, plan, judged, trajectories, seconds_per_unit)


def judge_plan(
    problem: Any, plan: Any, *, motion: bool, seconds_per_unit: float = 1.0
) -> tuple[Verdict, dict[Any, Any] | None]:
    """Judge a plan (with its motions if ``motion``), and evaluate the problem's quality metrics
    (``None`` when the schedule is too broken for that).
    """
    verdict, timeline = judged = judge_schedule(problem, plan)
    if motion:
        verdict = _with_motions(problem, plan, judged, None, seconds_per_unit)
    if timeline is None:
        return verdict, None
    values = {m: evaluate_metric(m, timeline) for m in problem.quality_metrics}
    return verdict, values


def judge_executed(
    problem: Any,
    decisions: Decisions,
    samples: Mapping[tuple[str, str], FloatArray],
    ends: Mapping[tuple[str, str], FloatArray],
    seconds: float,
) -> list[Violation]:
    """Judge what was executed, in dense time (``decisions.instant``): the schedule, and that one
    motion of an object comes after the other, from where it is, while static obstacles rest.

    ``samples`` are rows (t in s, pose) of each motion, by activity and object; ``ends`` are poses
    that count as the last ones of some, wherever these really ended. Contacts are not looked at,
    and of kinematics only whether somebody drives backwards who must not, or faster than
    it may, or breaks the rules of a zone.
    """
    verdict, timeline = judge_decisions(problem, decisions)
    found = list(verdict.violations)
    if not hasattr(problem, "initial_configuration"):
        return found
    scene = JudgedScene(problem, timeline)
    motions, counted = {}, {}
    for task in scene.tasks:
        key = (task.activity, task.object)
        if key in samples:
            times, poses = motions[task.name] = samples[key][:, 0], samples[key][:, 1:]
            last = ends.get(key, poses[-1])
            counted[task.name] = times, np.concatenate([poses[:-1], [last]])
            limits = scene.limits[task.object]
            found.extend(speeds_on_way(task.what, limits, times, poses))
    lives = build_lives(scene, counted, seconds, found)
    found.extend(_zones(scene, lives, motions))
    for task in scene.tasks:
        found.extend(_obstacles(scene, task, lives, seconds))
    return found


def _with_motions(
    problem: Any,
    plan: Any,
    judged: Judged,
    trajectories: Mapping[str, Trajectory] | None,
    seconds: float,
) -> Verdict:
    verdict, timeline = judged
    if timeline is None:
        return verdict
    scene = JudgedScene(problem, timeline)
    found: list[Violation] = []
    if scene.tasks or scene.jumps:
        found = _motion_violations(scene, plan, trajectories, seconds)
    return Verdict((*verdict.violations, *found), verdict.definition3 and not found)


def _motion_violations(
    scene: JudgedScene, plan: Any, trajectories: Mapping[str, Trajectory] | None, seconds: float
) -> list[Violation]:
    found: list[Violation] = []
    given = trajectories if trajectories is not None else getattr(plan, "trajectories", None)
    for name in sorted(set(given or ()) - {task.name for task in scene.tasks}):
        text = f"there is a trajectory of {name}, which is no motion in this plan"
        found.append(Violation("trajectory", text))
    motions: dict[str, tuple[FloatArray, FloatArray]] = {}
    for task in scene.tasks:
        check_time(JUDGING_GRACE)
        motion = read_trajectory(task, path_of(plan, task), given, task.start * seconds, found)
        if motion is None:
            continue
        if motion[1].shape[1] != len(scene.pose(task.places[0])):
            text = f"{task.what}: its poses have {motion[1].shape[1]} numbers"
            found.append(Violation("trajectory", text))
            continue
        motions[task.name] = motion
        found.extend(_window(task, motion[0], seconds))
        found.extend(_places(scene, task, *motion))
        found.extend(motion_violations(task.what, scene.limits[task.object], *motion))
    found.extend(_along(scene, motions))
    lives = build_lives(scene, motions, seconds, found)
    found.extend(_zones(scene, lives, motions))
    for task in scene.tasks:
        check_time(JUDGING_GRACE)
        found.extend(_obstacles(scene, task, lives, seconds))
    found.extend(_collisions(scene, lives))
    found.extend(_jumps(scene, lives, seconds))
    return found


def _along(
    scene: JudgedScene, motions: Mapping[str, tuple[FloatArray, FloatArray]]
) -> Iterator[Violation]:
    """Rule 27: what drives along with a carrier keeps its own limits where it is."""
    for ride in scene.rides:
        limits = scene.limits[ride.load]
        if not limits.along or ride.task not in motions:
            continue
        if limits.zones:
            raise UnsupportedError(f"{ride.load} drives along, and has zones")
        times, poses = motions[ride.task]
        what = f"{ride.load}, which drives along in {ride.activity}"
        for found in motion_violations(what, limits, times, carried_along(poses, ride.offset)):
            yield replace(found, activities=(ride.activity,), objects=(ride.load,))


def _zones(
    scene: JudgedScene,
    lives: Mapping[str, list[Piece]],
    motions: Mapping[str, tuple[FloatArray, FloatArray]],
) -> Iterator[Violation]:
    """Rules of places, for an object with what travels with it."""
    for task in scene.tasks:
        limits = scene.limits[task.object]
        if not limits.zones or task.name not in motions:
            continue
        check_time(JUDGING_GRACE)
        parts = []
        for piece in itertools.chain.from_iterable(lives.values()):
            mine = piece.task is not None and piece.task.name == task.name
            if mine and isinstance(piece.shape, JudgedShape) and isinstance(piece.track, Track):
                parts.append((piece.shape, piece.track.poses))
        height = scene.height(task.places[0])
        for found in zone_violations(task.what, limits, parts, height, *motions[task.name]):
            yield replace(found, activities=(task.activity,), objects=(task.object,))


def _window(task: JudgedMotion, times: FloatArray, seconds: float) -> Iterator[Violation]:
    """Rule 15: within the activity's start and end."""
    low, high = task.start * seconds, task.end * seconds
    if times[0] < low - TOLERANCES.late or times[-1] > high + TOLERANCES.late:
        text = (
            f"{task.what} from {times[0]:.3f} to {times[-1]:.3f} s, allowed {low:g} to {high:g} s"
        )
        yield Violation("window", text)


def _places(
    scene: JudgedScene, task: JudgedMotion, times: FloatArray, poses: FloatArray
) -> Iterator[Violation]:
    """Rule 15: from the starting configuration through the waypoints, in order, to the last."""
    poses_of = [scene.pose(place) for place in task.places]
    for kind, place, wanted, is_at in (
        ("start", task.places[0], poses_of[0], poses[0]),
        ("goal", task.places[-1], poses_of[-1], poses[-1]),
    ):
        gap = pose_gap(wanted, tuple(is_at))
        if gap > TOLERANCES.pose:
            text = f"{task.what}: it is {gap:.3g} (m, rad) off its {kind} {place}"
            yield Violation(kind, text)
    since = 0
    for place, pose in zip(task.places[1:-1], poses_of[1:-1], strict=True):
        at, gap = passes(times, poses, np.array(pose), since, TOLERANCES.pose)
        if at is None:
            text = f"{task.what}: it comes only within {gap:.3g} (m, rad) of {place}, in order"
            yield Violation("waypoint", text)
        else:
            since = at


def _obstacles(
    scene: JudgedScene, task: JudgedMotion, lives: Mapping[str, list[Piece]], seconds: float
) -> Iterator[Violation]:
    """Rule 19: static obstacles rest; obstacles with fluents are where these say."""
    low, high = task.start * seconds, task.end * seconds
    for obstacle in task.obstacles or ():
        if obstacle.name not in lives:
            raise ProblemError(f"{task.what}: the obstacle {obstacle.name} is no movable object")
        if obstacle.name == task.object:
            continue
        pieces = lives[obstacle.name]
        if obstacle.static:
            yield from _rests(task, obstacle, pieces, low, high)
            moved = scene.fluent_moves(obstacle, task)
            if moved:
                text = f"{task.what}: the static obstacle {obstacle.name} moves ({moved})"
                yield Violation("static-obstacle", text, (task.activity,), (obstacle.name,))
        if obstacle.place is not None:
            yield from _where_told(scene, task, obstacle, pieces, low)


def _where_told(
    scene: JudgedScene, task: JudgedMotion, obstacle: Obstacle, pieces: list[Piece], at: float
) -> Iterator[Violation]:
    """Rule 19: what its fluent says of an obstacle at the task's start."""
    assert obstacle.place is not None
    wanted = scene.pose(obstacle.place)
    now = [i for i, p in enumerate(pieces) if p.since <= at <= p.until]
    drives = [p.task.activity for p in (pieces[i] for i in now) if p.task is not None]
    there: list[tuple[Piece, float]] = []
    if obstacle.static:
        # what is set elsewhere at this very instant is there from now on
        there += [(pieces[i], at) for i in now if pieces[i].until > at]
    else:
        # where it is, was before, or is going
        for i in now:
            before = pieces[i] if pieces[i].task is not None else pieces[max(0, i - 1)]
            there += [(before, before.since), (pieces[i], pieces[i].until)]
    height = scene.height(obstacle.place)
    if not any(
        same_height(height, piece.height)
        and pose_gap(wanted, piece.track.pose(when)) <= TOLERANCES.pose
        for piece, when in there
    ):
        where = "at rest at" if obstacle.static else "and was not last at"
        text = f"{task.what}: the obstacle {obstacle.name} is not {where} {obstacle.place}"
        yield Violation(
            "obstacle-place",
            f"{text} at {task.start}, where its fluent tells it to be",
            (task.activity, *drives),
            (obstacle.name,),
            at,
        )


def _rests(
    task: JudgedMotion, obstacle: Obstacle, pieces: list[Piece], low: float, high: float
) -> Iterator[Violation]:
    for piece in pieces:
        if piece.task is not None and piece.since < high and low < piece.until:
            text = f"{task.what}: its static obstacle {obstacle.name} moves ({piece.task.what})"
            activities = (task.activity, piece.task.activity)
            yield Violation("static-obstacle", text, activities, (obstacle.name,), piece.since)
        if piece.task is None and low < piece.until < high:
            after = [p for p in pieces if p.since == piece.until and p is not piece]
            if all(p.task is None for p in after):
                text = f"{task.what}: its static obstacle {obstacle.name} is set elsewhere"
                text = f"{text} at {piece.until:g} s"
                here = (task.activity,)
                yield Violation("static-obstacle", text, here, (obstacle.name,), piece.until)


def _collisions(scene: JudgedScene, lives: Mapping[str, list[Piece]]) -> Iterator[Violation]:
    """Rule 18, swept."""
    looked_at: set[frozenset[int]] = set()
    for name, pieces in lives.items():
        for piece in pieces:
            if piece.task is None:
                continue
            task, blocked = piece.task, scene.map_driven(piece.task)
            time = meets_map(piece.shape, piece.track, blocked, piece.since, piece.until)
            if time is not None:
                text = f"{task.what} meets the map at {time:.3f} s"
                yield Violation("map-collision", text, (task.activity,), (name,), time)
            for other in lives:
                for theirs in lives[other]:
                    keeps = _keeps_clear(scene, task, other, theirs.task)
                    if not keeps or not same_height(piece.height, theirs.height):
                        continue
                    pair = frozenset((id(piece), id(theirs)))
                    if pair not in looked_at:
                        looked_at.add(pair)
                        yield from _meeting(scene, task, other, piece, theirs)


def _keeps_clear(
    scene: JudgedScene, task: JudgedMotion, other: str, its: JudgedMotion | None
) -> bool:
    """Return whether a task keeps clear of ``other`` while ``its`` task moves it (None: none
    does): with what travels with it, it is one body.
    """
    if other in task.together:
        return False
    names = {other} if its is None else its.together | {other}
    return any(scene.avoids(task, name) for name in names - task.together)


def _meeting(
    scene: JudgedScene, task: JudgedMotion, other: str, piece: Piece, theirs: Piece
) -> Iterator[Violation]:
    """One piece of a driven object's life against one piece of another object's that it avoids:
    while it moves itself, and while the other one does, where that has to keep clear of it.
    """
    moving = [piece.moves]
    if theirs.task is not None and _keeps_clear(scene, theirs.task, task.object, task):
        moving.append(theirs.moves)
    times = []
    for window in moving:
        both = None if window is None else theirs.during(*window)
        during = None if both is None else piece.during(*both)
        if during is not None:
            time = hits(piece.shape, piece.track, theirs.shape, theirs.track, *during)
            times += [] if time is None else [time]
    if times:
        doing = f" ({theirs.task.what})" if theirs.task else ""
        text = f"{task.what} meets {other}{doing} at {min(times):.3f} s"
        activities = (task.activity, *([theirs.task.activity] if theirs.task else []))
        yield Violation("collision", text, activities, (task.object, other), min(times))


def _jumps(
    scene: JudgedScene, lives: Mapping[str, list[Piece]], seconds: float
) -> Iterator[Violation]:
    """Rule 18: nothing is set onto an object that rests and keeps clear of it when it drives."""
    for jump in scene.jumps:
        at = jump.time * seconds
        own = {t.object for t in scene.tasks if t.activity == jump.activity}
        together = own | scene.carried.get(jump.activity, frozenset())
        if jump.object in own or jump.object not in scene.shapes:
            continue
        track = resting(scene.pose(jump.place), scene.shapes[jump.object].radius)
        for other, pieces in lives.items():
            if other in together or not scene.counts(other, jump.object):
                continue
            for piece in pieces:
                moving = piece.moves is not None and piece.moves[0] < at < piece.moves[1]
                if piece.during(at, at) is None or moving:
                    continue
                if not same_height(piece.height, scene.height(jump.place)):
                    continue
                shapes = scene.shapes[jump.object], scene.shapes[other]
                if hits(shapes[0], track, shapes[1], piece.track, at, at) is not None:
                    text = f"{jump.activity} sets {jump.object} at {jump.time} to {jump.place},"
                    text = f"{text} where {other} is"
                    activities = (jump.activity, *([piece.task.activity] if piece.task else []))
                    yield Violation("collision", text, activities, (jump.object, other), at)
                    break
