"""Robots that meet in a way as thin as they are wide, where one of them knows another such way."""

from types import SimpleNamespace

import pytest

from tests.motion.fleet.independent import judge
from tests.soundness.known_plans import SECONDS, KnownPlan
from up_samp.geometry.maps import load_map
from up_samp.model import Deadline, GroupQuery, TimedMotion
from up_samp.motion.service import MotionService
from up_samp.upio import read_problem


@pytest.mark.parametrize("seed", [67])
def test_one_takes_the_other_way(seed, tmp_path):
    world = KnownPlan(seed, tmp_path)
    snapshot = read_problem(world.problem, SECONDS)
    grid = load_map(tmp_path / f"known{seed}.yaml")
    motions = [
        TimedMotion(
            f"go{n}",
            f"r{n}",
            snapshot.objects[f"r{n}"].body,
            tuple(snapshot.configurations[f"{end}{n}"] for end in ("from", "to")),
            0.0,
            drive.end * SECONDS,
        )
        for n, drive in enumerate(world.drives)
    ]
    query = GroupQuery(tuple(motions), ())
    report = MotionService(grid).coordinate(query, Deadline.never())
    arrivals = judge(SimpleNamespace(query=query, grid=grid), report, tmp_path)
    assert arrivals <= 1.3 * sum(motion.due for motion in motions)
