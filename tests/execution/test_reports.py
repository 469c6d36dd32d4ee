"""What robots tell is checked: a gate stays closed, what cannot be is not believed, and who is
where nobody led it is told so, and is kept away from.
"""

import functools
import json
import math
import random
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.execution import floors
from tests.execution.floors import drive
from up_samp.execution import (
    At,
    Delays,
    Edge,
    Event,
    Executor,
    Go,
    Graph,
    Heard,
    Hold,
    Overrun,
    PlannedTask,
    Reply,
    dependencies_of,
)
from up_samp.execution.graph import ORIGIN
from up_samp.execution.reports import TAKEN
from up_samp.execution.simulate import Floor, simulation_of
from up_samp.execution.state import TaskPhase, told_places
from up_samp.execution.travel import along
from up_samp.model import ProblemError

FIRST, SECOND = "move_r0_0", "move_r1_0"


def test_a_closed_gate_stays_closed(executor):
    executor.commands(0.0)
    gate = executor.commands(0.0)["r1"].until
    assert 2.0 < gate < 4.0
    now, reply = drive(executor, "r1", gate, 0.0)
    assert reply == TAKEN
    # a robot that is at most 5 cm wrong stands before the gate at up to 10 cm more than that
    for more in (0.0, 0.001, 0.005, 0.05, 0.1):
        assert executor.update("r1", progress=gate + more, now=now) == TAKEN
        held = executor.commands(now)["r1"]
        assert isinstance(held, Hold)
        assert "r0 and r1 would meet" in held.waiting_for[0]
        assert executor.overruns == ()
    drive(executor, "r0", 8.0, now)
    assert executor.commands(now + 9.0)["r1"] == Go(SECOND, 8.0)


def test_who_is_beyond_a_closed_gate_is_held_and_others_keep_away(executor):
    executor.commands(0.0)
    gate = executor.commands(0.0)["r1"].until
    assert executor.commands(0.0)["r0"] == Go(FIRST, 8.0)
    now, _ = drive(executor, "r1", gate + 0.1, 0.0)
    reply = executor.update("r1", progress=gate + 0.3, now=now + 1.0)
    assert reply.heard is Heard.HELD
    assert executor.overruns == (Overrun("r1", SECOND, pytest.approx(0.2), ("r0",)),)
    told = executor.commands(now + 1.0)
    assert told["r1"] == Hold((reply.why,))
    assert "'r1' is 0.200 m beyond a closed gate" in reply.why
    # r0 goes first, but no farther than it keeps clear of where r1 may be now
    stop = told["r0"].until
    assert 1.0 < stop < 4.0
    now, _ = drive(executor, "r0", stop, now + 1.0)
    assert executor.commands(now)["r0"] == Hold((reply.why,))
    # r1 has gone back: all is as before
    assert executor.update("r1", progress=gate + 0.08, now=now) == TAKEN
    assert executor.overruns == ()
    told = executor.commands(now)
    assert told["r0"] == Go(FIRST, 8.0)
    assert isinstance(told["r1"], Hold)


def test_who_meets_somebody_beyond_a_closed_gate_is_told(executor):
    executor.commands(0.0)
    gate = executor.commands(0.0)["r1"].until
    now, _ = drive(executor, "r0", 4.0, 0.0)  # in the midst of the crossing
    now, _ = drive(executor, "r1", gate + 0.1, now)
    executor.update("r1", progress=gate + 0.9, now=now + 2.0)
    (overrun,) = executor.overruns
    assert (overrun.held, overrun.met) == ((), ("r0",))
    told = executor.commands(now + 2.0)
    assert isinstance(told["r0"], Hold)
    assert isinstance(told["r1"], Hold)


def test_who_went_back_where_others_may_be_is_held(executor):
    executor.commands(0.0)
    now, _ = drive(executor, "r0", 6.5, 0.0)
    assert isinstance(executor.commands(now)["r1"], Go)
    assert executor.update("r0", progress=6.42, now=now + 0.1) == TAKEN  # that is noise
    reply = executor.update("r0", progress=4.0, now=now + 0.2)
    assert reply.heard is Heard.HELD
    (overrun,) = executor.overruns
    assert overrun.by == pytest.approx(-2.4)
    assert "r1" in overrun.held
    assert executor.commands(now + 0.2)["r1"].until < 4.0
    assert executor.update("r0", progress=6.5, now=now + 3.0) == TAKEN
    assert executor.overruns == ()
    assert executor.commands(now + 3.0)["r1"] == Go(SECOND, 8.0)


