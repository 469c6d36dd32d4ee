"""Who goes first in a plan of two is decided by what orders' ends cost, and the times say so."""

import itertools
import random
from types import SimpleNamespace

import numpy as np
import pytest

from tests.execution import floors
from up_samp.execution import Executor, dependencies_of
from up_samp.execution.build import Dependencies, Draft, tasks_of
from up_samp.execution.files import motion_faults, with_dependencies
from up_samp.execution.judge import contacts_of
from up_samp.execution.lives import drives_of, lives_of
from up_samp.execution.meetings import meetings_of
from up_samp.execution.reorder import Goal
from up_samp.execution.state import TaskPhase
from up_samp.fleet.meanings import Kind, Meaning
from up_samp.model import ProblemError
from up_samp.operate.horizon import Cut, Cutter, Opened
from up_samp.operate.loop import Operation
from up_samp.operate.records import Settings, job_record
from up_samp.operate.stitch import Kept, _after, follow_on, kept_of, ordered


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    problem, plan = floors.crossing(floors.hall(tmp_path_factory.mktemp("hall")))
    return plan, dependencies_of(problem, plan)


def ends(plan):
    names = {m["activity"]: m["object"] for m in plan["motions"]}
    return {names[a["name"]]: a["end"] for a in plan["activities"]}


@pytest.mark.parametrize("first", ["r0", "r1"])
def test_whose_end_costs_most_goes_first(crossed, first):
    plan, told = crossed
    goals = {
        m["activity"]: Goal(20.0 if m["object"] == first else 1.0, 0.0, 0.0)
        for m in plan["motions"]
    }
    made = ordered(plan, told, goals)
    found = ends(made)
    assert min(found, key=found.get) == first
    assert not contacts_of(made)
    (meeting,) = meetings_of(lives_of(made), localisation=0.05)
    assert np.all(meeting.one_first == (meeting.one.object == first))


def test_what_cannot_be_told_in_time_stays(crossed):
    plan, told = crossed
    goals = {
        m["activity"]: Goal(20.0 if m["object"] == "r1" else 1.0, 0.0, 0.0) for m in plan["motions"]
    }
    found = ends(ordered(plan, told, goals, lead=60.0))
    assert min(found, key=found.get) == "r0"


@pytest.mark.parametrize(("gone", "first"), [(0.0, "r1"), (1.2, "r0")])
def test_who_is_farther_on_its_way_is_not_held_back_behind_where_it_is(crossed, gone, first):
    plan, told = crossed
    names = {m["object"]: m["activity"] for m in plan["motions"]}
    goals = {name: Goal(20.0 if robot == "r1" else 1.0, 0.0, 0.0) for robot, name in names.items()}
    begun = {names["r0"]: 2.0}
    made = ordered(plan, told, goals, begun, lead=0.5, gone={names["r0"]: gone})
    (meeting,) = meetings_of(lives_of(made), localisation=0.05)
    assert np.all(meeting.one_first == (meeting.one.object == first))


@pytest.mark.parametrize(("driven", "good"), [(0.5, True), (2.5, False)])
def test_no_plan_is_taken_over_in_which_somebody_is_beyond_where_it_waits(crossed, driven, good):
    plan, told = crossed
    names = {m["object"]: m["activity"] for m in plan["motions"]}
    later = {name: Goal(20.0 if r == "r1" else 1.0, 0.0, 0.0) for r, name in names.items()}
    made = ordered(plan, told, later)
    data = with_dependencies(told.problem, made)
    old = Executor(plan, dependencies=told)
    old.commands(1.0)
    old.update("r0", progress=driven, now=4.0)
    day = SimpleNamespace(
        executor=old, origin=0.0, settings=Settings(), _following={},
    )  # fmt: skip
    begun = {n: 3.0 for n, p in old.state.phase.items() if p is not TaskPhase.WAITING}
    ask = SimpleNamespace(cut=Cut(0.0, kept=(*names.values(),), begun=begun))
    if good:
        assert Operation._joined(day, data, ask, 0.0).phase(names["r0"]) is TaskPhase.RUNNING
    else:
        with pytest.raises(ProblemError, match="beyond where it would have to wait"):
            Operation._joined(day, data, ask, 0.0)


@pytest.mark.parametrize("opened", [{}, {"r0": Opened.ALL}])
@pytest.mark.parametrize("seed", range(40))
def test_a_motion_that_ends_early_does_not_end_behind_its_robot(crossed, seed, opened):
    """Somebody stands on its way where no plan has it, and it has passed where it would wait."""
    plan, told = crossed
    rng = random.Random(f"stub {seed}")
    names = {m["activity"]: m["object"] for m in plan["motions"]}
    meanings = {name: ["move", "", robot] for name, robot in names.items()}
    plan = with_dependencies(told.problem, plan) | {"meanings": meanings}
    old = Executor(plan, dependencies=told, ahead=rng.choice([None, 1.2]))
    old.commands(1.0)
    driven = rng.uniform(0.0, 3.0)
    old.update("r0", progress=driven, now=8.0)
    limit = max(0.0, driven + rng.uniform(-0.6, 1.0))
    cut = Cutter(old, limits={"move_r0_0": limit}, opened=opened).cut(rng.uniform(0.0, 4.0))
    stop, begun = cut.stops["move_r0_0"], cut.starts.get("move_r0_0", 0.0)
    assert stop >= driven
    kept = kept_of(old, cut)
    made = {**plan, "motions": [*kept.motions], "activities": [*kept.activities]}
    made["objects"] = [{**o, "initial": [*kept.initial[o["name"]]]} for o in plan["objects"]]
    alone = Dependencies(
        Draft(tasks_of(made, {n: (names[n],) for n in cut.kept}), lives_of(made)).graph(0.01),
        lives_of(made), (), (), 0.05,
    )  # fmt: skip
    after = ordered(made, alone, {}, cut.begun, gone=cut.gone)
    assert not motion_faults(after)
    (left,) = (m for m in after["motions"] if m["object"] == "r0")
    assert left["progress"][-1] == pytest.approx(stop - begun, abs=1e-3)


