"""Orders of activities that could be the other way round: which they are, and that turning them
round keeps everything that the problem asks for.
"""

import math
import random

from unified_planning.shortcuts import LE, LT, And, Equals, Or

from tests.execution import floors
from tests.execution.sites import Site
from tests.execution.test_orders import made
from up_samp.execution import Delays, Do, Executor, Heard, dependencies_of, simulate
from up_samp.execution.build import with_sides
from up_samp.execution.reorder import can_wait, happened
from up_samp.model import ProblemError


def pairs(choices):
    return {(c[0].first.activity, c[0].then.activity) for c in choices}


def test_machine_orders_and_unary_resources_are_choices_and_precedences_are_not():
    times = {"a": (0, 2), "b": (3, 5), "c": (6, 8), "d": (9, 10)}

    def state(p, x):
        p.add_constraint(Or(LT(x["b"].end, x["a"].start), LT(x["a"].end, x["b"].start)))
        # this one is asked for anyhow, this one follows from what is
        p.add_constraint(Or(LT(x["c"].end, x["b"].start), LT(x["b"].end, x["c"].start)))
        p.add_constraint(LT(x["b"].end, x["c"].start))
        p.add_constraint(Or(LT(x["d"].end, x["b"].start), LT(x["b"].end, x["d"].start)))
        p.add_constraint(LT(x["c"].end, x["d"].start))
        # three ways are no choice of two
        p.add_constraint(
            Or(LT(x["d"].end, x["a"].start), And(LT(x["a"].end, x["d"].start)), LT(x["a"].end, 9))
        )
        tool = p.add_resource("tool", 3)
        x["a"].uses(tool, 2)
        x["c"].uses(tool, 2)

    problem, plan = made(times, state)
    found = dependencies_of(problem, plan)
    assert pairs(found.choices) == {("a", "b"), ("a", "c")}
    assert {c[0].kind for c in found.choices} == {"constraint", "resource"}
    assert {e.why.split()[0] for e in found.graph.edges if e.kind == "resource"} <= {"c"}


TIMES = {
    "fetch_a": (0, 1),
    "bring_a": (2, 12),
    "do_a": (13, 23),
    "bring_b": (0, 14),
    "do_b": (24, 34),
}


def shop(p, x):
    """Two jobs that are brought to one machine."""
    p.add_constraint(LT(x["fetch_a"].end, x["bring_a"].start))
    for job in "ab":
        p.add_constraint(LT(x[f"bring_{job}"].end, x[f"do_{job}"].start))
    p.add_constraint(Or(LT(x["do_a"].end, x["do_b"].start), LT(x["do_b"].end, x["do_a"].start)))


def late(state):
    """The second job is there at 15 s, the first has not even been fetched."""
    problem, plan = made(TIMES, state)
    executor = Executor(plan, problem)
    executor.commands(0.0)
    executor.done("bring_b", 14.0)
    executor.commands(15.0)
    assert executor.phase("do_b").value == "waiting"
    return executor


def test_a_machine_takes_the_job_that_is_there():
    executor = late(shop)
    assert executor.predicted_makespan() > 44.0
    assert executor.reorder() == 1
    assert executor.predicted_makespan() < 36.0
    executor.commands(15.1)
    assert executor.phase("do_b").value == "running"
    executor.done("fetch_a", 16.0)
    executor.commands(16.1)
    # what has begun is not turned back
    assert executor.reorder() == 0
    executor.done("do_b", 25.2)
    executor.commands(25.3)
    assert executor.phase("do_a").value == "waiting"
    executor.done("bring_a", 26.2)
    executor.commands(26.3)
    executor.done("do_a", 36.4)
    assert executor.finished


def test_no_order_is_changed_where_a_deadline_would_be_missed_by_more():
    executor = late(lambda p, x: (shop(p, x), p.add_constraint(LT(x["do_a"].end, 24))))
    assert executor.missed()
    before = executor.missed()
    executor.reorder()
    assert sum(executor.missed().values()) <= sum(before.values()) + 1e-3


