"""Times are whole units: fractions are rounded, and refused where no whole number is left."""

from __future__ import annotations

import itertools
import random
import sys
from fractions import Fraction

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    GT,
    LE,
    LT,
    ClosedDurationInterval,
    Equals,
    IntType,
    LeftOpenDurationInterval,
    MinimizeMakespan,
    OneshotPlanner,
    OpenDurationInterval,
    Or,
    Plus,
    RightOpenDurationInterval,
)

from up_samp.model import UnsupportedError

HALF = Fraction(1, 2)
COMPARISONS = {LE: lambda a, b: a <= b, LT: lambda a, b: a < b, Equals: lambda a, b: a == b}
INTERVALS = (
    ClosedDurationInterval,
    OpenDurationInterval,
    LeftOpenDurationInterval,
    RightOpenDurationInterval,
)


def solve(problem, engine="cpsat"):
    with OneshotPlanner(name=engine) as planner:
        return planner.solve(problem, timeout=20)


def makespan(result):
    if result.plan is None:
        return None
    ends = (result.plan.get(a.end).constant_value() for a in result.plan.activities)
    return max(map(int, ends), default=0)


def draw(rng):
    """Return a problem with fractions, and its least makespan by trying all whole times."""
    problem = SchedulingProblem("fractions")
    spans, names, gaps = [], "ab", []
    for name in names:
        low = Fraction(rng.randint(0, 6), rng.choice((1, 2, 3)))
        high = low + Fraction(rng.randint(7, 9), 3)
        kind = rng.choice(INTERVALS)
        promote = problem.environment.expression_manager.auto_promote
        problem.add_activity(name)._set_duration_constraint(kind(*promote(low, high)))
        spans.append((kind, low, high))
    one, other = problem.activities
    for _ in range(2):
        compare = rng.choice((LE, LE, LT, Equals) if not gaps else (LE, LT))
        gap = Fraction(rng.randint(-4, 7), rng.choice((1, 2, 3)))
        first, then = rng.sample(((one, 0), (other, 1)), 2)
        ends = rng.random() < 0.5
        left = first[0].end if ends else first[0].start
        problem.add_constraint(compare(Plus(left, gap), then[0].start))
        gaps.append((compare, first[1], ends, gap, then[1]))
    problem.add_quality_metric(MinimizeMakespan())
    return problem, least(spans, gaps)


def lasts(kind, low, high, d):
    left = low < d if kind in (OpenDurationInterval, LeftOpenDurationInterval) else low <= d
    right = d < high if kind in (OpenDurationInterval, RightOpenDurationInterval) else d <= high
    return left and right


def least(spans, gaps):
    durations = [[d for d in range(8) if lasts(*span, d)] for span in spans]
    best = None
    for starts in itertools.product(range(15), repeat=2):
        for chosen in itertools.product(*durations):
            fits = all(
                COMPARISONS[compare](starts[i] + (chosen[i] if ends else 0) + gap, starts[j])
                for compare, i, ends, gap, j in gaps
            )
            end = max(s + d for s, d in zip(starts, chosen, strict=True))
            best = end if fits and (best is None or end < best) else best
    return best


def test_rounded_problems_are_the_same_problems():
    rng = random.Random(7)
    found = []
    for _ in range(25):
        problem, expected = draw(rng)
        result = solve(problem)
        status = Status.UNSOLVABLE_PROVEN if expected is None else Status.SOLVED_OPTIMALLY
        assert (result.status, makespan(result)) == (status, expected), problem
        found.append(expected)
    assert None in found
    assert len(set(found)) > 4


def test_other_engines_get_whole_numbers():
    problem = SchedulingProblem("mixed")
    a, b = (problem.add_activity(name) for name in "ab")
    a.set_duration_bounds(HALF, 5 * HALF)
    b.set_duration_bounds(HALF, 5 * HALF)
    c = problem.add_activity("c", optional=True)
    problem.add_constraint(LE(Plus(a.end, 7 * HALF), b.start))
    problem.add_constraint(LT(b.start, Plus(a.end, 9 * HALF)))
    problem.add_constraint(Equals(c.start, HALF))
    result = solve(problem, "samp-refine[aries]")
    times = {x.name: int(result.plan.get(x.start).constant_value()) for x in (a, b)}
    assert times["b"] - int(result.plan.get(a.end).constant_value()) == 4
    assert c not in result.plan.activities


