"""A naive judge of planar motions (shapely) and a small world to plan in."""

import math

import numpy as np
import shapely
from shapely import affinity

from up_samp.geometry import OccupancyGrid, Scene
from up_samp.model import Body, Kinematics, MotionModel, Placed, interpolate

FOOTPRINT = ((-0.5, -0.3), (0.7, -0.3), (0.7, 0.3), (-0.5, 0.3))
CAR = Body(FOOTPRINT, Kinematics(MotionModel.REEDSSHEPP, 0.8, 1.5, 0.7))
OMNI = Body(FOOTPRINT, Kinematics(MotionModel.SE2, 1.0, 1.5, 0.7, 0.9))
DOOR = Placed("door", Body(((-0.2, -1.2), (0.2, -1.2), (0.2, 1.2), (-0.2, 1.2)), OMNI.kinematics),
              (10.0, 6.0, 0.0))  # fmt: skip
CRATE = Placed("crate", Body(((-0.4, -0.4), (0.4, -0.4), (0.0, 0.5)), OMNI.kinematics),
               (5.0, 6.0, 0.4))  # fmt: skip
START, GOAL = (3.0, 3.0, 0.0), (17.0, 9.0, math.pi / 2)


def unicycle(q, u, qdot):
    qdot[0] = u[0] * math.cos(q[2])
    qdot[1] = u[0] * math.sin(q[2])
    qdot[2] = u[1]


def hall(gap=True):
    """A hall of 20 m x 12 m with a wall in the middle, and a gap of 2 m in it."""
    occupied = np.zeros((120, 200), dtype=bool)
    occupied[:2] = occupied[-2:] = True
    occupied[:, :2] = occupied[:, -2:] = True
    occupied[:, 97:103] = True
    if gap:
        occupied[50:70, 97:103] = False
    return OccupancyGrid(occupied, 0.1)


def hall_scene(gap=True):
    return Scene(hall(gap))


def walls(grid):
    """The blocked cells as one polygon."""
    size = grid.resolution
    rows, cols = np.nonzero(grid.blocked)
    boxes = shapely.box(cols * size, rows * size, (cols + 1) * size, (rows + 1) * size)
    return shapely.union_all(boxes)


def placed(body, pose):
    polygon = affinity.rotate(shapely.Polygon(body.footprint), pose[2], (0, 0), use_radians=True)
    return affinity.translate(polygon, pose[0], pose[1])


def clearance(body, poses, world):
    """The smallest distance to ``world`` over all poses and three between each two."""
    best = math.inf
    for i in range(len(poses)):
        shares = (0.0, 0.25, 0.5, 0.75) if i + 1 < len(poses) else (0.0,)
        for share in shares:
            pose = poses[i] if share == 0.0 else interpolate(poses[i], poses[i + 1], share)
            best = min(best, placed(body, pose).distance(world))
    return best


def obstacles_of(items):
    return shapely.union_all([placed(p.body, p.pose) for p in items])


def check_limits(body, trajectory):
    """Speeds, accelerations and turn rates between samples, by plain differences."""
    limits = body.kinematics
    dt = np.diff(trajectory.times)
    assert dt.max() <= 0.05 + 1e-9
    chord = np.diff(trajectory.poses[:, :2], axis=0)
    turn = np.diff(trajectory.poses[:, 2])
    speed = np.linalg.norm(chord, axis=1) / dt
    assert speed.max() <= limits.v_max * 1.001
    if limits.model is MotionModel.SE2:
        assert (np.abs(turn) / dt).max() <= limits.omega_max * 1.001
        velocity = chord / dt[:, None]
    else:
        middle = trajectory.poses[:-1, 2] + turn / 2
        along = chord[:, 0] * np.cos(middle) + chord[:, 1] * np.sin(middle)
        across = chord[:, 1] * np.cos(middle) - chord[:, 0] * np.sin(middle)
        assert np.abs(across).max() < 1e-6
        assert np.all(np.abs(turn) <= np.abs(along) / limits.turning_radius * 1.001 + 1e-9)
        arc = along / np.sinc(turn / 2 / math.pi)
        velocity = arc[:, None] / dt[:, None]
    between = (dt[1:] + dt[:-1]) / 2
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / between
    assert change.max() <= limits.a_max * 1.01
    for i in (0, -1):
        assert np.linalg.norm(velocity[i]) / (dt[i] / 2) <= limits.a_max * 1.01
