"""Plans in which robots carry loads: robot and load are one body on the floor, too."""

import dataclasses
import importlib.resources
import json
import math

import pytest
from jsonschema import Draft7Validator

from tests.execution import floors
from tests.search.test_rides import carrying, solve
from up_samp.execution import (
    Delays,
    Executor,
    dependencies_from_plan,
    dependencies_of,
    simulate,
    with_dependencies,
)
from up_samp.execution.simulate import solve_remaining
from up_samp.io import plan_from_dict, plan_to_dict, read_plan, write_plan
from up_samp.validation import validate_plan

LATE = Delays(slow=0.5, stops=3.0, long_stop=20.0)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Through a gap that is wide enough for one: r0 with its pallet, and r1, which then stands
    where the pallet stood.
    """
    folder = tmp_path_factory.mktemp("loads")
    hall, _ = carrying(folder, 1.6, gap=(18, 42), robots=2)
    hall.pose("there", 17.0, 7.0, math.pi)
    hall.pose("here", 4.0, 3.0, math.pi)
    problem = hall.problem
    problem.initial_configuration[:] = [
        (o, p) for o, p in problem.initial_configuration if str(o) != "r1"
    ]
    problem.set_initial_configuration(hall.robots[1], hall.poses["there"])
    hall.move("come", 1, "there", "here")
    plan = plan_to_dict(problem, solve(problem).plan)
    return problem, plan, dependencies_of(problem, plan)


def met(found):
    """Who waits for whom because bodies would meet, by the reasons' names."""
    return [e for e in found.graph.edges if e.kind == "meeting"]


def test_who_comes_next_waits_until_the_load_is_gone(world):
    _, plan, found = world
    assert plan["rides"]
    pairs = {frozenset(m.pair) for m in found.meetings}
    assert frozenset(("r0", "r1")) in pairs
    assert frozenset(("r1", "pallet")) in pairs
    assert met(found)
    runs = [simulate(found, plan, LATE, seed, policy="staircase") for seed in range(3)]
    runs.append(simulate(found, plan, LATE, 3, policy="reorder"))
    for run in runs:
        assert run.finished
        assert run.contacts == ()
        assert run.broken == ()
        assert run.record["rides"] == plan["rides"]


def test_without_the_edges_the_load_is_hit(world):
    _, plan, found = world
    kept = tuple(e for e in found.graph.edges if e.kind != "meeting")
    broken = dataclasses.replace(found, graph=dataclasses.replace(found.graph, edges=kept))
    runs = [simulate(broken, plan, LATE, seed) for seed in range(6)]
    hit = {frozenset((c.one, c.other)) for run in runs for c in run.contacts}
    assert any("pallet" in pair for pair in hit)


def test_a_plan_file_is_followed_without_its_problem(world, tmp_path):
    problem, plan, found = world
    file = write_plan(tmp_path / "plan.json", with_dependencies(problem, plan))
    schema = importlib.resources.files("up_samp.io").joinpath("plan.schema.json").read_text()
    Draft7Validator(json.loads(schema)).validate(json.loads(file.read_text()))
    again = dependencies_from_plan(read_plan(file))
    assert set(map(str, again.graph.events)) == set(map(str, found.graph.events))
    assert len(again.meetings) == len(found.meetings)


def test_what_is_left_in_the_middle_of_a_ride(world):
    problem, plan, found = world
    executor = Executor(plan, problem, dependencies=found)
    executor.commands(0.0)
    executor.commands(30.0)
    first = min((m for m in plan["motions"] if m["object"] == "r0"), key=lambda m: m["samples"])
    assert first["activity"] == "carry"
    if executor.phase("carry").value != "running":
        executor.update("r1", progress=executor.commands()["r1"].until, now=31.0)
        executor.commands(31.0)
    until = executor.commands()["r0"].until
    executor.update("r0", progress=min(4.0, until), now=35.0)
    left = executor.remaining_problem()
    x, y, theta = left.poses["r0"]
    ahead = (x + 0.9 * math.cos(theta), y + 0.9 * math.sin(theta))
    assert left.poses["pallet"][:2] == pytest.approx(ahead, abs=1e-3)
    rest = solve_remaining(left, seconds=60)
    assert {r["activity"] for r in rest["rides"]} == {"carry"}
    assert validate_plan(left.problem, plan_from_dict(left.problem, rest)).valid


def check(seed, yaml):
    """Random plans with crates under random delays: as without; returns how many rides."""
    problem, plan = floors.random_floor(seed, yaml, crates=True)
    verdict = validate_plan(problem, plan_from_dict(problem, plan))
    assert verdict.valid, verdict.violations
    found = dependencies_of(problem, plan)
    run = simulate(found, plan, LATE, seed, policy="reorder" if seed % 2 else "staircase")
    assert run.finished
    assert run.contacts == ()
    assert run.overruns == 0
    assert run.broken == ()
    return len(plan.get("rides", ())), found, plan


def test_random_plans_with_crates(yaml):
    assert sum(check(seed, yaml)[0] for seed in range(500, 505)) >= 3


@pytest.mark.long
def test_many_random_plans_with_crates(yaml):
    """With the order of who passes first taken out, crates are hit."""
    rides = hit = 0
    for seed in range(600, 660):
        count, found, plan = check(seed, yaml)
        rides += count
        kept = tuple(e for e in found.graph.edges if e.kind != "meeting")
        if len(kept) < len(found.graph.edges):
            graph = dataclasses.replace(found.graph, edges=kept)
            broken = dataclasses.replace(found, graph=graph)
            for draw in range(3):
                run = simulate(broken, plan, LATE, draw)
                if any("crate" in c.one + c.other for c in run.contacts):
                    hit += 1
                    break
    assert rides >= 30
    assert hit >= 2
