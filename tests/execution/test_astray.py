"""Robots off their paths, or off their places: they are held, others are kept away from where they
are, and both is told; what cannot be true leaves nobody a Go.
"""

import itertools
import json
import math

import numpy as np
import pytest
from unified_planning.shortcuts import LE

from tests.execution import floors
from tests.execution.floors import drive
from tests.execution.loose import run_loose
from tests.execution.sites import Site
from tests.fleet.test_floors import house
from up_samp.execution import Delays, Do, Executor, Go, Heard, Hold, Overrun, dependencies_of
from up_samp.execution.astray import place_of, pose_in
from up_samp.execution.reports import TAKEN
from up_samp.execution.simulate import Floor

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
    floor = Floor(executor, Delays(slow=0.5), 1)
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
    assert executor.state.strayed["r0"].pose == pytest.approx((2.0 + beyond, 6.0, 0.0))
    assert isinstance(executor.commands(now + 0.4)["r0"], Hold)
    assert executor.done(FIRST, now + 0.5).heard is Heard.AGAIN
    executor.commands(now + 20.0)
    assert executor.phase(FIRST).value == "running"


def lifted(yaml):
    """r0 drives to a lift, which sets it down at (6, 8), and on from there; r1 waits at (9, 6)."""
    site = Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    site.robot("r1", (9.0, 6.0, math.pi / 2))
    there = site.drive("to_lift", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0)
    up = site.lift("ride_r0", "r0", (6.0, 8.0, 0.0), there, there + 4)
    off = site.drive("off", "r0", (6.0, 8.0, 0.0), [(4.0, 0.0)], up)
    site.drive("across", "r1", (9.0, 6.0, math.pi / 2), [(4.0, 0.0)], off)
    x = site.activities
    for one, two in itertools.pairwise(("to_lift", "ride_r0", "off", "across")):
        site.problem.add_constraint(LE(x[one].end, x[two].start))
    executor = Executor(site.data, site.problem)
    executor.commands(0.0)
    return executor


def arrive(executor, robot, motion, now):
    now, _ = drive(executor, robot, executor.state.of_object[robot].length, now)
    assert executor.phase(motion).value == "done"
    return now


@pytest.mark.parametrize("begun", [False, True])
def test_nothing_is_set_down_where_somebody_is_astray(yaml, begun):
    """The lift waits for r1, which was pushed to where r0 is to come out."""
    executor = lifted(yaml)
    now, _ = drive(executor, "r0", 2.0, 0.0)
    if begun:
        now = arrive(executor, "r0", "to_lift", now) + 4.0
        assert executor.commands(now)["r0"] == Do("ride_r0")
    assert executor.update("r1", pose=(6.0, 8.4, 0.0), now=now).heard is Heard.HELD
    (overrun,) = executor.overruns
    assert (overrun.held, overrun.met) == (("r0",), ())
    if not begun:
        now = arrive(executor, "r0", "to_lift", now)
        assert executor.commands(now)["r0"] == Hold((str(overrun),))
        assert executor.done("ride_r0", now).heard is Heard.AGAIN
        assert executor.phase("ride_r0").value == "waiting"
    else:
        assert executor.commands(now)["r0"] == Do("ride_r0", may_end=False)
        reply = executor.done("ride_r0", now)
        assert reply.heard is Heard.AGAIN
        assert str(overrun) in reply.why
    again = Executor.restore(
        executor.plan, json.loads(json.dumps(executor.save())), executor.problem
    )
    assert again.commands(now) == executor.commands(now)
    assert executor.update("r1", pose=(9.0, 6.0, math.pi / 2), now=now).heard is Heard.IGNORED
    executor.commands(now)
    assert executor.commands(now + 4.0)["r0"] == Do("ride_r0")
    assert executor.done("ride_r0", now + 4.0) == TAKEN
    assert executor.commands(now + 4.1)["r0"] == Go("off", 4.0)


@pytest.mark.parametrize("begun", [False, True])
def test_who_is_astray_is_not_set_elsewhere(yaml, begun):
    """The lift does not go while r0 is not in it; in it, r0 may tell that it is up already."""
    executor = lifted(yaml)
    now, _ = drive(executor, "r0", 2.9, 0.0)
    now += 0.1
    executor.update("r0", progress=3.0, now=now)
    if begun:
        executor.commands(now)
        now += 4.5
        assert executor.commands(now)["r0"] == Do("ride_r0")
    assert executor.update("r0", pose=(4.0, 2.5, 0.0), now=now).heard is Heard.HELD
    (overrun,) = executor.overruns
    executor.commands(now)
    assert executor.done("ride_r0", now).heard is Heard.AGAIN
    if not begun:
        why = f"it is {overrun.off:.3f} m off its place"
        assert executor.commands(now)["r0"] == Hold((why,))
    assert executor.update("r0", pose=(5.0, 2.0, 0.0), now=now).heard is Heard.IGNORED
    executor.commands(now)
    now += 4.5
    assert executor.commands(now)["r0"] == Do("ride_r0")
    assert executor.update("r0", pose=(6.0, 8.0, 0.0), now=now).heard is Heard.IGNORED
    assert executor.overruns == ()
    assert executor.done("ride_r0", now) == TAKEN


