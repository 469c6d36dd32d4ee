"""Robots that stop, or are stopped, just short of the end of a motion, and others that pass behind
them: nobody is let in while anybody may stand there. Judged by where bodies truly were.
"""

import dataclasses
import math
import random

import numpy as np
import pytest
from shapely.geometry import Polygon

from tests.execution import floors
from up_samp.execution import Delays, Executor, Heard, dependencies_of, with_dependencies
from up_samp.execution.simulate import Floor
from up_samp.execution.state import TaskPhase


def turned(corner, at, turn):
    (x, y), c, s = corner, math.cos(turn), math.sin(turn)
    return np.array([at[0] + c * x - s * y, at[1] + s * x + c * y])


def body(pose):
    return Polygon([turned(corner, pose[:2], pose[2]) for corner in floors.BOX])


def behind(seed, yaml, error):
    """Return (problem, plan, which way r0 is from r1): r0 drives to its end, and r1 past it there,
    with no more room than robots ask that are wrong by ``error`` (m).
    """
    rng = random.Random(f"behind {seed}")
    plan = floors.Plan(rng, yaml, clearance=0.0)
    plan.robots, plan.data["objects"] = ["r0", "r1"], []
    plan.model = dict.fromkeys(plan.robots, "REEDSSHEPP")
    plan.speed = {robot: rng.choice((0.8, 1.0, 1.5)) for robot in plan.robots}
    turn, way = rng.uniform(-math.pi, math.pi), rng.uniform(2.0, 4.0)
    along = turn + rng.choice((-1, 1)) * rng.uniform(1.1, 2.0)
    ahead = np.array([math.cos(along), math.sin(along)])
    aside = np.array([ahead[1], -ahead[0]])
    aside *= np.sign(aside @ [math.cos(turn), math.sin(turn)])
    end = np.array([6.0, 6.0])
    corners = Polygon(floors.BOX).exterior.coords[:-1]
    near = min(turned(corner, end, turn) @ aside for corner in corners)
    offset = near - 2 * error - 0.01 - rng.uniform(0.001, 0.01) - 0.25
    first = aside * offset + ahead * (end @ ahead - 3.5)
    back = end - way * np.array([math.cos(turn), math.sin(turn)])
    plan.pose = {"r0": (*back, turn), "r1": (*first, along)}
    entries = [("r0", 0, way), ("r1", rng.randint(8, 12), rng.uniform(6.0, 7.0))]
    for robot in rng.sample(plan.robots, 2):
        plan._object(robot, "robot", floors.BOX, "REEDSSHEPP", plan.pose[robot], plan.speed[robot])
    for robot, start, length in rng.sample(entries, 2):
        entry, motion, _ = plan._timed(robot, [(length, 0.0)], start)
        plan.data["activities"].append(entry)
        plan.data["motions"].append(motion)
    assert plan.clear(plan.data)
    return *floors.finished(rng, plan, yaml), aside


def stopped(seed, yaml):
    """Return the least distance (m) of the bodies where r0 is stopped before its end, and whether
    all was done.
    """
    rng = random.Random(f"stopped {seed}")
    error = rng.choice((0.05, 0.05, 0.1, 0.15))
    problem, plan, aside = behind(seed, yaml, error)
    found = dependencies_of(problem, plan, localisation=error)
    assert found.narrow == ()
    floor = Floor(Executor(plan, problem, dependencies=found), Delays(), seed)
    one, other = floor.robots["r0"], floor.robots["r1"]
    bias = error * rng.choice((1.0, 1.0, rng.uniform(-1.0, 1.0)))
    one.luck = dataclasses.replace(one.luck, bias=bias, tracked=True)
    short = 2 * error * rng.choice((1.0, rng.random())) - 1e-4
    silent_since = rng.choice((math.inf, rng.uniform(0.0, 3.0)))
    beside = error * aside
    least, stands = math.inf, None
    while floor.goes_on and floor.now < 25.0:
        if one.motion is not None and one.s >= one.length - short:
            one.s, one.v, one.held_until = one.length - short, 0.0, math.inf
            stands = floor.now if stands is None else stands
        if stands is not None and floor.now > stands + silent_since:
            one.told = lambda now: None
        floor.step()
        x, y, turn = other.pose
        least = min(least, body(one.pose).distance(body((x + beside[0], y + beside[1], turn))))
    return least, floor.executive.finished


def test_who_is_stopped_before_its_end_keeps_others_from_there(yaml):
    runs = [stopped(seed, yaml) for seed in range(7)]
    assert min(least for least, _ in runs) > 0.0
    assert {finished for _, finished in runs} == {True, False}


@pytest.mark.long
def test_many_that_are_stopped_before_their_ends_keep_others_from_there(yaml):
    runs = [stopped(seed, yaml) for seed in range(100, 400)]
    assert min(least for least, _ in runs) > 0.0
    assert {finished for _, finished in runs} == {True, False}


def side_by_side(yaml):
    """Return a plan in which one activity drives two robots."""
    plan = floors.Plan(random.Random(0), yaml)
    plan.robots, plan.data["objects"] = ["r0", "r1"], []
    plan.model, plan.speed = dict.fromkeys(plan.robots, "SE2"), {"r0": 1.0, "r1": 0.8}
    for robot, y in (("r0", 3.0), ("r1", 7.0)):
        plan.pose[robot] = (2.0, y, 0.0)
        plan._object(robot, "robot", floors.BOX, "SE2", plan.pose[robot], plan.speed[robot])
        entry, motion, _ = plan._timed(robot, [(5.0, 0.0)], 0)
        plan.data["activities"].append(entry)
        plan.data["motions"].append(motion)
    data = with_dependencies(*floors.finished(random.Random(0), plan, yaml))
    both = max(data["activities"], key=lambda a: a["end"])
    for motion in data["motions"]:
        motion["activity"] = both["name"]
    told = {"activity": both["name"], "expected": 10.0, "who": plan.robots}
    graph = {**data["dependencies"], "tasks": [told], "edges": [], "bounds": [], "choices": []}
    return {**data, "activities": [both], "dependencies": graph}


@pytest.mark.parametrize("robots", [("r0", "r1"), ("r1", "r0")])
def test_of_who_drives_together_each_says_that_it_is_there(yaml, robots):
    executor = Executor(side_by_side(yaml))
    executor.commands(0.0)
    (activity,) = executor.state.phase
    for tenth in range(1, 100):
        for robot in robots:
            executor.update(robot, progress=0.05 * tenth + 0.01, now=0.1 * tenth)
    for k, robot in enumerate((robots[0], robots[0], "somebody", robots[1])):
        assert executor.phase(activity) is TaskPhase.RUNNING
        reply = executor.done(activity, 12.0 + k, robot)
        assert reply.heard is (Heard.IGNORED if robot == "somebody" else Heard.TAKEN)
    assert executor.phase(activity) is TaskPhase.DONE
