"""The last rung for a few robots: all of them moved together, one drive at a time.

Where every order of priorities fails, somebody has to step aside twice, or two have to wait for a
third. This searches the joint states of up to three robots, each at its start, at its goal or
parked aside, for a cheap sequence of single drives among the parked others: best first, with
drives planned only when they are about to be used (lazy, in the sense of Cohen, Phillips &
Likhachev 2015). It is pebble motion (Kornhauser, Miller & Spirakis 1984) over sampled places. The
sequence is then timed drive by drive, each as early as the ones before it allow, so that drives
overlap where they can. Deterministic; a bounded number of drives is planned; finding nothing
proves nothing.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from up_samp.geometry import kernels as k
from up_samp.geometry.scene import Scene
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Placed,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.fleet.knots import Drives, untie
from up_samp.motion.fleet.passing import pass_by
from up_samp.motion.fleet.paths import Path, path_of
from up_samp.motion.fleet.timed_path import TimedPath, run_of
from up_samp.motion.fleet.timings import Timing, natural_timing
from up_samp.motion.fleet.waiting import Window, first_start, fit, parked_all_the_time
from up_samp.motion.fleet.workspace import Workspace, rest_run
from up_samp.motion.tuning import CoupledTuning

State = tuple[int, ...]


@dataclass
class Coupling:
    """Up to three robots that are moved together, with the places that each may stand at."""

    workspace: Workspace
    motions: Sequence[TimedMotion]
    world: Sequence[TimedPath]
    deadline: Deadline
    places: list[list[Configuration]] = field(default_factory=list)
    planned: int = 0

    @property
    def tuning(self) -> CoupledTuning:
        """How much is tried."""
        return self.workspace.tuning.coupled

    def bound(self, robot: int, here: int, there: int) -> float:
        """Return seconds that a drive takes at least."""
        p, q = self.places[robot][here], self.places[robot][there]
        return math.dist(p[:2], q[:2]) / self.motions[robot].body.kinematics.v_max

    def drive(self, robot: int, state: State, there: int) -> Path | None:
        """Return a path for one robot while the others stay where they are, if one is found."""
        self.planned += 1
        motion = self.motions[robot]
        parked = [
            Placed(other.object, other.body, self.places[i][state[i]])
            for i, other in enumerate(self.motions)
            if i != robot and (motion.avoid is None or other.object in motion.avoid)
        ]
        poses = (self.places[robot][state[robot]], self.places[robot][there])
        static = parked_all_the_time(motion, self.world)
        return self.workspace.detour(motion.body, poses, static, parked, self.deadline)


def tied_by(conflicts: Iterable[tuple[str, str]]) -> list[set[str]]:
    """Return the sets of motions that hang together by conflicts."""
    parts: list[set[str]] = []
    for pair in sorted(conflicts):
        joined = set(pair).union(*(part for part in parts if part & set(pair)))
        parts = [part for part in parts if not part & joined]
        parts.append(joined)
    return parts


def couple(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
    deadline: Deadline,
    seed: int = 0,
) -> dict[str, TimedPath] | None:
    """Return runs of a few ``motions`` that keep clear of each other and of the ``world``, or None
    if none are found or they are not of the kind that this can couple.

    ``alone`` are the runs of the motions without each other. The robots must be cars with two
    poses each, of different names, and all there from before the first release on.
    """
    if workspace.scene is None or not _can_couple(motions):
        return None
    beside = pass_by(workspace, motions, alone, world)
    if beside is not None:
        return beside
    coupling = Coupling(workspace, motions, world, deadline)
    if len(motions) <= coupling.tuning.robots:
        _find_places(coupling, workspace.scene, alone, seed)
        found = _runs_of(coupling, _sequence(coupling), alone)
        if found is not None:
            return found
    return _runs_of(coupling, untie(workspace, motions, alone, world, deadline, seed), alone)


def _find_places(
    coupling: Coupling, scene: Scene, alone: Mapping[str, TimedPath], seed: int
) -> None:
    motions = coupling.motions
    for robot, motion in enumerate(motions):
        others = [alone[m.name].path for m in motions if m is not motion]
        aside = _aside(coupling, scene, motion, others, random.Random(7 * seed + robot))
        coupling.places.append([*motion.poses, *aside])


def _runs_of(
    coupling: Coupling, sequence: Sequence[Drives] | None, alone: Mapping[str, TimedPath]
) -> dict[str, TimedPath] | None:
    """Return the runs of all robots for a sequence of drives, if it can be timed."""
    if sequence is None:
        return None
    legs = _timed(coupling, sequence)
    if legs is None or _collide(coupling, legs):
        return None
    joined = zip(coupling.motions, legs, strict=True)
    # who has no drive stays where it is
    return {m.name: _one_run(m, drives) if drives else alone[m.name] for m, drives in joined}


def _can_couple(motions: Sequence[TimedMotion]) -> bool:
    first = min(m.release for m in motions)
    return (
        len(motions) > 1
        and len({m.object for m in motions}) == len(motions)
        and all(len(m.poses) == 2 for m in motions)
        and all(m.present_from <= first for m in motions)
    )


def _collide(coupling: Coupling, legs: Sequence[Sequence[TimedPath]]) -> bool:
    """Return whether any two robots' drives, or a drive and the world, meet."""
    meeting = coupling.workspace.meeting
    pairs = [pair for a, b in itertools.combinations(legs, 2) for pair in itertools.product(a, b)]
    pairs += [(run, other) for runs in legs for run in runs for other in coupling.world]
    return any(meeting(a, b)[0] < math.inf for a, b in pairs)


