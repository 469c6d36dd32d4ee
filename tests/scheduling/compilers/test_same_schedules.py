"""A compiled problem has the schedules of the original: each pass of every kind of engine, on tiny
problems of odd things. Our own engine says what schedules there are, and brute force.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
from unified_planning.model import Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    FALSE,
    LE,
    BoolType,
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    IntType,
    MinimizeMakespan,
    Not,
    Plus,
)

from tests.oracles.brute_force_schedule import solve as brute_force
from tests.scheduling.odd_problems import HORIZON, odd_problem, ways
from tests.usual import usually
from up_samp.model import Deadline, ScheduleStatus, UnsupportedError
from up_samp.scheduling import known_engines
from up_samp.scheduling.adapters import open_scheduler
from up_samp.scheduling.compilers.plain import end, integer, negation, start
from up_samp.scheduling.compilers.translate import ProblemWriter, read_plain
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.engine_scheduler import chain, compilers_for, restored
from up_samp.scheduling.partial_order.differences import constant
from up_samp.scheduling.quirks import _ARIES, _CPSE, Quirks
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule

KINDS = {
    "aries": _ARIES,
    "cpse": _CPSE,
    "knows all": Quirks(optional=True, assignments=True),
    "no optional": Quirks(optional=False, assignments=True, times_of_others=False),
    "counts wrongly": replace(_CPSE, assignments=True, resources_with_variable_durations=False),
}
FOUND = (307, 555, 1128, 2061, 2228)
"""Drawn problems that had other schedules when they were compiled, or were written wrongly."""


def solved(plain):
    """Return a schedule of a plain problem, and whether it is certain that there is none."""
    writer = ProblemWriter(plain)
    report = CpsatSession(writer.up, workers=1, plain=True).solve(Deadline.after(20))
    found = None if report.schedule is None else writer.read_back(report.schedule)
    return found, report.status is ScheduleStatus.INFEASIBLE


def fixed(original, compiled, times, values):
    """Return a compiled problem with all decisions made."""
    made = []
    for name, span in times.items():
        if name in original.optional_names:
            told = compiled.presence.get(name)
            here = ("pres", name) if told is None else ("par", told)
            made.append(negation(here) if span is None else here)
        for point, time in zip((start(name), end(name)), span or (), strict=bool(span)):
            made.append(("eq", point, integer(time)))
    for name, value in values.items():
        if name in compiled.problem.parameter_types:
            same = "iff" if isinstance(value, bool) else "eq"
            made.append((same, ("par", name), constant(value)))
    return compiled.problem.saying(made)


def wrong(problem, quirks, seed=0):
    """Return what is wrong with a compiled problem (None: nothing is, or it is refused)."""
    try:
        original = read_plain(problem)
        compiled = chain(original, compilers_for(quirks))
        schedule, none = solved(compiled.problem)
    except UnsupportedError:
        return None
    best = brute_force(problem, HORIZON)
    if best is not None and none and compiled.exact:
        return f"no schedule, yet there is {best}"
    if schedule is not None:
        back = restored(original, compiled, schedule)
        verdict = validate_schedule(problem, build_schedule(problem, back))
        if not verdict.valid:
            return f"{back}: {verdict.violations}"
        least = max(best.makespan, compiled.floor) if best and compiled.exact else back.makespan
        if compiled.problem.minimize_makespan and back.makespan > least:
            return f"{back}, yet there is {best}"
    return _wrong_choice(problem, original, compiled, seed)


def _wrong_choice(problem, original, compiled, seed):
    """Return a choice that is a schedule of the one problem and not of the other."""
    drawn = list(ways(problem, seed))
    some = [itertools.islice((d for d in drawn if d[2] is valid), 3) for valid in (True, False)]
    for times, values, valid in itertools.chain(*some):
        there, none = solved(fixed(original, compiled, times, values))
        if (there is not None and not valid) or (none and valid and compiled.exact):
            return f"{times} {values} is {'' if valid else 'no '}schedule"
    return None


def all_wrong(seeds):
    return {
        (seed, kind): why
        for seed, kind in itertools.product(seeds, KINDS)
        if (why := wrong(odd_problem(seed), KINDS[kind], seed)) is not None
    }


@pytest.mark.parametrize(
    "seeds", usually((*range(30), *FOUND), of=[(*range(30), *FOUND), range(1000, 1800)])
)
def test_compiled_problems_have_the_same_schedules(seeds):
    assert all_wrong(seeds) == {}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("wanted", [True, False])
@pytest.mark.parametrize("switch", ["variable", "static", "never"])
def test_effects_that_do_not_happen_still_come_before_the_plans_end(kind, wanted, switch):
    """In conditions the plan's end comes after all effects, as the validator has it."""
    problem = SchedulingProblem(f"{switch} {wanted}")
    lit, other = (problem.add_fluent(n, BoolType(), default_initial_value=False) for n in "lo")
    work = problem.add_activity("work", 1)
    work.add_effect(work.end, lit, True)
    problem.add_constraint(LE(work.end, 1))
    if switch == "variable":
        told = problem.add_variable("on", BoolType())
        problem.add_constraint(Not(told))
    else:
        never = problem.add_fluent("never", BoolType(), default_initial_value=False)
        told = never() if switch == "static" else FALSE()
    problem.add_effect(GlobalStartTiming(4), other, True, told)
    before = Timing(-2, GlobalEndTiming().timepoint)
    problem.add_condition(ClosedTimeInterval(before, before), lit() if wanted else Not(lit))
    assert (brute_force(problem, HORIZON) is not None) is wanted
    assert wrong(problem, KINDS[kind]) is None


