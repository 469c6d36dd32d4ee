"""Robots off their paths, or off their places: they are held, others are kept away from where they
are, and both is told; what cannot be true leaves nobody a Go.
"""

import json
import math

import numpy as np
import pytest

from tests.execution import floors
from tests.execution.floors import drive
from tests.execution.loose import run_loose
from up_samp.execution import Delays, Executor, Go, Heard, Hold, Overrun, dependencies_of
from up_samp.execution.astray import place_of, pose_in
from up_samp.execution.reports import TAKEN
from up_samp.execution.simulate import floor_of

FIRST, SECOND = "move_r0_0", "move_r1_0"
SEEDS = (3, 5)


def test_others_are_kept_away_from_who_is_off_its_path(executor):
    """r1 (from (6, 2) upwards) leaves its path to the left, onto that of r0 (along y = 6)."""
    executor.commands(0.0)
    now, _ = drive(executor, "r1", 2.0, 0.0)
    assert executor.commands(now)["r0"] == Go(FIRST, 8.0)
    reply = executor.update("r1", pose=(5.0, 5.6, math.pi), now=now + 2.0)
    assert reply.heard is Heard.HELD
    (overrun,) = executor.overruns
    assert overrun == Overrun("r1", SECOND, 0.0, ("r0",), (), overrun.off)
    assert overrun.off > 1.0
    assert str(overrun) == f"'r1' is {overrun.off:.3f} m off its path of '{SECOND}'"
    told = executor.commands(now + 2.0)
    assert told["r1"] == Hold((reply.why, str(overrun)))
    assert 1.0 < told["r0"].until < 2.5  # its nose stays 11 cm clear of r1's tail
    later, _ = drive(executor, "r0", told["r0"].until, now + 2.0)
    assert executor.commands(later)["r0"] == Hold((str(overrun),))
    again = Executor.restore(
        executor.plan, json.loads(json.dumps(executor.save())), executor.problem,
        dependencies=executor.dependencies,
    )  # fmt: skip
    assert again.overruns == executor.overruns
    assert again.commands(later) == executor.commands(later)
    assert executor.snapshot().commands(later) == executor.commands(later)
    # an older report does not put it back on its path
    assert executor.update("r1", progress=2.0, now=now + 1.0).heard is Heard.IGNORED
    assert executor.update("r1", progress=2.0, now=later) == TAKEN
    assert executor.overruns == ()
    assert executor.commands(later)["r0"] == Go(FIRST, 8.0)


def test_who_may_touch_one_off_its_path_is_told(executor):
    executor.commands(0.0)
    now, _ = drive(executor, "r0", 3.0, 0.0)
    executor.update("r1", pose=(5.2, 5.6, math.pi / 2), now=now)
    (overrun,) = executor.overruns
    assert (overrun.held, overrun.met) == ((), ("r0",))
    assert executor.commands(now)["r0"] == Hold((str(overrun),))
    assert executor.commands(now)["r1"] == Hold((executor._held["r1"], str(overrun)))


def test_others_are_kept_away_from_who_rests_elsewhere(executor):
    """r1 is over with its motion, and is pushed into the way that it has crossed."""
    executor.commands(0.0)
    now, _ = drive(executor, "r0", 8.0, 0.0)
    executor.commands(now)
    now, _ = drive(executor, "r1", 8.0, now)
    assert executor.finished
    assert executor.update("r1", pose=(6.02, 10.0, math.pi / 2), now=now).heard is Heard.IGNORED
    reply = executor.update("r1", pose=(6.0, 8.0, math.pi / 2), now=now)
    assert (reply.heard, reply.why) == (Heard.HELD, "it is 2.000 m off its place")
    assert executor.commands(now)["r1"] == Hold((reply.why,))
    (overrun,) = executor.overruns
    assert (overrun.motion, str(overrun)) == ("", "'r1' is 2.000 m off its place")
    assert executor.update("r1", pose=(6.0, 10.0, math.pi / 2), now=now).heard is Heard.IGNORED
    assert executor.overruns == ()


