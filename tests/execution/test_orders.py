"""What the problem asks of the order of activities becomes edges and bounds."""

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import LE, LT, And, Not, Or, Plus

from up_samp.execution import At, Event, dependencies_of
from up_samp.io import plan_to_dict
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.objective import Cost, MinimizeCosts


def made(times, state, optional=()):
    """A problem with activities of these (start, end), what ``state`` says of them, and the
    plan.
    """
    problem = SchedulingProblem("orders")
    activities = {
        name: problem.add_activity(name, end - start, optional=name in optional)
        for name, (start, end) in times.items()
    }
    for name in optional:
        if name not in activities:
            activities[name] = problem.add_activity(name, 1, optional=True)
    state(problem, activities)
    assignment = {}
    for name, (start, end) in times.items():
        assignment[activities[name].start] = start
        assignment[activities[name].end] = end
    plan = Schedule([activities[n] for n in times], assignment)
    return problem, plan_to_dict(problem, plan)


def pairs(problem, plan):
    """Edges but for durations, as (first, then, lag), and bounds as (first, then, most)."""
    graph = dependencies_of(problem, plan).graph

    def named(pair):
        ends = (pair.first, pair.then)
        return [f"{e.activity}.{e.at.value}" if e.activity else "origin" for e in ends]

    edges = {(*named(e), round(e.lag, 6)) for e in graph.edges if e.kind != "duration"}
    bounds = {(*named(b), b.most) for b in graph.bounds if "duration" not in b.why}
    return edges, bounds


def test_the_part_of_a_disjunction_that_the_plan_keeps():
    times = {"a": (0, 2), "b": (3, 5)}

    def state(p, x):
        p.add_constraint(Or(LT(x["b"].end, x["a"].start), LT(x["a"].end, x["b"].start)))

    assert pairs(*made(times, state)) == ({("a.end", "b.start", 0.001)}, set())


def test_what_is_best_asks_for_no_order():
    times = {"a": (0, 2), "b": (3, 5)}

    def state(p, x):
        p.add_constraint(LT(x["a"].end, x["b"].start))
        p.add_quality_metric(MinimizeCosts((Cost("ends", 1, Plus(x["b"].end, 0)),), p.environment))

    assert pairs(*made(times, state)) == ({("a.end", "b.start", 0.001)}, set())


def test_lags_deadlines_releases_and_windows():
    times = {"a": (1, 2), "b": (5, 7)}

    def state(p, x):
        p.add_constraint(LE(Plus(x["a"].end, 2), x["b"].start))
        p.add_constraint(LE(x["b"].start, Plus(x["a"].end, 4)))
        p.add_constraint(LE(x["b"].end, 9))
        p.add_constraint(LE(1, x["a"].start))
        p.add_constraint(Not(LT(x["b"].start, x["a"].start)))

    edges, bounds = pairs(*made(times, state))
    assert edges == {("a.end", "b.start", 2.0), ("origin", "a.start", 1.0)}
    assert bounds == {("a.end", "b.start", 4.0), ("origin", "b.end", 9.0)}


def test_starting_at_zero_and_starting_together_are_no_cycles():
    times = {"a": (0, 2), "b": (0, 3)}

    def state(p, x):
        p.add_constraint(LE(x["a"].start, 0))
        p.add_constraint(And(LE(x["a"].start, x["b"].start), LE(x["b"].start, x["a"].start)))

    edges, bounds = pairs(*made(times, state))
    assert edges == {("a.start", "b.start", 0.0)}
    assert bounds == {("origin", "a.start", 0.0), ("a.start", "b.start", 0.0)}


def test_what_is_absent_asks_for_nothing():
    times = {"a": (0, 2), "b": (0, 3)}

    def state(p, x):
        p.add_constraint(LT(x["a"].end, x["c"].start))
        p.add_constraint(LT(x["c"].end, x["b"].start), scope=[x["c"].present])
        p.add_constraint(Or(x["c"].present, x["a"].present))

    assert pairs(*made(times, state, optional=("a", "c"))) == (set(), set())


def test_units_of_a_resource_are_handed_over():
    """Three users of two units: the third takes over from who gives back last before it starts."""
    times = {"a": (0, 4), "b": (1, 3), "c": (4, 6)}

    def state(p, x):
        crew = p.add_resource("crew", 2)
        for activity in x.values():
            activity.uses(crew, 1)

    assert pairs(*made(times, state)) == ({("a.end", "c.start", 0.0)}, set())


def test_a_plan_that_breaks_a_constraint_is_refused():
    problem, plan = made({"a": (0, 2)}, lambda p, x: p.add_constraint(LE(3, x["a"].start)))
    with pytest.raises(ProblemError, match="the plan breaks the constraint"):
        dependencies_of(problem, plan)


def test_sums_of_three_times_are_refused_by_name():
    def state(p, x):
        p.add_constraint(LE(Plus(x["a"].end, x["b"].end), x["c"].end))

    problem, plan = made({"a": (0, 1), "b": (0, 1), "c": (1, 2)}, state)
    with pytest.raises(UnsupportedError, match="no difference of two points in time"):
        dependencies_of(problem, plan)


def test_edges_that_follow_are_dropped():
    times = {"a": (0, 1), "b": (2, 3), "c": (4, 5)}

    def state(p, x):
        for one, two in (("a", "b"), ("b", "c"), ("a", "c")):
            p.add_constraint(LT(x[one].end, x[two].start))

    problem, plan = made(times, state)
    graph = dependencies_of(problem, plan).graph
    pairs_ = {(e.first, e.then) for e in graph.edges}
    assert (Event(At.END, "a"), Event(At.START, "c")) not in pairs_
    assert len(graph.edges) == graph.before_reduction - 1
