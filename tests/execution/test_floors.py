"""Random plans under random delays: nobody collides, nobody waits for ever, every order is kept."""

import dataclasses
import random

import pytest
from unified_planning.shortcuts import GE

from tests.execution import floors
from tests.execution.sites import Site
from up_samp.execution.build import dependencies_of
from up_samp.execution.floor import Delays
from up_samp.execution.simulate import simulate
from up_samp.io import plan_from_dict
from up_samp.model import ProblemError
from up_samp.validation import validate_plan

PATTERNS = (
    Delays(),
    Delays.of_share(0.3),
    Delays(slow=0.7, late=1.0),
    Delays(stops=6.0, stop_seconds=4.0),
    Delays(slow=0.2, long_stop=30.0),
)


def check(run):
    """All that has to hold of a run."""
    assert run.finished, f"deadlock: {run.deadlock}"
    assert run.contacts == ()
    assert run.overruns == 0
    assert run.broken == ()


@pytest.mark.parametrize("seed", range(3))
def test_plans_are_what_they_should_be(yaml, seed):
    problem, plan = floors.random_floor(seed, yaml)
    verdict = validate_plan(problem, plan_from_dict(problem, plan))
    assert verdict.valid, verdict.violations


@pytest.mark.parametrize("seed", range(8))
def test_delays_do_no_harm(yaml, seed):
    problem, plan = floors.random_floor(seed, yaml)
    found = dependencies_of(problem, plan)
    policy = "staircase" if seed % 2 else "reorder"
    check(simulate(found, plan, PATTERNS[seed % 5], seed, policy=policy))


@pytest.mark.long
@pytest.mark.parametrize("block", range(20))
def test_a_thousand_runs(yaml, block):
    for seed in range(100 + 10 * block, 110 + 10 * block):
        problem, plan = floors.random_floor(seed, yaml)
        found = dependencies_of(problem, plan)
        for k, pattern in enumerate(PATTERNS):
            policy = "reorder" if k % 2 else "staircase"
            check(simulate(found, plan, pattern, seed + k, policy=policy))


def without(found, gone):
    """The dependencies without some edges."""
    edges = tuple(e for e in found.graph.edges if e not in gone)
    return dataclasses.replace(found, graph=dataclasses.replace(found.graph, edges=edges))


def steps(found, edge):
    """An edge with the other steps of the same staircase."""
    pair = (edge.first.activity, edge.then.activity)
    return {
        e
        for e in found.graph.edges
        if e.kind == edge.kind and (e.first.activity, e.then.activity) == pair
    }


def test_missing_edges_are_caught(yaml):
    """Without an edge somebody collides or breaks an order, if the one to wait for is late."""
    caught = {"meeting": 0, "other": 0}
    late = Delays(slow=0.7, stops=4.0, late=1.0, long_stop=30.0)
    for seed in range(10):
        if min(caught.values()) >= 3:
            break
        problem, plan = floors.random_floor(seed, yaml)
        found = dependencies_of(problem, plan)
        rng = random.Random(seed)
        met = [e for e in found.graph.edges if e.kind == "meeting"]
        others = [e for e in found.graph.edges if e.kind not in ("meeting", "duration")]
        for edge in (*rng.sample(met, min(4, len(met))), *rng.sample(others, min(2, len(others)))):
            kind = "meeting" if edge.kind == "meeting" else "other"
            gone = steps(found, edge) if kind == "meeting" else {edge}
            for draw in range(3 if caught[kind] < 3 else 0):
                run = simulate(without(found, gone), plan, late, draw)
                if run.contacts or run.broken:
                    caught[kind] += 1
                    break
    assert caught["meeting"] >= 3, caught
    assert caught["other"] >= 3, caught


@pytest.mark.parametrize(
    "text", ["stops=inf", "late=nan", "slow=1", "slow=nan", "slow=-0.1", "lag=-1", "30", "fast=1"]
)
def test_delays_that_are_none_are_named(text):
    with pytest.raises(ProblemError, match=text.split("=")[0]):
        Delays.parse(text)


@pytest.mark.parametrize("policy", ["timed", "staircase", "reorder"])
def test_who_waits_for_a_time_is_in_no_deadlock(yaml, policy):
    """A shift, a release or a break begins long after all else is over."""
    site = Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    site.drive("go_r0", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0)
    site.task("late_r0", 40, 42)
    site.problem.add_constraint(GE(site.activities["late_r0"].start, 40))
    found = dependencies_of(site.problem, site.data)
    check(simulate(found, site.data, Delays(slow=0.3), 1, policy=policy))
