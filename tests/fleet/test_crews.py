"""Tasks for several robots: each at a place of its own, from the task's start to its end."""

import pytest

from tests.fleet.test_rules import one_room, solved
from tests.shuffled import shuffled_fleet
from up_samp.execution import Delays, dependencies_of, simulate
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.files import write_problem_file
from up_samp.fleet.meanings import Kind
from up_samp.fleet.visits import ENDS
from up_samp.validation import validate_plan


def parts(result, task):
    """Who does a task's parts in a plan, with start and end, by place."""
    done = result.written.happening(result.data["activities"])
    mine = [(meaning.robot, a) for meaning, a in done if meaning.what == task]
    return {a["name"].rpartition("_at_")[2]: (robot, a["start"], a["end"]) for robot, a in mine}


def test_a_crew_begins_and_ends_together():
    fleet = one_room(robots=2)
    fleet.add_task("busy", "c", duration=15, robots="r1")
    fleet.add_task("lift", ["a", "b"], duration=6, crew=2)
    fleet.add_task("look", "c", duration=2, after="lift")
    result, times = solved(fleet)
    found = parts(result, "lift")
    assert set(found) == {"a", "b"}
    (one, *span), (other, *same) = found.values()
    assert {one, other} == {"r0", "r1"}
    assert span == same
    assert span[1] - span[0] == 6
    looks = [start for name, (start, _) in times.items() if name.startswith("look")]
    assert looks[0] >= span[1]


def test_a_third_robot_stays_at_home_and_skills_count():
    fleet = one_room(robots=1)
    for name, y in (("s1", 7), ("s2", 11)):
        fleet.add_robot(name, "agv", [2, y, 0], skills="lifts")
    fleet.add_task("lift", ["a", "b"], duration=6, crew=2, skills="lifts")
    result, _ = solved(fleet)
    assert {robot for robot, _, _ in parts(result, "lift").values()} == {"s1", "s2"}
    assert {m["object"] for m in result.data["motions"]} == {"s1", "s2"}


def test_a_crew_is_late_once_and_takes_resources_once():
    fleet = one_room(robots=2, objective={"tardiness": 1, "driving": 0.001})
    fleet.add_resource("crane")
    fleet.add_task("lift", ["a", "b"], duration=6, crew=2, due=1, resources="crane")
    result, _ = solved(fleet)
    ((_, _, end), _) = parts(result, "lift").values()
    assert result.costs["tardiness"] == end - 1
    assert result.explain().count("lift ends") == 1


@pytest.mark.parametrize(("penalty", "left"), [(1, True), (900, False)])
def test_a_crew_does_all_of_it_or_nothing(penalty, left):
    fleet = one_room(robots=2)
    fleet.add_task("here", "c", duration=1, robots="r0")
    fleet.add_task("lift", ["a", "b"], duration=6, crew=2, optional=True, penalty=penalty)
    result, times = solved(fleet)
    assert result.left_out == (["lift"] if left else [])
    assert sum(name.startswith("lift_") for name in times) == (0 if left else 2)


def test_what_is_late_keeps_a_crew_together():
    fleet = one_room(robots=2)
    fleet.add_task("lift", ["a", "b"], duration=6, crew=2)
    result, _ = solved(fleet)
    found = dependencies_of(fleet.problem, result.data)
    begun = set()
    for seed in range(3):
        run = simulate(found, result.data, Delays(slow=0.5, stops=9.0), seed)
        assert run.finished
        assert (run.broken, run.contacts) == ((), ())
        starts = [a["start"] for a in run.record["activities"] if a["name"].startswith("lift_")]
        assert len(starts) == 2
        assert starts[0] == pytest.approx(starts[1], abs=0.2)  # one step of the clock
        begun.add(starts[0])
    assert len(begun) > 1


def test_what_is_wrong_with_a_crew_is_told():
    fleet = one_room(robots=2)
    with pytest.raises(FleetError, match=r"\.at: a crew of 2 needs a place for each robot: name 2"):
        fleet.add_task("lift", "a", duration=6, crew=2)
    with pytest.raises(FleetError, match=r"\.at: a crew of 3 needs a place"):
        fleet.add_task("lift", ["a", "b", "b"], duration=6, crew=3)
    with pytest.raises(FleetError, match=r"\.crew: 2 of 3 robots may do it \(r0, r1\)"):
        fleet.add_task("lift", ["a", "b", "c"], duration=6, crew=3)