def test_a_robot_at_rest_may_be_in_the_way(yaml):
    """Whoever rests between its motions, and is pushed onto another's path, is in the way there."""
    problem, plan = floors.rounds(5, yaml, clearance=0.08)
    executor = Executor(plan, problem)
    floor = floor_of(executor, Delays(slow=0.5), 1)
    seen = 0
    while floor.goes_on:
        floor.step()
        now, before = floor.now, executor.commands(floor.now)
        for robot in sorted(executor._drivers - executor.state.of_object.keys()):
            for other, way in list(executor.state.of_object.items()):
                far = way.told + 1.5
                if not isinstance(before[other], Go) or before[other].until < far:
                    continue
                path = executor.drives[way.activity, other].path
                place = tuple(path.poses_at(np.array([far]))[0])
                assert executor.update(robot, pose=place, now=now).heard is Heard.HELD
                (overrun,) = executor.overruns
                assert (overrun.robot, overrun.motion) == (robot, "")
                assert other in (*overrun.held, *overrun.met)
                led = executor.commands(now)[other]
                assert isinstance(led, Hold) or led.until < far - 0.5
                life = executor.dependencies.lives[robot]
                at = pose_in(executor.state, place_of(executor.state, life))
                assert executor.update(robot, pose=at, now=now).heard is Heard.IGNORED
                assert executor.commands(now) == before
                seen += 1
    assert seen > 10
    assert executor.finished


@pytest.mark.parametrize("beyond", [-0.4, 8.4])
def test_beyond_the_ends_of_its_path_a_robot_is_off_it(executor, beyond):
    executor.commands(0.0)
    now = drive(executor, "r0", 7.95, 0.0)[0] if beyond > 0 else 0.5
    reply = executor.update("r0", progress=beyond, now=now + 0.4)
    assert (reply.heard, reply.why) == (Heard.HELD, "it is 0.400 m off its path")
    (overrun,) = executor.overruns
    assert (overrun.robot, overrun.off) == ("r0", pytest.approx(0.4))
    assert executor._strayed["r0"].pose == pytest.approx((2.0 + beyond, 6.0, 0.0))
    assert isinstance(executor.commands(now + 0.4)["r0"], Hold)
    assert executor.done(FIRST, now + 0.5).heard is Heard.AGAIN
    executor.commands(now + 20.0)
    assert executor.phase(FIRST).value == "running"


UNKNOWN = [math.nan, math.inf, None, "3", True, 10**400, -1.0, 1200.0, 7.9]


@pytest.mark.parametrize("told", UNKNOWN)
def test_no_go_stays_valid_for_something_unknown(executor, told):
    executor.commands(0.0)
    now, _ = drive(executor, "r0", 2.0, 0.0)
    reply = executor.update("r0", progress=told, now=now + 0.1)
    assert reply.heard is Heard.AGAIN
    assert executor.commands(now + 0.1)["r0"] == Hold((reply.why,))
    assert executor.update("r0", progress=2.1, now=now + 0.2) == TAKEN
    assert executor.commands(now + 0.2)["r0"] == Go(FIRST, 8.0)


def test_who_tells_what_cannot_be_at_its_end_is_not_done(executor):
    executor.commands(0.0)
    now, _ = drive(executor, "r0", 7.97, 0.0)
    assert executor.update("r0", progress=math.nan, now=now).heard is Heard.AGAIN
    assert executor.done(FIRST, now).heard is Heard.AGAIN
    executor.commands(now + 30.0)
    assert executor.phase(FIRST).value == "running"
    executor.update("r0", progress=7.97, now=now + 30.0)
    executor.commands(now + 32.0)
    assert executor.phase(FIRST).value == "done"


def judged(yaml, seed, runs):
    """(hits, how many runs had one off its path, how often others were kept away)."""
    problem, plan = floors.rounds(seed, yaml, clearance=0.08)
    found = dependencies_of(problem, plan)
    hits, many = [], 0
    for k in range(runs):
        told = run_loose(found, problem, plan, 100 * seed + k)
        if told is None:
            continue
        floor, run, into = told
        many += 1
        assert run.finished, (seed, k)
        hits += [(seed, k, who, at) for who, at in into if not who <= floor.unavoidable]
    return hits, many


@pytest.mark.parametrize("seed", SEEDS)
def test_nobody_drives_into_one_off_its_path(yaml, seed):
    hits, many = judged(yaml, seed, 6)
    assert many
    assert hits == []


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_nobody_drives_into_one_off_its_path_in_many_runs(yaml, seed):
    hits, many = judged(yaml, seed, 25)
    assert many
    assert hits == []
