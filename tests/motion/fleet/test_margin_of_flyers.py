"""The margin between flyers, drivers below them and walls: random halls before a judge of
distances between boxes.
"""

import itertools
import math
import random

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from tests.motion.fleet.flying import BOX, UPRIGHT, World

pytest.importorskip("coal")
NEAR = 2e-3
"""m that samples of edges and of times may be off."""
TALL = 1.2
SIZES = ((0.8, 0.8, 0.3), (0.6, 0.6, 0.6), (1.2, 0.4, 0.3))
WALLS = shapely.box(-1, -1, 21, 13).difference(
    shapely.union_all(
        [
            shapely.box(0.2, 0.2, 9.9, 11.8),
            shapely.box(9.8, 4, 10.2, 8),
            shapely.box(10.1, 0.2, 19.8, 11.8),
        ]
    )
)


class Box:
    """A box of ``size`` around ``centre`` of the body's frame, which is at ``pose``."""

    def __init__(self, size, centre, pose):
        self.half, self.centre = np.array(size) / 2, np.array(centre)
        if len(pose) == 3:
            self.at = np.array([pose[0], pose[1], 0.0])
            self.turn = Rotation.from_euler("z", pose[2])
        else:
            self.at, self.turn = np.array(pose[:3]), Rotation.from_quat(pose[3:])

    @property
    def corners(self):
        signs = np.array(list(itertools.product((-1, 1), repeat=3)))
        return self.turn.apply(self.centre + signs * self.half) + self.at

    @property
    def edges(self):
        """Points along all edges."""
        corners = self.corners
        pairs = [(i, j) for i, j in itertools.combinations(range(8), 2) if (i ^ j) in (1, 2, 4)]
        share = np.linspace(0.0, 1.0, 41)[:, None]
        return np.concatenate([corners[i] + share * (corners[j] - corners[i]) for i, j in pairs])

    def from_points(self, points):
        """Return the least distance (m) of points from the box."""
        there = self.turn.inv().apply(points - self.at) - self.centre
        return float(np.linalg.norm(np.maximum(np.abs(there) - self.half, 0.0), axis=1).min())

    def distance(self, other):
        """Return the distance (m) to another box: it is met at an edge of one of them."""
        return min(self.from_points(other.edges), other.from_points(self.edges))

    def wall(self):
        return shapely.MultiPoint(self.corners[:, :2]).convex_hull.distance(WALLS)


def hall(folder, seed):
    """Return a problem with two or three bodies that cross the gap, and by activity the boxes."""
    rng = random.Random(seed)
    world, boxes = World(folder), {}
    taken = []

    def spot(side, flies):
        while True:
            x = rng.uniform(2.0, 7.5) if side else rng.uniform(12.5, 18.0)
            y = rng.uniform(2.0, 10.0)
            if all(math.hypot(x - a, y - b) > 2.2 for a, b in taken):
                taken.append((x, y))
                return (x, y, rng.uniform(2.0, 2.6), *UPRIGHT) if flies else (x, y, 0.0)

    for k in range(rng.choice((2, 2, 3))):
        flies, side, size = k < 1 or rng.random() < 0.7, rng.random() < 0.5, rng.choice(SIZES)
        start, goal = spot(side, flies), spot(not side, flies)
        if flies:
            body = world.flyer(f"drone{k}", start, size)
            boxes[f"go{k}"] = (size, (0.0, 0.0, 0.0))
        else:
            limits = {"v_max": 1.5, "a_max": 1.0, "height": TALL}
            body = world.flat(f"cart{k}", start, corners=BOX, motion_parameters=limits)
            boxes[f"go{k}"] = ((1.0, 0.6, 2 * TALL), (0.0, 0.0, 0.0))
        world.move(f"go{k}", body, body.home, world.place(*goal))
    return world.problem, boxes


def too_close(folder, seed, margin):
    """Return who comes closer than the margin while it moves; None where there is no plan."""
    get_environment().credits_stream = None
    problem, boxes = hall(folder, seed)
    params = {"margin": margin, "seconds_per_unit": 0.5}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60)
    if result.status not in (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY):
        return None
    ways, found = result.plan.trajectories, {}
    for t in np.arange(0.0, max(w.end for w in ways.values()), 0.05):
        there = {name: Box(*boxes[name], way.at(t)) for name, way in ways.items()}
        moves = {name for name, way in ways.items() if way.start < t < way.end}
        for pair in itertools.combinations(there, 2):
            if moves & set(pair):
                gap = there[pair[0]].distance(there[pair[1]])
                found[pair] = min(gap, found.get(pair, math.inf))
        for name in moves:
            found[name] = min(there[name].wall(), found.get(name, math.inf))
    return {who: gap for who, gap in found.items() if gap < margin - NEAR}


@pytest.mark.parametrize("margin", [pytest.param(0.1, marks=pytest.mark.long), 0.3])
def test_flyers_keep_the_margin(margin, tmp_path):
    assert too_close(tmp_path, 2, margin) == {}


@pytest.mark.long
@pytest.mark.parametrize("margin", [0.05, 0.1, 0.3, 1.0])
def test_many_flyers_and_drivers_keep_the_margin(margin, tmp_path):
    answers = {}
    for seed in range(100, 120):
        (tmp_path / str(seed)).mkdir()
        answers[seed] = too_close(tmp_path / str(seed), seed, margin)
    assert sum(answer is not None for answer in answers.values()) >= 15
    assert {seed: answer for seed, answer in answers.items() if answer} == {}