WRONG = [
    ({"progress": math.nan}, "finite number"),
    ({"progress": math.inf}, "finite number"),
    ({"progress": -math.inf}, "finite number"),
    ({"progress": None}, "finite number"),
    ({"progress": "3"}, "finite number"),
    ({"progress": True}, "finite number"),
    ({"progress": 10**400}, "finite number"),
    ({"progress": 1.2, "now": math.nan}, "time cannot be nan"),
    ({"progress": 1.2, "now": math.inf}, "time cannot be inf"),
    ({"progress": 1.2, "now": "soon"}, "time cannot be 'soon'"),
    ({"progress": 1.2, "now": 3700.0}, "clock is 3698.0 s ahead"),
    ({"progress": 1.2, "now": -3600.0}, "clock is 3602.0 s behind"),
    ({"progress": 1200.0}, "not on its path"),
    ({"progress": 8.3}, "not on its path"),
    ({"progress": -1.0}, "not on its path"),
    ({"progress": 7.9}, "more than the"),
    ({"pose": (1.0, math.nan, 0.0)}, "three finite numbers"),
    ({"pose": (1.0, 2.0)}, "three finite numbers"),
    ({"pose": "here"}, "three finite numbers"),
]


@pytest.mark.parametrize(("report", "why"), WRONG)
def test_what_cannot_be_is_asked_again(executor, report, why):
    executor.commands(0.0)
    drive(executor, "r0", 1.0, 0.0)
    executor.commands(2.0)
    before = executor.save()
    reply = executor.update("r0", **{"now": 2.0, "motion": FIRST, **report})
    assert reply.heard is Heard.AGAIN
    assert why in reply.why
    held = {} if "now" in report else {"r0": reply.why}
    assert json.dumps(executor.save()) == json.dumps({**before, "held": held})  # no more than that
    told = executor.commands(2.0)["r0"]
    assert told == Hold((reply.why,)) if held else isinstance(told, Go)
    assert executor.update("r0", progress=1.2, now=2.2) == TAKEN
    assert isinstance(executor.commands(2.2)["r0"], Go)


def test_what_says_nothing_is_ignored(executor):
    executor.commands(0.0)
    heard = [
        executor.update("nobody", progress=1.0, now=0.5),
        executor.update("r0", progress=1.0, now=0.5, motion="nothing"),
        executor.update("r0", progress=1.0, now=0.5, motion=SECOND),
        executor.done("nothing", 0.5),
    ]
    executor.update("r0", progress=0.5, now=1.0)
    heard.append(executor.update("r0", progress=0.4, now=0.9))  # it comes late
    now, _ = drive(executor, "r0", 8.0, 1.0)
    assert executor.phase(FIRST).value == "done"
    heard.append(executor.done(FIRST, now))
    heard.append(executor.done(FIRST, now))
    heard.append(executor.update("r0", progress=7.9, now=now, motion=FIRST))
    heard.append(executor.update("r0", progress=8.0, now=now))
    assert [r.heard for r in heard] == [Heard.IGNORED] * len(heard), heard
    assert all(r.why for r in heard)
    drives = executor.update("r0", progress=3.0, now=now)
    assert drives == Reply(Heard.HELD, "it drives, but no motion of it is under way")
    with pytest.raises(ProblemError, match="time cannot be nan"):
        executor.commands(math.nan)
    with pytest.raises(ProblemError, match="'localisation' cannot be -1"):
        Executor(executor.plan, executor.problem, localisation=-1)


@pytest.mark.parametrize(("told", "over"), [(7.955, True), (7.9, False)])
def test_a_motion_is_over_when_its_robot_says_that_it_is_at_the_end(crossed, told, over):
    problem, plan, found = crossed
    executor = Executor(plan, problem, dependencies=found)
    executor.commands(0.0)
    now, _ = drive(executor, "r0", 7.7, 0.0)
    assert executor.done(FIRST, now).heard is Heard.AGAIN
    now, _ = drive(executor, "r0", told, now)  # 8 m are its end, and it tells no more
    for k in range(40):
        executor.update("r0", progress=told - 0.03 * (k % 2), now=now + 0.1 * k)
        executor.commands(now + 0.1 * k)
    assert executor.phase(FIRST).value == "running"
    assert (executor.done(FIRST, now + 4.0) == TAKEN) is over
    assert (executor.phase(FIRST).value == "done") is over