def _aside(
    coupling: Coupling,
    scene: Scene,
    motion: TimedMotion,
    others: Sequence[Path],
    rng: random.Random,
) -> list[Configuration]:
    """Return free places off the paths of the others (of as many as possible), the nearest to the
    robot's own start first, no two of them close together.
    """
    body, start = motion.body, motion.poses[0]
    world = scene.world(scene.shape(body), parked_all_the_time(motion, coupling.world))
    points = np.concatenate([path.poses[:, :2] for path in others])
    reach = 4 * body.kinematics.turning_radius + 2 * world.shape.radius
    found = []
    for _ in range(coupling.tuning.samples):
        # where it can matter: near a path that somebody has to be let pass on
        x, y = (float(v) + rng.uniform(-reach, reach) for v in points[rng.randrange(len(points))])
        th = rng.uniform(-math.pi, math.pi)
        if k.pose_free(world, x, y, th):
            found.append((math.dist((x, y), start[:2]), (x, y, th)))
    found.sort()
    chosen: list[tuple[int, float, Configuration]] = []
    apart = 2 * world.shape.radius
    for away, pose in found:
        blocked = _blocked(coupling.workspace, body, pose, others)
        near = [c for c in chosen if math.dist(c[2][:2], pose[:2]) < apart and c[0] <= blocked]
        if blocked < len(others) and not near:
            chosen.append((blocked, away, pose))
        if sum(blocked == 0 for blocked, _, _ in chosen) >= coupling.tuning.aside:
            break
    chosen.sort()
    return [pose for _, _, pose in chosen[: coupling.tuning.aside]]


def _blocked(workspace: Workspace, body: Body, pose: Configuration, others: Sequence[Path]) -> int:
    """Return how many of the paths a body at a pose blocks."""
    rest = rest_run(workspace, Rest("", body, pose)).path
    return sum(len(workspace.conflicts(path, rest)) > 0 for path in others)


def _sequence(coupling: Coupling) -> list[Drives] | None:
    """Return a cheap sequence of drives (robot, path) from all starts to all goals."""
    count = len(coupling.motions)
    start, goal = (0,) * count, (1,) * count

    def to_go(state: State) -> float:
        return coupling.tuning.greed * sum(coupling.bound(i, at, 1) for i, at in enumerate(state))

    ticket = itertools.count()
    # (estimate, ticket, cost before the last drive, state before it, robot, place, drives so far)
    queue: list[tuple[float, int, float, State, int, int, tuple[tuple[int, Path], ...]]]
    queue = [(to_go(start), next(ticket), 0.0, start, -1, -1, ())]
    settled: set[State] = set()
    known: dict[tuple[State, int, int], Path | None] = {}
    while queue and not coupling.deadline.expired():
        _, _, cost, state, robot, there, drives = heapq.heappop(queue)
        if robot >= 0:
            after = (*state[:robot], there, *state[robot + 1 :])
            if after in settled:
                continue
            key = (state, robot, there)
            if key not in known:
                if coupling.planned >= coupling.tuning.drives:
                    return None
                known[key] = coupling.drive(robot, state, there)
                path = known[key]
                if path is not None:
                    # its turn comes again with what the drive really takes
                    real = cost + path.natural.duration
                    again = (real + to_go(after), next(ticket), cost, state, robot, there, drives)
                    heapq.heappush(queue, again)
                continue
            path = known[key]
            if path is None:
                continue
            cost, state, drives = cost + path.natural.duration, after, (*drives, (robot, path))
        if state in settled:
            continue
        settled.add(state)
        if state == goal:
            return [(one,) for one in drives]
        for i, at in enumerate(state):
            for place in range(len(coupling.places[i])):
                after = (*state[:i], place, *state[i + 1 :])
                if place != at and after not in settled:
                    least = cost + coupling.bound(i, at, place) + to_go(after)
                    heapq.heappush(queue, (least, next(ticket), cost, state, i, place, drives))
    return None