@pytest.mark.parametrize("opened", [{}, {"r0": Opened.ALL}])
@pytest.mark.parametrize("driven", [0.3, 1.0, 1.37, 2.5, 4.21])
def test_what_is_left_of_a_motion_has_the_cells_that_it_had(crossed, driven, opened):
    """Else robots would have to wait elsewhere than they were told: such plans are dropped."""
    plan, told = crossed
    names = {m["object"]: m["activity"] for m in plan["motions"]}
    plan = with_dependencies(told.problem, plan)
    plan |= {"meanings": {name: ["move", "", robot] for robot, name in names.items()}}
    old = Executor(plan, dependencies=told)
    old.commands(1.0)
    old.update("r0", progress=driven, now=8.0)
    cut = Cutter(old, opened=opened).cut(0.1)
    gone = cut.starts[names["r0"]]
    assert driven - 0.4 < gone <= driven - old.state.errors["r0"]
    (left,) = (m for m in kept_of(old, cut).motions if m["object"] == "r0")
    edges = old.drives[names["r0"], "r0"].path.edges
    stop = cut.stops.get(names["r0"], edges[-1])
    assert stop < edges[-1] or not opened or driven > 4.0
    fresh = drives_of(lives_of({**plan, "motions": [left]}))[names["r0"], "r0"].path.edges
    mine = edges[(edges >= gone - 2e-5) & (edges <= stop + 2e-5)]
    assert fresh == pytest.approx(mine - gone, abs=3e-5)


def test_new_work_waits_for_what_is_kept_of_its_robot_its_resources_and_what_comes_before():
    crane = {"at": "rack0", "resources": ["crane"]}
    first = job_record({"id": "o0", "pickup": crane, "delivery": "dock0"})
    later = [
        job_record({"id": "o1", "pickup": "rack1", "delivery": "dock1", "after": ["o0"]}),
        job_record({"id": "o2", "pickup": crane, "delivery": "dock1"}),
        job_record({"id": "o3", "pickup": "rack1", "delivery": "dock1"}),
    ]
    kept = Kept(
        activities=({"name": "deliver_o0", "start": 0, "end": 5},),
        meanings={"deliver_o0": Meaning(Kind.DELIVERY, "o0", "r0")},
    )
    new = {f"pick_{j.id}#1": Meaning(Kind.PICKUP, j.id, "r1") for j in later}
    new["home_r0#1"] = Meaning(Kind.MOVE, "", "r0")
    for listing in itertools.permutations(range(3)):
        some = [later[k] for k in listing]
        ask = SimpleNamespace(kept=kept, kept_jobs=(first,), to_do=some)
        meant = dict(sorted(new.items(), reverse=listing[0] > listing[1]))
        found = sorted(_after(ask, meant, {**kept.meanings, **meant}))
        waits = ("home_r0#1", "pick_o1#1", "pick_o2#1")
        assert found == [("deliver_o0", name) for name in waits]


@pytest.mark.parametrize("seed", range(30))
def test_a_gate_that_lies_a_little_earlier_in_a_new_plan_holds_nobody_who_is_let_beyond(
    crossed, seed
):
    """The same order with a larger margin: who was let drive to where it had to wait goes on, and
    still waits for who goes first.
    """
    plan, told = crossed
    rng = random.Random(f"gates {seed}")
    names = {m["object"]: m["activity"] for m in plan["motions"]}
    wide = with_dependencies(told.problem, plan, localisation=rng.uniform(0.06, 0.2))
    old = Executor(plan, dependencies=told)
    old.commands(1.0)
    (waits,) = {n for n, e in ends(plan).items() if e == max(ends(plan).values())}
    first = next(r for r in names if r != waits)
    here = old.state.ways[names[waits], waits]
    at = old.state.until(here)
    old.commands(2.0)
    old.update(waits, progress=rng.uniform(0.0, at), now=4.0)
    old.state.of_object[waits].let = at
    new = Executor(wide)
    cut = Cut(0.0, kept=(*names.values(),), begun=dict.fromkeys(names.values(), 1.0))
    follow_on(new, old, cut, 0.0)
    way = new.state.ways[names[waits], waits]
    assert at - 1e-3 <= new.state.until(way) < way.length
    again = Executor.restore(wide, new.save())
    assert again.state.until(again.state.ways[names[waits], waits]) == new.state.until(way)
    gone = new.state.ways[names[first], first].length
    new.update(first, progress=gone, now=60.0)
    assert new.state.until(way) == way.length


def test_who_begins_soon_and_cannot_come_to_its_end_is_kept_to_where_it_waits(crossed):
    plan, told = crossed
    names = {m["object"]: m["activity"] for m in plan["motions"]}
    meanings = {name: ["move", "", robot] for robot, name in names.items()}
    old = Executor(
        with_dependencies(told.problem, plan) | {"meanings": meanings}, dependencies=told
    )
    first, waits = sorted(names, key=ends(plan).get)
    pose = next(tuple(o["initial"]) for o in plan["objects"] if o["name"] == first)
    cut = Cutter(old, broken={first: pose}).cut(2.0)
    old.commands(1.0)
    assert old.phase(names[waits]) is TaskPhase.RUNNING
    assert cut.kept == (names[waits],)
    assert 0.0 < cut.stops[names[waits]] <= old.state.until(old.state.ways[names[waits], waits])
