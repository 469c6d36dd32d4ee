"""Tasks for several robots: each at a place of its own, from the task's start to its end."""

import pytest

from tests.fleet.test_rules import one_room, solved
from tests.shuffled import shuffled_fleet
from up_samp.execution import Delays, dependencies_of, simulate
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.files import write_problem_file


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


def test_loads_that_several_robots_carry_are_refused_by_name():
    fleet = one_room(robots=2)
    for options in ({"crew": 2}, {"attached": {"footprint": (3, 1), "crew": 2}}):
        with pytest.raises(FleetError, match="no load is carried by several robots together"):
            fleet.add_order("beam", "a", "b", **options)