def _timed(coupling: Coupling, sequence: Sequence[Drives]) -> list[list[TimedPath]] | None:
    """Return the drives of each robot, every one as early as those before it in the sequence
    allow.
    """
    workspace, motions = coupling.workspace, coupling.motions
    legs: list[list[TimedPath]] = [
        [replace(rest_run(workspace, Rest(m.object, m.body, m.poses[0])), avoid=m.avoid)]
        for m in motions
    ]
    for drives in sequence:
        robots = {robot for robot, _ in drives}
        others = [run for i, runs in enumerate(legs) if i not in robots for run in runs]
        parts = [_leg(motions[robot], legs[robot], path) for robot, path in drives]
        found = _begun(coupling, parts, [*coupling.world, *others])
        if found is None:
            return None
        for (robot, _), (_, window, _), run in zip(drives, parts, found, strict=True):
            last, moved = legs[robot][-1], len(legs[robot]) > 1
            # from then on the robot is where this drive leaves it
            until = min(last.until, window.since if moved else run.since)
            legs[robot][-1] = replace(last, until=until)
            legs[robot].append(run)
    return [runs[1:] for runs in legs]


def _leg(
    motion: TimedMotion, legs: Sequence[TimedPath], path: Path
) -> tuple[TimedMotion, Window, Path]:
    """Return a robot's next drive after those in ``legs``, and when it may begin."""
    last, moved = legs[-1], len(legs) > 1
    since = last.arrival if moved else motion.present_from
    window = Window(since, max(motion.release, last.arrival) if moved else motion.release)
    final = path.poses[-1][:2].tolist() == list(motion.poses[1][:2])
    leg = replace(
        motion,
        poses=(_pose(path, 0), _pose(path, -1)),
        release=window.release,
        present_until=motion.present_until if final else math.inf,
    )
    return leg, window, path


def _begun(
    coupling: Coupling,
    parts: Sequence[tuple[TimedMotion, Window, Path]],
    others: Sequence[TimedPath],
) -> list[TimedPath] | None:
    """Return the runs of drives that go at the same time: one with its speed tuned, several begun
    together, as early as all of them can.
    """
    if len(parts) == 1:
        run = fit(coupling.workspace, *parts[0], others)
        return None if run is None else [run]
    begin = max(window.release for _, window, _ in parts)
    for _ in range(coupling.tuning.begins):
        found = []
        for leg, window, path in parts:
            start = first_start(
                coupling.workspace, leg, replace(window, release=begin), path, others
            )
            if start is None:
                return None
            found.append(start)
        if max(found) <= begin:
            return [
                run_of(leg, path, natural_timing(path, begin), window.since)
                for leg, window, path in parts
            ]
        begin = max(found)
    return None


def _pose(path: Path, index: int) -> Configuration:
    return tuple(float(x) for x in path.poses[index])


def _one_run(motion: TimedMotion, legs: Sequence[TimedPath]) -> TimedPath:
    """Return the drives of one robot as one run, with rests in between."""
    times, poses = [legs[0].timing.trajectory.times], [legs[0].timing.trajectory.poses]
    for leg in legs[1:]:
        t, rows = leg.timing.trajectory.times, leg.timing.trajectory.poses.copy()
        rows[:, 2] += 2 * math.pi * round((poses[-1][-1, 2] - rows[0, 2]) / (2 * math.pi))
        # without a wait the last pose is already there
        skip = 1 if t[0] <= times[-1][-1] + 1e-9 else 0
        times.append(t[skip:])
        poses.append(rows[skip:])
    whole = Trajectory(np.concatenate(times), np.concatenate(poses))
    stops = [_pose(leg.path, -1) for leg in legs]
    path = path_of(whole, motion.body, (motion.poses[0], *stops))
    return run_of(motion, path, Timing(whole, path.natural_s), legs[0].since)