def test_nonsense_of_all_kinds_ends_nothing(yaml):
    """Random reports between good ones: no exception, no contact, nothing over too early."""
    wild = [math.nan, math.inf, -1e9, 1e9, None, "x", [], 0.0, 3.0, 6504.0, -0.2, True]
    for seed in range(1):
        problem, plan, found = rounds(yaml, seed + 5)
        rng = random.Random(seed)
        executor = Executor(plan, problem, dependencies=found)
        floor = Floor(executor, Delays.of_share(0.5), seed)
        names = [*executor.state.phase, "nothing", None]
        while floor.goes_on:
            floor.step()
            for _ in range(2):
                robot, motion = rng.choice([*floor.robots, "nobody"]), rng.choice(names)
                value, now = rng.choice(wild), rng.choice([*wild, floor.now])
                over = {n: executor.phase(n).value for n in executor.state.phase}
                true = floor.robots[robot].s if robot in floor.robots else 0.0
                if isinstance(value, float) and abs(value - true) < 1.0:
                    continue  # that could be true
                reply = executor.update(robot, progress=value, now=now, motion=motion)
                assert isinstance(reply, Reply)
                moved = {n: executor.phase(n).value for n in executor.state.phase}
                assert moved == over
            pose = (rng.choice(wild), rng.choice(wild), rng.choice(wild))
            executor.update(rng.choice(list(floor.robots)), pose=pose, now=floor.now)
            name, now = rng.choice([m for m in names if m]), rng.choice(wild[:6])
            if now is None and name in executor.state.those(TaskPhase.RUNNING):
                continue  # that could be true
            assert executor.done(name, now).heard in (Heard.AGAIN, Heard.IGNORED)
        assert executor.finished


# ------------------------------------------------------------------ poses


def test_a_pose_is_a_progress(yaml):
    problem, plan, found = rounds(yaml, 6)
    executor = Executor(plan, problem, dependencies=found)
    rng = np.random.default_rng(0)
    for life in found.lives.values():
        for drive_ in life.drives:
            path = drive_.path
            for s in rng.uniform(0.0, path.length, 8):
                x, y, theta = path.poses_at(np.array([s]))[0]
                place = executor.progress_of(drive_.activity, life.object, (x, y, theta + 6.283185))
                assert place.progress == pytest.approx(s, abs=1e-3)
                assert place.off < 1e-3
                aside = (x - 0.04 * math.sin(theta), y + 0.04 * math.cos(theta), theta)
                place = along(path, aside)
                assert place.progress == pytest.approx(s, abs=1e-2)
                assert place.off == pytest.approx(0.04, abs=1e-2)
    with pytest.raises(ProblemError, match="no motion 'x' of 'r0'"):
        executor.progress_of("x", "r0", (0.0, 0.0, 0.0))


def test_what_was_told_before_tells_places_apart(crossed):
    _, _, found = crossed
    path = found.lives["r0"].drives[0].path
    pose = path.poses_at(np.array([3.0]))[0]
    assert along(path, pose).progress == pytest.approx(3.0, abs=1e-3)
    assert along(path, pose, (4.0, 5.0)).progress == pytest.approx(4.0, abs=1e-3)


def test_robots_may_tell_poses(executor):
    executor.commands(0.0)
    assert executor.update("r0", pose=(2.5, 6.01, 0.0), now=1.0) == TAKEN
    assert executor.state.of_object["r0"].told == pytest.approx(0.5, abs=1e-3)
    off = executor.update("r0", pose=(2.6, 6.4, 0.0), now=1.2)
    assert off.heard is Heard.HELD
    assert "0.400 m off its path" in off.why
    assert executor.commands(1.2)["r0"] == Hold((off.why, str(executor.overruns[0])))
    assert executor.update("r0", pose=(2.6, 6.0, 0.0), now=1.4) == TAKEN
    assert executor.commands(1.4)["r0"] == Go(FIRST, 8.0)


