"""Worlds that are built around a plan: drives are drawn first, arcs and lines that no planner
chose, and then walls as close to what they sweep as a seed says, with a few ways beside.

So what a world was built around is a plan of it, and nothing slower may be called optimal.
"""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass

import numpy as np
import shapely
from unified_planning.environment import get_environment
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)

from tests.shuffled import shuffled
from tests.soundness.worlds import BOX, placed
from up_samp.geometry.maps import write_map
from up_samp.model import CandidateSchedule, Trajectory
from up_samp.upio import build_plan, read_problem

SECONDS = 0.1
"""Seconds per unit: a claim is as fine as motions are."""
STEP = 0.02
"""Seconds between the poses of a drive."""
CELL, SIZE = 0.05, (12.0, 9.0)
V, A, OMEGA = 1.0, 0.5, 1.0
MODELS = {
    "omni": (MotionModels.SE2, {}),
    "car": (MotionModels.REEDSSHEPP, {"turning_radius": 0.6}),
    "differential": (MotionModels.REEDSSHEPP, {"turning_radius": 0.0}),
}
SPARE = (0.03, 0.06, 0.12, 0.3)
"""Metres between what robots sweep and the walls."""
TRIES = 2000


class NoPlanError(Exception):
    """The random drives came to nothing: take another seed."""


@dataclass
class Drive:
    """A robot's motion in the plan that is known: it begins after ``wait`` units."""

    motion: Trajectory
    wait: int = 0

    @property
    def end(self) -> int:
        return self.wait + math.ceil(self.motion.duration / SECONDS - 1e-6)

    def pose(self, seconds: float):
        since = seconds - self.wait * SECONDS
        return [np.interp(since, self.motion.times, column) for column in self.motion.poses.T]


class KnownPlan:
    """A world of a seed with a plan: ``makespan`` is what that takes (units)."""

    def __init__(self, seed: int, folder) -> None:
        self.rng, self.seed = random.Random(f"known {seed}"), seed
        self.kind = self.rng.choice(sorted(MODELS))
        self.drives: list[Drive] = []
        self.spare = self.rng.choice(SPARE)
        for _ in range(self.rng.choice((1, 2, 2, 3))):
            self._add()
        self.makespan = max(drive.end for drive in self.drives)
        write_map(folder, f"known{seed}", self._walls(), CELL)
        self.problem = self._problem(folder / f"known{seed}.yaml")

    # -- the plan ----------------------------------------------------------------------------------
    def _add(self) -> None:
        """Add a drive that keeps clear of those before, if it waits long enough."""
        for _ in range(TRIES):
            drive = Drive(_drawn(self.rng, self.kind))
            x, y = drive.motion.poses[:, :2].T
            if min(*x, *y) < 0.7 or max(x) > SIZE[0] - 0.7 or max(y) > SIZE[1] - 0.7:
                continue
            last = max((other.end for other in self.drives), default=0)
            for drive.wait in (0, *sorted(self.rng.sample(range(last + 1), min(last, 5)))):
                if all(_apart(drive, other) for other in self.drives):
                    self.drives.append(drive)
                    return
        raise NoPlanError

    # -- the world ---------------------------------------------------------------------------------
    def _walls(self):
        """Return what is occupied: all but what is swept and a few ways beside it."""
        free = shapely.union_all([_swept(drive) for drive in self.drives]).buffer(self.spare)
        boxes = []
        for _ in range(self.rng.randint(0, 6)):
            x, y = self.rng.uniform(0.3, SIZE[0] - 1.5), self.rng.uniform(0.3, SIZE[1] - 1.5)
            wide, long = self.rng.uniform(0.9, 1.6), self.rng.uniform(2.0, 9.0)
            w, h = self.rng.choice(((wide, long), (long, wide)))
            boxes.append(shapely.box(x, y, min(x + w, SIZE[0] - 0.2), min(y + h, SIZE[1] - 0.2)))
        free = shapely.union_all([free, *boxes])
        shapely.prepare(free)
        rows, columns = (round(v / CELL) for v in reversed(SIZE))
        x, y = np.meshgrid(np.arange(columns) * CELL, np.arange(rows) * CELL)
        return ~shapely.intersects(free, shapely.box(x, y, x + CELL, y + CELL))

    def _problem(self, map_file):
        env = get_environment()
        types = env.type_manager
        place = types.ConfigurationType(
            "place", OccupancyMap(str(map_file), (0, 0)), ConfigurationKind.SE2
        )
        problem = SchedulingMotionProblem(f"known{self.seed}", env)
        model, more = MODELS[self.kind]
        for i, drive in enumerate(self.drives):
            ends = []
            for name, pose in (
                (f"from{i}", drive.motion.poses[0]),
                (f"to{i}", drive.motion.poses[-1]),
            ):
                ends.append(ConfigurationObject(name, place, SE2(*map(float, pose)), env))
                problem.add_object(ends[-1])
            robot = MovableObject(
                f"r{i}",
                types.MovableType("robot"),
                footprint=list(BOX),
                motion_model=model,
                motion_parameters={"v_max": V, "a_max": A, "omega_max": OMEGA, **more},
                env=env,
            )
            problem.add_object(robot)
            problem.set_initial_configuration(robot, ends[0])
            go = problem.add_motion_activity(f"go{i}", 1)
            go.set_duration_bounds(1, 10_000)
            go.add_motion_constraint(ActivityWaypoints(robot, ends[0], ends[1:]))
        problem.add_quality_metric(MinimizeMakespan())
        return shuffled(problem, self.seed, rename=False).problem

    def plan(self):
        """Return the plan that the world was built around."""
        times = {f"go{i}": (drive.wait, drive.end) for i, drive in enumerate(self.drives)}
        motions = {
            f"go{i}": drive.motion.shifted(drive.wait * SECONDS)
            for i, drive in enumerate(self.drives)
        }
        snapshot = read_problem(self.problem, SECONDS)
        return build_plan(self.problem, snapshot, CandidateSchedule(times), motions)