def turn_one(rng):
    """Turn a random choice or component round wherever nobody is committed, better or not."""

    def watch(executor):
        choices = executor.dependencies.choices
        open_ = []
        for k, choice in enumerate(choices):
            now, other = choice if executor.sides.get(k, True) else choice[::-1]
            if can_wait(executor.state, other) and not happened(executor.state, now.first):
                open_.append(k)
        if not open_ or rng.random() < 0.5:
            return 0
        k = rng.choice(open_)
        sides = {**executor.sides, k: not executor.sides.get(k, True)}
        try:
            graph = with_sides(executor.dependencies, sides)
        except ProblemError:
            return 0
        executor.sides = sides
        executor.state.load(graph)
        return 1

    return watch


def test_whatever_is_turned_round_nothing_is_broken(yaml):
    """Random turns, for no reason: no collision, no deadlock, every order kept."""
    turns = 0
    for seed in range(300, 306):
        problem, plan = floors.random_floor(seed, yaml)
        found = dependencies_of(problem, plan)
        if not found.choices:
            continue
        watch = turn_one(random.Random(seed))
        run = simulate(found, plan, Delays.of_share(0.3), seed, policy="reorder", watch=watch)
        turns += run.reorders
        assert run.finished, seed
        assert run.contacts == (), seed
        assert run.broken == (), seed
    assert turns >= 2


def below_a_lift(yaml):
    """r1 crosses where a lift sets r0 down, which waits below: a site, and until when it does."""
    site = Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    site.robot("r1", (9.0, 8.0, math.pi))
    there = site.drive("to_lift", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0) + 12
    site.drive("across", "r1", (9.0, 8.0, math.pi), [(7.0, 0.0)], 0)
    site.lift("ride_r0", "r0", (6.0, 8.0, 0.0), there, there + 8)
    x = site.activities
    site.problem.add_constraint(LE(x["to_lift"].end, x["ride_r0"].start))
    return site, there


def waits_for_r1(graph):
    return {str(p.then) for p in graph.edges if p.first.object == "r1"}


def test_a_lift_is_held_back_before_it_begins_whatever_orders_were_changed(yaml):
    site, _ = below_a_lift(yaml)
    found = dependencies_of(site.problem, site.data)
    assert waits_for_r1(found.graph) == {"start of ride_r0"}
    assert waits_for_r1(with_sides(found, {})) == {"start of ride_r0"}


def test_a_lift_that_has_begun_too_soon_does_not_end_before_it_may(yaml):
    """As executions were kept that had begun it by an order in which it was held at its end."""
    site, _ = below_a_lift(yaml)
    executor = Executor(site.data, site.problem)
    executor.commands(0.0)
    for now, progress in ((1.0, 0.5), (4.0, 1.5), (7.0, 3.0)):
        executor.update("r0", progress=progress, now=now, motion="to_lift")
        executor.update("r1", progress=0.5, now=now, motion="across")
    executor.commands(8.0)
    assert executor.phase("to_lift").value == "done"
    kept = executor.save()
    kept["running"].append("ride_r0")
    kept["fired"].append([["start", "ride_r0"], 8.0])
    again = Executor.restore(site.data, kept, site.problem)
    assert again.commands(30.0)["r0"] == Do("ride_r0", may_end=False)
    assert again.done("ride_r0", 30.0).heard is Heard.AGAIN
    again.update("r1", progress=6.0, now=31.0, motion="across")
    assert again.commands(32.0)["r0"] == Do("ride_r0")


def test_what_begins_with_a_lift_waits_with_it_whatever_orders_were_changed(yaml):
    site, there = below_a_lift(yaml)
    site.task("lamp", there, there + 3)
    x = site.activities
    site.problem.add_constraint(Equals(x["lamp"].start, x["ride_r0"].start))
    found = dependencies_of(site.problem, site.data)
    first = waits_for_r1(found.graph)
    assert "start of lamp" in first
    assert waits_for_r1(with_sides(found, {})) == first