# ------------------------------------------------------------------ saved, joined, re-ordered


@functools.cache
def rounds(yaml, seed):
    """Return (problem, plan, dependencies)."""
    problem, plan = floors.rounds(seed, yaml)
    return problem, plan, dependencies_of(problem, plan)


class Both:
    """Two executors that are told the same, and have to say the same."""

    def __init__(self, one, two):
        self.one, self.two = one, two

    def __getattr__(self, name):
        return getattr(self.one, name)

    def _same(self, name, *args, **kwargs):
        said = getattr(self.one, name)(*args, **kwargs)
        assert getattr(self.two, name)(*args, **kwargs) == said
        return said

    def commands(self, now):
        return self._same("commands", now)

    def update(self, robot, **told):
        return self._same("update", robot, **told)

    def done(self, *told):
        return self._same("done", *told)


def half_done(yaml, seed, ticks, **wrong):
    """A run of a random plan under way, slow and late: (problem, plan, dependencies, floor)."""
    problem, plan, found = rounds(yaml, seed)
    executor = Executor(plan, problem, dependencies=found)
    floor = Floor(executor, Delays(slow=0.5, late=0.5, **wrong), seed)
    for _ in range(ticks):
        floor.step()
    return problem, plan, found, floor


def test_a_saved_execution_goes_on_as_if_nothing_had_been(yaml):
    problem, plan, found, floor = half_done(yaml, 5, 150, bias=0.02, noise=0.02)
    executor = floor.executive
    saved = json.loads(json.dumps(executor.save()))
    again = Executor.restore(plan, saved, problem, dependencies=found)
    assert json.loads(json.dumps(again.save())) == saved
    assert again.predicted_makespan() == executor.predicted_makespan()
    floor.executive = Both(executor, again)
    while floor.goes_on:
        floor.step()
    assert again.finished
    assert again.times() == executor.times()
    for harm, match in (
        ({"format": "x"}, "no saved execution"),
        ({"problem": "y"}, "is of a plan of 'y'"),
        ({"done": ["nothing"]}, "speaks of 'nothing'"),
        ({"fired": 3}, "cannot be read"),
    ):
        with pytest.raises(ProblemError, match=match):
            Executor.restore(plan, {**saved, **harm}, problem, dependencies=found)
    other = floors.crossing(yaml)
    with pytest.raises(ProblemError, match="speaks of"):
        Executor.restore(other[1], saved, other[0])


@pytest.mark.parametrize("ticks", [40, 150, 300])
def test_a_plan_is_joined_where_its_robots_say_that_they_are(yaml, ticks):
    problem, plan, found, floor = half_done(yaml, 5, ticks)
    old = floor.executive
    under_way = {name: {} for name in old.state.those(TaskPhase.RUNNING)}
    for robot in floor.robots.values():
        if robot.motion in under_way:
            path = next(
                d.path for d in found.lives[robot.name].drives if d.activity == robot.motion
            )
            pose = path.poses_at(np.array([robot.s]))[0].tolist()
            under_way[robot.motion][robot.name] = pose if ticks < 200 else robot.s
    done = [n for n in old.state.phase if old.phase(n).value == "done"]
    executor = Executor(plan, problem, dependencies=found)
    executor.join(floor.now, done=done, under_way=under_way)
    assert executor.overruns == ()
    for way in executor.state.of_object.values():
        assert way.progress == pytest.approx(floor.robots[way.object].s, abs=0.01)
    floor.executive = executor
    while floor.goes_on:
        floor.step()
    run = simulation_of(floor, plan, "staircase", 0)
    assert run.finished
    assert run.contacts == ()