def test_robots_tell_poses_of_the_floor_that_a_lift_has_set_them_down_on(tmp_path):
    fleet = house(tmp_path)
    fleet.add_order("drugs", "pharmacy", "ward")
    executor = Executor(fleet.solve(60, first_plan=True).data, fleet.problem)
    plan, now = executor.plan, 0.0
    here = {o["name"]: o["initial"] for o in plan["objects"]}["r0"]
    led = {c["activity"]: c["configuration"] for c in plan["changes"]}
    led |= {m["activity"]: m["samples"][-1][1:] for m in plan["motions"]}
    while not executor.finished:
        now += 1.0
        for command in executor.commands(now).values():
            if isinstance(command, Do) and command.may_end:
                executor.done(command.activity, now)
        way = executor.state.of_object.get("r0")
        if way is not None:
            executor.update("r0", progress=min(way.told + 1.0, executor.state.until(way)), now=now)
        for name in [n for n in led if executor.phase(n).value == "done"]:
            here = led.pop(name)
        if "r0" not in executor.state.of_object:
            assert executor.update("r0", pose=here, now=now).heard is Heard.IGNORED
        assert now < 300.0


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
    assert executor.phase(FIRST).value == "running"  # it may have been stopped before its end
    assert executor.done(FIRST, now + 32.0, "r1").heard is Heard.IGNORED
    assert executor.done(FIRST, now + 32.0, "r0").heard is Heard.TAKEN
    assert executor.phase(FIRST).value == "done"


def judged(yaml, seed, runs):
    """(hits, how many runs had one off its path)."""
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


@pytest.mark.parametrize("seed", SEEDS[:1])
def test_nobody_drives_into_one_off_its_path(yaml, seed):
    hits, many = judged(yaml, seed, 2)
    assert many
    assert hits == []


def dropped(yaml, seed, runs):
    """(hits, how many runs had something set down where one was off its path)."""
    problem, plan = floors.rounds(seed, yaml, clearance=0.08)
    found = dependencies_of(problem, plan)
    hits, many = [], 0
    for k in runs:
        told = run_loose(found, problem, plan, 100 * seed + k)
        if told is None:
            continue
        time, *pose = max(told[0].loose.rows, key=lambda row: math.dist(row[1:3], told[0].home[:2]))
        made = floors.rounds(seed, yaml, clearance=0.08, drops=[(*pose, math.ceil(time) + 2)])
        if not made[1]["changes"]:
            continue
        floor, run, into = run_loose(dependencies_of(*made), *made, 100 * seed + k)
        many += 1
        assert run.finished, (seed, k)
        late = floor.unavoidable - {"bar0"}
        hits += [(seed, k, who, at) for who, at in into if not who <= late]
    return hits, many


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_set_down_on_one_off_its_path_in_many_runs(yaml, seed):
    hits, _ = dropped(yaml, seed, range(12))
    assert hits == []


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_nobody_drives_into_one_off_its_path_in_many_runs(yaml, seed):
    hits, many = judged(yaml, seed, 25)
    assert many
    assert hits == []


def test_others_are_kept_away_from_where_an_overrun_comes_to_rest(yaml):
    """r1 drives on past its gate, before which r0 is to cross its way; it brakes on that of r2."""
    problem, plan = floors.crossing(yaml, further=(7.3,))
    executor = Executor(plan, problem)
    executor.commands(0.0)
    gate, _ = executor.state.next_gate(executor.state.of_object["r1"])
    now, _ = drive(executor, "r1", gate + 0.11, 0.0)
    assert [(o.robot, o.held) for o in executor.overruns] == [("r1", ("r0", "r2"))]
    assert executor.commands(now)["r2"].until < 4.0
    for _ in range(20):
        now += 0.1
        executor.update("r1", progress=gate + 0.11, now=now)
    assert [o.held for o in executor.overruns] == [("r0",)]  # it stands
    assert executor.commands(now)["r2"] == Go("move_r2_0", 8.0)
