"""Bounds that know of slow zones: never more than what can be driven, and more than without."""

import itertools
import math
import random
from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.motion.oracle import ROBOT, box_map
from tests.usual import usually
from up_samp.geometry import OccupancyGrid
from up_samp.geometry.shapes import core_of, shape_of
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery, TrafficZone
from up_samp.model.frames import Frame
from up_samp.motion import MotionService
from up_samp.motion.proofs.bounds import fastest_with_slow

KINDS = {
    "car": Kinematics(MotionModel.REEDSSHEPP, 0.8, 1.5, 0.7),
    "differential": Kinematics(MotionModel.PIVOT, v_max=1.5, a_max=0.7, omega_max=0.8),
    "omni": Kinematics(MotionModel.SE2, v_max=1.5, a_max=0.7, omega_max=0.8),
}
RADIUS = shape_of(core_of(ROBOT)).inscribed


def quickest(length, caps, v_max, a_max, steps=4000):
    """Return the seconds of the fastest drive from rest to rest, on a grid of the way: ``caps``
    are (from, to, m/s).
    """
    at = (np.arange(steps) + 0.5) / steps * length
    most = np.full(steps, v_max**2)
    for low, high, cap in caps:
        most[(at >= low) & (at < high)] = cap**2
    step = length / steps
    for order in (range(steps), range(steps - 1, -1, -1)):
        square = 0.0
        for k in order:
            square = min(most[k], square + 2 * a_max * step)
            most[k] = square
    return float(np.sum(step / np.sqrt(most)))


@pytest.mark.parametrize("seed", range(40))
def test_no_order_of_slow_parts_is_quicker_than_the_bound(seed):
    rng = random.Random(seed)
    length, v_max, a_max = rng.uniform(1, 30), rng.uniform(0.5, 2), rng.uniform(0.2, 2)
    parts = [(rng.uniform(0.05, 0.3) * length, rng.uniform(0.1, v_max)) for _ in range(3)]
    parts = parts[: rng.randint(1, 3)]
    least = fastest_with_slow(length, parts, v_max, a_max)
    free = length - sum(metres for metres, _ in parts)
    for _ in range(5):
        cuts = sorted(rng.uniform(0, free) for _ in parts)
        at, caps = 0.0, []
        for k, (metres, cap) in enumerate(rng.sample(parts, len(parts))):
            begin = cuts[k] + at
            caps.append((begin, begin + metres, cap))
            at += metres
        assert quickest(length, caps, v_max, a_max) > 0.985 * least
    # half of each at either end, the slowest outside: that is what the bound takes
    caps, at = [], 0.0
    for metres, cap in sorted(parts, key=lambda part: part[1]):
        caps += [(at, at + metres / 2, cap), (length - at - metres / 2, length - at, cap)]
        at += metres / 2
    assert quickest(length, caps, v_max, a_max) == pytest.approx(least, rel=0.03)


def drawn_floor(rng):
    """Return a hall with a wall or two, its map turned and moved, and slow zones in any order."""
    walls = [(6, 0, 6.4, rng.uniform(3, 6)), (10, rng.uniform(3, 6), 10.4, 9)]
    plain = box_map(16, 9, walls[: rng.randint(0, 2)], 0.2)
    frame = Frame(rng.uniform(-5, 5), rng.uniform(-5, 5), rng.choice((0.0, rng.uniform(-3, 3))))
    grid = OccupancyGrid(plain.blocked, plain.resolution, (frame.x, frame.y, frame.yaw))
    zones = []
    for _ in range(rng.randint(1, 4)):
        x, wide = rng.uniform(0, 13), rng.uniform(0.5, 4)
        y, tall = rng.choice(((0.0, 9.0), (0.0, 9.0), (rng.uniform(0, 6), rng.uniform(1, 5))))
        corners = [(x, y), (x + wide, y), (x + wide, y + tall), (x, y + tall)]
        zones.append(TrafficZone(tuple(map(tuple, frame.points(corners))), rng.uniform(0.1, 1.2)))
    rng.shuffle(zones)
    return grid, frame, tuple(zones)


def slow_metres(motion, zone):
    """Return how much of a motion the disc about the reference point overlaps a zone, by many
    points.
    """
    area = shapely.Polygon(zone.polygon).buffer(RADIUS)
    ends = motion.poses[:, :2]
    total = 0.0
    for a, b in itertools.pairwise(ends):
        shares = (np.arange(8) + 0.5)[:, None] / 8
        inside = shapely.contains_xy(area, a + shares * (b - a)).mean()
        total += float(inside) * math.dist(a, b)
    return total


@pytest.mark.parametrize("kind", usually("car", of=sorted(KINDS)))
def test_what_can_be_driven_keeps_all_bounds(kind):
    more = found = 0
    for seed in range(14):
        rng = random.Random(f"{kind} {seed}")
        grid, frame, zones = drawn_floor(rng)
        body = Body(ROBOT.footprint, KINDS[kind])
        slowed = Body(ROBOT.footprint, replace(KINDS[kind], zones=zones))
        service = MotionService(grid)
        ends = []
        while len(ends) < 3:
            x, y = rng.uniform(1.3, 14.7), rng.uniform(1.3, 7.7)
            pose = (*map(float, frame.points([(x, y)])[0]), rng.uniform(-3, 3))
            if service.scene.pose_free(body, pose):
                ends.append(pose)
        report = service.plan(PathQuery(slowed, tuple(ends)), Deadline.after(30))
        if report.outcome is not Outcome.FOUND:
            continue
        found += 1
        for some in (ends[:2], ends):
            least = service.lower_bound(slowed, some)
            assert least <= report.trajectory.duration + 1e-9, seed
            more += least > service.lower_bound(body, some) + 0.1
        for zone in zones:
            known = service.bounds._slow_zone(slowed, zone)
            if known is not None:
                legs = itertools.pairwise(ends)
                metres = sum(service.bounds._slow_way(known, a, b) for a, b in legs)
                assert metres <= slow_metres(report.trajectory, zone) + 0.02, seed
    assert found > 8
    assert more > 4


def test_where_there_is_no_way_nothing_is_said():
    """A wall without a gap, zones on both sides of it, over it and elsewhere."""
    service = MotionService(box_map(16, 9, [(8, 0, 8.4, 9)], 0.2))
    square = ((2.0, 2.0), (6.0, 2.0), (6.0, 7.0), (2.0, 7.0))
    over = ((7.0, 0.0), (10.0, 0.0), (10.0, 9.0), (7.0, 9.0))
    for zones in ((square,), (over,), (square, over), (over, square)):
        rules = tuple(TrafficZone(zone, 0.2) for zone in zones)
        body = Body(ROBOT.footprint, replace(KINDS["omni"], zones=rules))
        for ends in (((4.0, 4.5, 0.0), (13.0, 4.5, 0.0)), ((13.0, 4.5, 0.0), (1.2, 8.0, 0.0))):
            assert math.isfinite(service.lower_bound(body, ends))
            outside = service.lower_bound(body, ((-5.0, 4.5, 0.0), ends[1]))
            assert math.isfinite(outside)
