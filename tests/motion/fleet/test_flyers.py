"""Where bodies in space meet others on their paths, against samples of both."""

import itertools
import math

import numpy as np
import pytest

from tests.usual import usually
from up_samp.geometry.meshes import surface_distance, transform
from up_samp.model import Body, Kinematics, MotionModel, Trajectory
from up_samp.motion.fleet.flyers import in_space, meeting_cells
from up_samp.motion.fleet.paths import path_of, resting_path

pytest.importorskip("coal")
BOX = ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3))


@pytest.fixture
def drone(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.8, 0.6, 0.3)).export(tmp_path / "drone.stl")
    return Body((), Kinematics(MotionModel.SE3), str(tmp_path / "drone.stl"))


def flight(rng, body):
    """A flight of 3 m that turns by up to 2 rad about the upright axis."""
    share = np.linspace(0.0, 1.0, 81)
    start, way = rng.uniform(-1.0, 1.0, 3), rng.normal(size=3)
    centres = start + 3.0 * (share[:, None] - 0.5) * way / np.linalg.norm(way)
    half = 0.5 * (rng.uniform(-3.0, 3.0) + rng.uniform(-2.0, 2.0) * share)
    poses = np.zeros((81, 7))
    poses[:, :3], poses[:, 5], poses[:, 6] = centres, np.sin(half), np.cos(half)
    return path_of(Trajectory(4.0 * share, poses), body)


def drive(rng, height):
    """A straight drive of 3 m of a body of that height."""
    body = Body(BOX, Kinematics(MotionModel.SE2), height=height)
    (x, y), way = rng.uniform(-1.0, 1.0, 2), rng.uniform(-math.pi, math.pi)
    along = np.linspace(-1.5, 1.5, 81)
    poses = np.stack([x + along * math.cos(way), y + along * math.sin(way), np.full(81, way)], 1)
    return path_of(Trajectory(np.linspace(0.0, 4.0, 81), poses), body)


def apart(a, p, b, q):
    places = [transform(in_space(np.array([pose]))[0]) for pose in (p, q)]
    return surface_distance(a.solid.mesh, places[0], b.solid.mesh, places[1])


@pytest.mark.parametrize("seed", usually(0, 1, of=range(6)))
def test_cells_in_which_flyers_meet_are_found(drone, seed):
    rng, margin = np.random.default_rng(seed), 0.05
    a = flight(rng, drone)
    b = flight(rng, drone) if seed % 2 else drive(rng, rng.uniform(0.2, 1.0))
    found = np.zeros((a.cells + 2, b.cells + 2), dtype=bool)
    for i, first, last in meeting_cells(a.solid, b.solid, margin):
        found[i, first : last + 1] = True
    for i, j in itertools.product(range(0, a.cells + 2, 2), range(0, b.cells + 2, 3)):
        near = apart(a, a.middle(i), b, b.middle(j))
        if near < margin - 1e-6:
            assert found[i, j], "they are too close in the middle of these cells"
        inside = 0.0 if seed % 2 else 0.3  # a column's surface is that far from its middle
        if near > max(inside, margin + a.solid.extents[i] + b.solid.extents[j]) + 1e-3:
            assert not found[i, j]


def test_who_flies_inside_of_a_column_meets_it(drone):
    tall = Body(((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)), Kinematics(MotionModel.SE2))
    here = resting_path(drone, (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    assert len(meeting_cells(here.solid, resting_path(tall, (0.0, 0.0, 0.0)).solid, 0.01))
    assert not len(meeting_cells(here.solid, resting_path(tall, (9.0, 0.0, 0.0)).solid, 0.01))