@pytest.mark.parametrize("kind", KINDS)
def test_sums_of_one_time_are_written(kind):
    problem = SchedulingProblem("twice")
    one, two = (problem.add_activity(name, 2) for name in "ab")
    problem.add_constraint(LE(Plus(one.end, one.end), Plus(two.start, 2)))
    original = read_plain(problem)
    schedule, _ = solved(chain(original, compilers_for(KINDS[kind])).problem)
    assert validate_schedule(problem, build_schedule(problem, schedule)).valid


# -- what engines make of it ---------------------------------------------------------------------
ENGINES = tuple(name for name, _, _ in known_engines())
DISPROVEN = (274, 367, 623, 726, 1020, 1086)
"""Drawn problems with a number that has no least value, which cpse called unsolvable."""


def check(problem, schedule):
    return [str(v) for v in validate_schedule(problem, schedule).violations]


def disproven(engine, seeds):
    """Return what an engine claims of drawn problems, and is not so."""
    found = {}
    with open_scheduler(engine, odd_problem(0), check=check) as scheduler:
        for seed in seeds:
            scheduler._problem = problem = odd_problem(seed)
            try:
                report = scheduler.solve(Deadline.after(20))
            except UnsupportedError:
                continue
            best = brute_force(problem, HORIZON)
            least = None if report.schedule is None else report.schedule.makespan
            later = best is not None and least is not None and least > best.makespan
            none = best is not None and report.status is ScheduleStatus.INFEASIBLE
            early = best is None and least is not None and least <= HORIZON
            if none or early or (later and report.status is ScheduleStatus.OPTIMAL):
                found[seed] = report
    return found


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "seeds", usually((*range(20), *DISPROVEN), of=[(*range(20), *DISPROVEN), range(3000, 5000)])
)
def test_engines_prove_nothing_that_is_not_so(engine, seeds):
    assert disproven(engine, seeds) == {}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("ends", [(None, 5), (None, None), (-9, None), (-9, 5)])
def test_numbers_without_ends_are_taken(engine, ends):
    problem = SchedulingProblem("no ends")
    level = problem.add_fluent("level", IntType(*ends), default_initial_value=0)
    work = problem.add_activity("work", 2)
    number, shared = (
        work.add_parameter("number", IntType(*ends)),
        problem.add_variable("shared", IntType(*ends)),
    )
    problem.add_constraint(LE(number, -3))
    problem.add_constraint(LE(shared, number))
    work.add_decrease_effect(work.start, level, 4)
    problem.add_quality_metric(MinimizeMakespan())
    with open_scheduler(engine, problem, check=check) as scheduler:
        report = scheduler.solve(Deadline.after(20))
    assert report.schedule is not None, report
    assert report.schedule.makespan == 2