def _drawn(rng, kind) -> Trajectory:
    """Return a drive from somewhere, at rest where it turns back or on the spot."""
    pose = np.array(
        [*(rng.uniform(0.7, size - 0.7) for size in SIZE), rng.uniform(-math.pi, math.pi)]
    )
    times, poses = [0.0], [pose]
    slides = kind == "omni" and rng.random() < 0.5
    for number in range(rng.choice((1, 1, 2, 3))):
        if number and kind == "differential":
            turn = rng.uniform(0.5, 2.5) * rng.choice((-1, 1))
            ahead = [poses[-1] + (0, 0, turn * s) for s in _shares(abs(turn), OMEGA, OMEGA)]
        else:
            back = number % 2 == 1 and kind != "omni"
            ahead = _run(rng, poses[-1], back)
        times += [times[-1] + STEP * (k + 1) for k in range(len(ahead))]
        poses += ahead
    told = np.array(poses)
    if slides:
        told[:, 2] = told[0, 2]
    return Trajectory(np.array(times), told)


def _shares(length, v, a):
    """Yield how much of a length is behind after each step, from rest to rest."""
    ramp = min(v / a, math.sqrt(length / a))
    total = length / (a * ramp) + ramp
    for t in np.linspace(0.0, total, math.ceil(total / STEP) + 1)[1:]:
        rest = max(0.0, t - (total - ramp))
        yield (a * ramp * (t - min(t, ramp)) + 0.5 * a * (min(t, ramp) ** 2 - rest**2)) / length


def _run(rng, pose, back):
    """Return the poses of lines and arcs from rest to rest, at a speed at which all are driven."""
    bends = [rng.uniform(0.3, 1.2) * rng.choice((-1, 1)) for _ in range(rng.randint(0, 3))]
    v = min([V, *(min(OMEGA / abs(k), math.sqrt(A / abs(k))) for k in bends)])
    parts = [(0.0, rng.uniform(1.0, 2.5))]
    for k in bends:
        parts += [(k, rng.uniform(0.4, 2.2) / abs(k)), (0.0, rng.choice((0.0, rng.uniform(0, 2))))]
    parts.append((0.0, 1.0))
    length = sum(part for _, part in parts)
    return [
        _along(pose, parts, share * length, -1 if back else 1) for share in _shares(length, v, A)
    ]


def _along(pose, parts, way, sign):
    """Return where one is after ``way`` metres of lines and arcs."""
    x, y, turn = pose
    for k, length in parts:
        part = min(way, length)
        way -= part
        bend = k * part
        chord = part * (2.0 * math.sin(bend / 2) / bend if bend else 1.0)
        x += sign * chord * math.cos(turn + sign * bend / 2)
        y += sign * chord * math.sin(turn + sign * bend / 2)
        turn += sign * bend
    return np.array([x, y, turn])


def _swept(drive: Drive):
    """Return what a drive sweeps, hardly less."""
    poses = [*drive.motion.poses[::5], drive.motion.poses[-1]]
    shapes = [placed(BOX, pose) for pose in poses]
    return shapely.union_all([a.union(b).convex_hull for a, b in itertools.pairwise(shapes)])


def _apart(one: Drive, other: Drive) -> bool:
    """Return whether two drives keep clear of each other, and of where the other one rests."""
    last = max(one.end, other.end) * SECONDS
    for seconds in np.arange(0.0, last + 0.05, 0.05):
        a, b = placed(BOX, one.pose(seconds)), placed(BOX, other.pose(seconds))
        if a.distance(b) < 0.06:
            return False
    return True
