"""Groups judged by the independent validator: its limits, its swept collision checks."""

import itertools
import math
from pathlib import Path

import numpy as np

from up_samp.geometry.maps import write_map
from up_samp.model import Outcome
from up_samp.validation.collisions import BlockedMap, JudgedShape, Track, hits_body, hits_map
from up_samp.validation.kinematics import Limits, motion_violations
from up_samp.validation.zones import zone_violations


def limits_of(name, body):
    kin = body.kinematics
    back = min(kin.v_back, kin.v_max) if kin.reverse else 0.0
    numbers = kin.turning_radius, kin.v_max, back, kin.a_max, kin.omega_max
    return Limits(name, kin.model.name, *numbers, zones=kin.zones)


def broken_by(name, body, motion):
    """What the validator has against a motion of a body: its limits, and the rules of zones."""
    limits, shape = limits_of(name, body), JudgedShape(name, np.array(body.footprint))
    parts = [(shape, motion.poses)]
    return [
        *motion_violations(name, limits, motion.times, motion.poses),
        *zone_violations(name, limits, parts, 0.0, motion.times, motion.poses),
    ]


def judge(traffic, report, folder: Path):
    """Assert that everybody gets from start to goal, as its body can, and meets nothing."""
    assert report.outcome is Outcome.FOUND, report.reason
    motions, found = traffic.query.motions, report.trajectories
    assert set(found) == {m.name for m in motions}
    blocked = BlockedMap(write_map(folder, "map", traffic.grid.occupied, traffic.grid.resolution))
    low = min(t.start for t in found.values()) - 1.0
    high = max(t.end for t in found.values()) + 1.0
    shapes, tracks = {}, {}
    for m in motions:
        trajectory = found[m.name]
        assert trajectory.start >= m.release - 1e-9
        for row, pose in ((0, m.poses[0]), (-1, m.poses[-1])):
            assert trajectory.poses[row, :2].tolist() == list(pose[:2])
            turn = (trajectory.poses[row, 2] - pose[2]) / (2 * math.pi)
            assert abs(turn - round(turn)) < 1e-9
        assert not broken_by(m.name, m.body, trajectory)
        shapes[m.name] = JudgedShape(m.object, np.array(m.body.footprint))
        tracks[m.name] = Track(trajectory.times, trajectory.poses, shapes[m.name].radius)
        assert hits_map(shapes[m.name], tracks[m.name], blocked, low, high) is None, m.name
    for a, b in itertools.combinations(found, 2):
        when = hits_body(shapes[a], tracks[a], shapes[b], tracks[b], low, high)
        assert when is None, f"{a} and {b} meet at {when}"
    return sum(t.end for t in found.values())