@pytest.mark.parametrize("engine", ["cpsat", "samp-refine[cpsat]", "samp-refine[aries]"])
def test_durations_without_a_whole_number_are_refused_by_name(engine):
    problem = SchedulingProblem("half")
    problem.add_activity("work").set_fixed_duration(Fraction(25, 2))
    problem.add_activity("rest", optional=True)
    words = r"duration of activity 'work', \[25/2, 25/2\], holds no whole number"
    if engine == "cpsat":
        result = solve(problem, engine)
        assert result.status is Status.UNSUPPORTED_PROBLEM
        assert "duration of activity 'work', [25/2, 25/2]" in result.log_messages[-1].message
    else:
        with pytest.raises(UnsupportedError, match=words):
            solve(problem, engine)


@pytest.mark.parametrize("engine", ["samp-refine[cpsat]", "samp-refine[aries]"])
def test_open_durations_without_a_whole_number_are_refused_by_name(engine):
    problem = SchedulingProblem("open")
    promote = problem.environment.expression_manager.auto_promote
    work = problem.add_activity("work")
    work._set_duration_constraint(OpenDurationInterval(*promote(HALF, Fraction(1))))
    with pytest.raises(UnsupportedError, match=r"duration of activity 'work', .* holds no whole"):
        solve(problem, engine)


def test_many_values_of_a_number_take_no_time():
    problem = SchedulingProblem("many")
    number = problem.add_activity("a", duration=2).add_parameter("n", IntType(0, 30_000_000))
    problem.add_constraint(GE(number, 3))
    problem.add_quality_metric(MinimizeMakespan())
    assert solve(problem).status is Status.SOLVED_OPTIMALLY


def test_what_there_is_no_number_for_is_absent():
    problem = SchedulingProblem("none")
    problem.add_activity("odd", optional=True).add_parameter("n", IntType(5, 3))
    problem.add_activity("back", optional=True).set_duration_bounds(-5, -3)
    problem.add_activity("work", duration=2)
    problem.add_quality_metric(MinimizeMakespan())
    result = solve(problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert [a.name for a in result.plan.activities] == ["work"]
    problem.add_constraint(Or(problem.get_activity(name).present for name in ("odd", "back")))
    assert solve(problem).status is Status.UNSOLVABLE_PROVEN


def test_fractions_leave_no_proof_open():
    problem = SchedulingProblem("between")
    activity = problem.add_activity("a", duration=2)
    problem.add_constraint(GT(activity.start, 5 * HALF))
    problem.add_constraint(LT(activity.start, Fraction(11, 4)))
    assert solve(problem).status is Status.UNSOLVABLE_PROVEN


HUGE = {
    "duration": lambda p, a: a.set_fixed_duration(10**19),
    "delay": lambda p, a: p.add_constraint(GE(Plus(a.start, 10**19), 4)),
    "constant": lambda p, a: p.add_constraint(GE(a.start, 10**19)),
    "variable": lambda p, a: p.add_variable("x", IntType(0, 10**20)),
    "effect": lambda p, a: a.add_effect(
        a.end + 10**19, p.add_fluent("done", default_initial_value=False), True
    ),
    "resource": lambda p, a: a.uses(p.add_resource("r", 10**19), 10**18),
}


@pytest.mark.parametrize("kind", HUGE)
def test_numbers_that_cannot_be_counted_are_refused(kind):
    problem = SchedulingProblem("huge")
    HUGE[kind](problem, problem.add_activity("a", duration=2))
    result = solve(problem)
    assert result.status is Status.UNSUPPORTED_PROBLEM
    assert "cpsat counts to" in result.log_messages[-1].message


def test_no_end_of_a_duration_may_be_a_large_number():
    problem = SchedulingProblem("open")
    problem.add_activity("a").set_duration_bounds(1, sys.maxsize)
    problem.add_quality_metric(MinimizeMakespan())
    result = solve(problem)
    assert (result.status, makespan(result)) == (Status.SOLVED_OPTIMALLY, 1)