@pytest.mark.long
def test_any_listing_has_the_same_optimum(tmp_path):
    fleet = one_room(robots=2)
    fleet.add_task("busy", "c", duration=9)
    fleet.add_task("lift", ["a", "b"], duration=6, crew=2, repeat={"every": 30, "times": 2})
    best = solved(fleet)[0].makespan
    for seed in range(2):
        told = shuffled_fleet(fleet.records, seed)
        again = Fleet.from_file(write_problem_file(tmp_path / "other.yaml", told.records))
        assert solved(again)[0].makespan == best


def planned(fleet):
    """Return a valid plan."""
    result = fleet.solve(first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(result.problem, result.plan).valid
    return result


def beam(robots=2, capacity=2, **options):
    """A beam that two robots carry, each one end of it, and something that lies on the way."""
    fleet = one_room(robots=robots, capacity=capacity)
    fleet.add_place("d", 12, 3)
    fleet.add_order("front", "a", {"at": "c", "service": 3}, **options)
    fleet.add_order("back", "d", {"at": "b", "service": 3}, together="front", **options)
    return fleet


def ends_of(result, *orders):
    """Who picks orders up and delivers them, and when that starts: by kind, in their order."""
    done = result.written.happening(result.data["activities"])
    found = {(m.what, m.kind): (m.robot, a["start"]) for m, a in done}
    return {kind: [found[order, kind] for order in orders] for kind in ENDS}


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))])
def test_two_robots_take_a_load_up_and_put_it_down_together(tmp_path, seed):
    fleet = beam()
    fleet.add_order("box", "a", "c")
    fleet.add_task("look", "b", duration=2)
    told = shuffled_fleet(fleet.records, seed)
    result = planned(Fleet.from_file(write_problem_file(tmp_path / "other.yaml", told.records)))
    names = {old: new for (sort, new), old in told.names.items() if sort == "jobs"}
    front, back, *others = (names[name] for name in ("front", "back", "box", "look"))
    spans = {}
    for kind, ((one, start), (other, same)) in ends_of(result, front, back).items():
        assert one != other
        assert start == same
        spans[kind] = start
    for meaning, a in result.written.happening(result.data["activities"]):
        if meaning.what in others:
            assert a["end"] <= spans[Kind.PICKUP] or a["start"] >= spans[Kind.DELIVERY]


def test_a_beam_waits_on_the_floor_for_who_is_late():
    result = planned(beam())
    found = dependencies_of(result.problem, result.data)
    apart = set()
    for seed in range(3):
        run = simulate(found, result.data, Delays(slow=0.5, stops=9.0), seed)
        assert run.finished
        assert (run.broken, run.contacts) == ((), ())
        starts = [a["start"] for a in run.record["activities"] if a["name"].startswith("deliver")]
        assert starts[0] == pytest.approx(starts[1], abs=0.2)  # one step of the clock
        apart.add(starts[0])
    assert len(apart) > 1


@pytest.mark.parametrize(("penalty", "left"), [(1, ["back", "front"]), (900, [])])
def test_a_beam_is_carried_by_all_or_left_where_it_is(penalty, left):
    result, _ = solved(beam(optional=True, penalty=penalty))
    assert sorted(result.left_out) == left


def test_a_beam_that_comes_again_is_carried_together_each_time():
    result = planned(beam(repeat={"every": 40, "times": 2}))
    for orders in (("front", "back"), ("front_2", "back_2")):
        for (_, start), (_, same) in ends_of(result, *orders).values():
            assert start == same


def test_what_is_wrong_with_orders_that_belong_together_is_told():
    with pytest.raises(FleetError, match=r"\.together: 1 of 2 robots may do it \(r0\)"):
        beam(robots=1)
    fleet = one_room(robots=2)
    with pytest.raises(FleetError, match=r"\.together: no order 'front'"):
        fleet.add_order("back", "a", "b", together="front")
    with pytest.raises(FleetError, match="name the other orders that 'o' is carried with"):
        fleet.add_order("o", "a", "b", together="o")
    with pytest.raises(FleetError, match=r"write an order for each robot, `together`"):
        fleet.add_order("o", "a", "b", crew=2)
