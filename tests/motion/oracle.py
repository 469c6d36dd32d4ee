"""Naive judges of motions (shapely, plain Python), shared by the tests of this folder."""

import math

import numpy as np
import shapely
from shapely import affinity

from up_samp.geometry import OccupancyGrid
from up_samp.model import Body, Kinematics, MotionModel, Placed

CAR = Kinematics(MotionModel.REEDSSHEPP, turning_radius=1.0, v_max=2.0, a_max=0.5)
RECTANGLE = ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))
ROBOT = Body(RECTANGLE, CAR)
DOOR = Body(((-0.5, -5.0), (0.5, -5.0), (0.5, 5.0), (-0.5, 5.0)), CAR)


def box_map(width, height, walls=(), resolution=0.1):
    """Return a map with an outer wall of two cells and ``walls`` (x0, y0, x1, y1), in m."""
    cells = np.zeros((round(height / resolution), round(width / resolution)), dtype=bool)
    cells[:2] = cells[-2:] = True
    cells[:, :2] = cells[:, -2:] = True
    for x0, y0, x1, y1 in walls:
        rows = slice(round(y0 / resolution), round(y1 / resolution))
        cells[rows, round(x0 / resolution) : round(x1 / resolution)] = True
    return OccupancyGrid(cells, resolution)


def logistics_map():
    return box_map(100, 65, [(52, 35, 100, 40), (52, 20, 100, 25)])


def shape_at(footprint, pose):
    turned = affinity.rotate(shapely.Polygon(footprint), pose[2], origin=(0, 0), use_radians=True)
    return affinity.translate(turned, pose[0], pose[1])


def walls_near(grid, x, y, reach):
    """Return the blocked cells near a point (and those outside the map)."""
    size, (rows, cols) = grid.resolution, grid.shape
    r = np.arange(int((y - reach) / size), int((y + reach) / size) + 1)
    c = np.arange(int((x - reach) / size), int((x + reach) / size) + 1)
    beside = ((r < 0) | (r >= rows))[:, None] | (c < 0) | (c >= cols)
    blocked = grid.blocked[np.ix_(r.clip(0, rows - 1), c.clip(0, cols - 1))]
    up, right = np.nonzero(beside | blocked)
    r, c = r[up], c[right]
    return shapely.box(c * size, r * size, (c + 1) * size, (r + 1) * size)


def smallest_clearance(trajectory, body, grid=None, obstacles: tuple[Placed, ...] = (), pieces=2):
    """Return the smallest distance to anything, looking between the samples, too."""
    best = math.inf
    others = [shape_at(p.body.footprint, p.pose) for p in obstacles]
    reach = max(math.hypot(*p) for p in body.footprint) + 0.3
    for i in range(len(trajectory.times) - 1):
        for share in range(pieces):
            t = trajectory.times[i] + share / pieces * (
                trajectory.times[i + 1] - trajectory.times[i]
            )
            pose = trajectory.at(float(t))
            me = shape_at(body.footprint, pose)
            for other in others:
                best = min(best, me.distance(other))
            if grid is not None and (i + share) % 5 == 0:
                walls = walls_near(grid, pose[0], pose[1], reach)
                best = min(best, shapely.distance(me, walls).min(initial=math.inf))
    return best


def car_faults(trajectory, kinematics):
    """Return what breaks the model of a car that rests at the start, the end and each cusp."""
    t, p = trajectory.times, trajectory.poses
    dt = np.diff(t)
    d = np.diff(p, axis=0)
    turn = d[:, 2]
    chord = np.hypot(d[:, 0], d[:, 1])
    half = turn / 2
    arc = chord * np.where(np.abs(half) > 1e-9, half / np.sin(np.where(half == 0, 1, half)), 1.0)
    mid = p[:-1, 2] + half
    along = d[:, 0] * np.cos(mid) + d[:, 1] * np.sin(mid)
    slip = -d[:, 0] * np.sin(mid) + d[:, 1] * np.cos(mid)
    s = np.sign(along) * arc
    v = s / dt
    faults = []
    if np.any(dt > trajectory.MAX_STEP + 1e-9):
        faults.append("samples too far apart")
    if np.any(np.abs(slip) > 1e-6):
        faults.append(f"side slip {np.abs(slip).max()}")
    if np.any(np.abs(turn) > arc / kinematics.turning_radius + 1e-7):
        faults.append("turns too tightly")
    if np.any(np.abs(v) > kinematics.v_max * (1 + 1e-9)):  # rounding
        faults.append(f"too fast {np.abs(v).max()}")
    middle = (t[:-1] + t[1:]) / 2
    a = np.diff(v) / np.diff(middle)
    if np.any(np.abs(a) > kinematics.a_max * (1 + 1e-4)):
        faults.append(f"accelerates too much {np.abs(a).max()}")
    for i in np.nonzero(v[:-1] * v[1:] < 0)[0]:  # rest at the cusp: what each side needs to stop
        if abs(v[i]) > kinematics.a_max * dt[i] / 2 * 1.001:
            faults.append("no rest at a cusp")
    ends = ((abs(v[0]), dt[0]), (abs(v[-1]), dt[-1]))
    if any(speed > kinematics.a_max * step / 2 * 1.001 for speed, step in ends):
        faults.append("not from rest to rest")
    return faults


def ends_exactly(trajectory, start, goal):
    first, last = trajectory.poses[0], trajectory.poses[-1]
    same = [abs(a - b) for a, b in zip(first[:2], start[:2], strict=True)]
    same += [abs(a - b) for a, b in zip(last[:2], goal[:2], strict=True)]
    same += [abs(math.remainder(first[2] - start[2], 2 * math.pi))]
    same += [abs(math.remainder(last[2] - goal[2], 2 * math.pi))]
    return max(same) < 1e-9 and trajectory.times[0] == 0.0
