"""Candidates whose motions come late get the time that each of these motions needs, no more."""

import math

import numpy as np
import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from up_samp import Fleet
from up_samp.geometry.maps import write_map
from up_samp.io import result_to_dict


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


def slow_and_long(folder, robots):
    """Return two robots far from each other: one is slower than bounds know, in a zone, on its
    first way of three; the other one drives all the while, so that all ways make one group.
    """
    cells = np.zeros((80, 400), dtype=bool)
    cells[[0, -1]] = cells[:, [0, -1]] = True
    fleet = Fleet(write_map(folder, "hall", cells, 0.2), name="slow")
    fleet.add_robot_type("cart", footprint=(0.8, 0.6), model="diff", v_max=1.0, a_max=0.5)
    spots = {"slow": ((2, 3), (12, 3), (12, 12), (22, 12)), "quick": ((30, 3), (75, 12))}
    fleet.add_zone("people", [(4, 0), (9, 0), (9, 16), (4, 16)], v_max=0.2)
    for robot in robots:
        for k, (x, y) in enumerate(spots[robot]):
            fleet.add_place(f"{robot}{k}", x, y)
        fleet.add_robot(robot, "cart", start=f"{robot}0")
        for k in range(1, len(spots[robot])):
            after = () if k == 1 else f"task_{robot}{k - 1}"
            at = f"{robot}{k}"
            fleet.add_task(f"task_{at}", at, duration=1, robots=robot, after=after)
    return fleet.problem


@pytest.mark.parametrize("robots", [("slow", "quick"), ("quick", "slow")])
def test_who_comes_late_once_is_late_once(robots, tmp_path):
    problem = slow_and_long(tmp_path, robots)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=60)
    told = result_to_dict(problem, result)
    spans = {a["name"]: a["end"] - a["start"] for a in told["activities"]}
    drives = {
        m["activity"]: m["samples"][-1][0] - m["samples"][0][0]
        for m in told["motions"]
        if m["object"] == "slow"
    }
    assert max(drives.values()) > 25
    for name, seconds in drives.items():
        assert spans[name] <= math.ceil(seconds - 1e-3) + 1, name
