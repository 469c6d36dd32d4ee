"""The compiled conflict checks and whole groups against a naive oracle (shapely, sampling)."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import Polygon
from shapely.affinity import affine_transform

from tests.motion.fleet.spacetime_oracle import CAR, judge
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Rest,
    TimedMotion,
)
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.conflicts import conflict_runs, conflicting_cells
from up_samp.motion.fleet.paths import path_of, resting_path
from up_samp.motion.service import MotionService

ELL = Body(
    ((-0.8, -0.4), (0.8, -0.4), (0.8, 0.1), (0.0, 0.1), (0.0, 0.6), (-0.8, 0.6)),
    Kinematics(MotionModel.REEDSSHEPP, 0.8, 1.5, 0.7),
)
OPEN = MotionService(None)


def random_pose(rng, size):
    return (*map(float, rng.uniform(0, size, 2)), float(rng.uniform(-math.pi, math.pi)))


def random_path(rng, body, size):
    poses = (random_pose(rng, size), random_pose(rng, size))
    report = OPEN.plan(PathQuery(body, poses), Deadline.never())
    return path_of(report.trajectory, body, poses)


def placed(body, poses):
    polygon = Polygon(body.footprint)
    return np.array(
        [
            affine_transform(polygon, [math.cos(t), -math.sin(t), math.sin(t), math.cos(t), x, y])
            for x, y, t in poses
        ]
    )


def swept(path, per_cell=5):
    """Sampled footprints per extended cell, shape (cells + 2, per_cell)."""
    e = path.edges
    s = [np.zeros(per_cell)]
    s += [np.linspace(e[i], e[i + 1], per_cell) for i in range(path.cells)]
    s.append(np.full(per_cell, e[-1]))
    s = np.array(s)
    return placed(path.body, path.poses_at(s.ravel())).reshape(s.shape)


@pytest.mark.parametrize("seed", range(6))
def test_cells_in_conflict_are_found_and_no_others(seed):
    rng = np.random.default_rng(seed)
    bodies = [CAR, ELL] if seed % 2 else [CAR, CAR]
    a, b = (random_path(rng, body, 6.0) for body in bodies)
    margin = 0.01
    runs = conflict_runs(a.swept, b.swept, margin)
    for most in (1, 40 * len(b.swept.table), 10**9):
        assert np.array_equal(conflicting_cells(a.swept, b.swept, margin, most), runs)
    found = np.zeros((a.cells + 2, b.cells + 2), dtype=bool)
    for i, j0, j1 in runs:
        found[i, j0 : j1 + 1] = True
    fa, fb = swept(a), swept(b)
    assert found.size > 200
    least = np.full(found.shape, np.inf)
    for p in range(fa.shape[1]):
        for q in range(fb.shape[1]):
            d = shapely.distance(fa[:, p][:, None], fb[:, q][None, :])
            least = np.minimum(least, d)
    assert found[least <= margin].all(), "a conflict was missed"
    # sampling sees 1/8 of a cell at best, corners count by their edges' lines
    assert not found[least > 0.12].any(), "cells far apart count as a conflict"


@pytest.mark.parametrize("seed", range(6))
def test_a_body_counts_where_it_is_not_where_its_reference_point_is(seed):
    """Zones have theirs far away, loads beside them: a path may lead right over it."""
    rng = np.random.default_rng(seed)
    a = random_path(rng, CAR, 6.0)
    away = rng.uniform(-3.0, 3.0, 2)
    outline = tuple((float(x + away[0]), float(y + away[1])) for x, y in ELL.footprint)
    x, y, _ = a.poses[len(a.poses) // 2]
    pose = (float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
    body = replace(ELL, footprint=outline)
    runs = conflict_runs(a.swept, resting_path(body, pose).swept, 0.01)
    found = np.zeros(a.cells + 2, dtype=bool)
    found[runs[:, 0]] = True
    least = shapely.distance(swept(a), placed(body, [pose])[0]).min(axis=1)
    assert found[least <= 0.01].all(), "a conflict was missed"
    assert not found[least > 0.12].any(), "cells far apart count as a conflict"


def random_group(seed):
    """Three or four robots in a 16 x 16 m square, with distinct places, and a parked one."""
    rng = np.random.default_rng(seed)
    polygons, poses = [], []
    while len(poses) < 9:
        pose = random_pose(rng, 16.0)
        polygon = placed(CAR, [pose])[0].buffer(0.05)
        if not any(polygon.intersects(other) for other in polygons):
            polygons.append(polygon)
            poses.append(pose)
    motions = []
    for k in range(3 + seed % 2):
        release = float(rng.integers(0, 6))
        due = release + float(rng.integers(10, 25))
        motions.append(
            TimedMotion(f"m{k}", f"o{k}", CAR, (poses[2 * k], poses[2 * k + 1]), release, due)
        )
    until = float(rng.choice([8.0, math.inf]))
    return motions, [Rest("parked", CAR, poses[8], -math.inf, until)]


def check_group(seed):
    motions, rests = random_group(seed)
    report = coordinate(OPEN, GroupQuery(tuple(motions), tuple(rests)), Deadline.after(60))
    if report.outcome is Outcome.FOUND:
        judge(report, motions, rests, 0.05)
        assert bool(report.conflict) == bool(report.late)
    return report.outcome is Outcome.FOUND


@pytest.mark.parametrize("seed", range(4))
def test_random_groups_are_safe(seed):
    check_group(seed)


@pytest.mark.long
def test_many_random_groups_are_safe():
    solved = sum(check_group(seed) for seed in range(100, 220))
    assert solved >= 115