def test_what_cannot_have_come_about_is_not_joined(crossed):
    problem, plan, found = crossed

    def joined(*args, **kwargs):
        executor = Executor(plan, problem, dependencies=found)
        executor.join(*args, **kwargs)
        return executor

    for told, match in (
        ({"done": ["x"]}, "no activity 'x'"),
        ({"done": [SECOND]}, "r0 reaches .* comes before it|cannot be told"),
        ({"done": [FIRST], "under_way": {FIRST: {"r0": 1.0}}}, "told to be over, and to be under"),
        ({"under_way": {FIRST: {}}}, "where is 'r0'"),
        ({"under_way": {FIRST: {"r0": 80.0}}}, "cannot be at 80.0 m"),
        ({"under_way": {FIRST: {"r0": (3.0, 9.0, 0.0)}}}, "3.000 m off its path"),
        ({"under_way": {FIRST: {"r0": (3.0, math.nan, 0.0)}}}, "three finite numbers"),
    ):
        with pytest.raises(ProblemError, match=match):
            joined(5.0, **told)
    with pytest.raises(ProblemError, match="time cannot be nan"):
        joined(math.nan)
    executor = joined(5.0, under_way={FIRST: {"r0": 1.0}, SECOND: {"r1": (6.0, 6.0, math.pi / 2)}})
    assert [o.robot for o in executor.overruns] == ["r1"]  # it should not be there
    assert isinstance(executor.commands(5.0)["r1"], Hold)
    with pytest.raises(ProblemError, match="before anything of it has begun"):
        executor.join(5.0)


def test_an_order_is_proposed_elsewhere_and_taken_over_if_it_still_can_be(yaml):
    adopted = refused = 0
    for seed in (5, 6):
        problem, plan, found = rounds(yaml, seed)
        executor = Executor(plan, problem, dependencies=found)
        floor = Floor(executor, Delays(slow=0.7, long_stop=30.0), seed)
        for _ in range(12):
            for _ in range(20):
                floor.step()
            before = executor.save(), executor.state.graph
            with ThreadPoolExecutor(1) as pool:
                proposal = pool.submit(executor.snapshot().propose_order).result()
            assert (executor.save(), executor.state.graph) == before
            if proposal is None:
                continue
            late = executor.snapshot()
            for way in late.state.of_object.values():  # everybody has driven on, as far as may be
                late.state.move(way, late.state.until(way))
            ahead = executor.predicted_makespan()
            assert executor.adopt(proposal) == len(proposal.flips)
            assert executor.predicted_makespan() < ahead
            assert executor.adopt(proposal) == 0  # orders are others by now
            adopted += 1
            refused += late.adopt(proposal) == 0
        while floor.goes_on:
            floor.step()
        run = simulation_of(floor, plan, "reorder", seed)
        assert run.finished
        assert run.contacts == ()
    assert adopted >= 1
    assert refused >= 1


# ------------------------------------------------------------------ places


def two_that_wait_for_each_other(gap):
    """Each may leave 5 m only once the other has come to ``5 - gap``."""
    tasks = {n: PlannedTask(n, (0.0, 10.0), 10.0, (n,), (n,)) for n in "ab"}
    events = [ORIGIN, *(Event(at, n) for n in tasks for at in (At.START, At.END))]
    for n in tasks:
        events += [Event(At.REACH, n, n, 5.0 - gap), Event(At.LEAVE, n, n, 5.0)]
    edges = tuple(
        Edge(
            Event(At.REACH, a, a, 5.0 - gap), Event(At.LEAVE, b, b, 5.0), 0.0, "meeting", "made up"
        )
        for a, b in ("ab", "ba")
    )
    lengths = {(n, n): 9.0 for n in tasks}
    return Graph(tasks, tuple(events), (0.0,) * len(events), edges, lengths=lengths)


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.06, 0.1, 0.3])
def test_no_error_makes_everybody_wait_for_everybody(gap):
    graph = two_that_wait_for_each_other(gap)
    places, squeezed = told_places(graph, dict.fromkeys("ab", 0.05))
    mark = graph.number[Event(At.REACH, "a", "a", 5.0 - gap)]
    gate = graph.number[Event(At.LEAVE, "a", "a", 5.0)]
    assert places[mark] <= places[gate] + 1e-9
    if gap < 0.1:
        assert {s.objects for s in squeezed} == {("a",), ("b",)}
        assert squeezed[0].kept == pytest.approx(gap / 2)
        assert places[mark] == places[gate] == pytest.approx(5.0 - gap / 2)
        assert f"error of {gap / 2:.3f} m is covered" in str(squeezed[0])
    else:
        assert squeezed == ()
        assert (places[mark], places[gate]) == (pytest.approx(5.05 - gap), pytest.approx(4.95))
