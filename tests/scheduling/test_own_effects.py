"""Effects at start + k and end - k inside conditions, their own activity's and others', against
brute force: engines with one supporter for a condition used to call such problems unsolvable.
"""

from __future__ import annotations

import random

import pytest
from oracles.brute_force_schedule import solve as brute_force
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    BoolType,
    ClosedTimeInterval,
    Equals,
    GlobalEndTiming,
    GlobalStartTiming,
    LeftOpenTimeInterval,
    MinimizeMakespan,
    Not,
    OpenTimeInterval,
    Or,
    RightOpenTimeInterval,
    Timing,
    UserType,
)

from up_samp.model import Deadline, ScheduleStatus, UnsupportedError
from up_samp.scheduling import known_engines
from up_samp.scheduling.adapters import open_scheduler
from up_samp.scheduling.compilers.pipeline import chain, compilers_for
from up_samp.scheduling.compilers.read import read_problem
from up_samp.validation import validate_schedule

HORIZON = 6
ENGINES = tuple(name for name, _, _ in known_engines())
INTERVALS = [ClosedTimeInterval, OpenTimeInterval, LeftOpenTimeInterval, RightOpenTimeInterval]


class _Drawn:
    """One or two activities of 1 to 5 units on a place and a flag, listed in any order."""

    def __init__(self, seed):
        self.r = random.Random(seed)
        self.problem = SchedulingProblem(f"own-effects-{seed}")
        place, r = UserType("place"), self.r
        names = [f"o{i}" for i in range(r.choice((2, 3)))]
        r.shuffle(names)
        self.places = [self.problem.add_object(name, place) for name in names]
        start = r.choice(self.places)
        self.at = self.problem.add_fluent("at", place, default_initial_value=start)
        self.flag = self.problem.add_fluent(
            "flag", BoolType(), default_initial_value=r.random() < 0.7
        )
        wanted = [f"a{i}" for i in range(r.choice((1, 2, 2)))]
        r.shuffle(wanted)
        for name in wanted:
            activity = self.problem.add_activity(name, optional=r.random() < 0.25)
            least = r.choice((1, 2, 3))
            activity.set_duration_bounds(least, least + r.choice((0, 0, 0, 1, 2)))
            if activity.optional and r.random() < 0.8:
                self.problem.add_constraint(activity.present)
        for activity in r.sample(self.problem.activities, len(wanted)):
            self.inside(activity)
        self.beside()
        self.problem.add_quality_metric(MinimizeMakespan())

    def inside(self, a):
        r, spans = self.r, [(Timing(0, a.start), Timing(0, a.end))] * 2
        taken = set()
        for _ in range(r.choice((1, 1, 2))):
            time, (fluent, value) = self.timing(a), self.value()
            if (str(time), fluent) not in taken:
                taken.add((str(time), fluent))
                a.add_effect(time, fluent, value)
        for _ in range(r.choice((1, 1, 2))):
            own = Timing(r.choice((0, 1)), a.start), Timing(-r.choice((0, 1)), a.end)
            span = r.choice([*spans, (self.timing(a), self.timing(a)), own])
            a.add_condition(r.choice(INTERVALS)(*span), self.condition())

    def beside(self):
        if self.r.random() < 0.3:
            self.problem.add_effect(GlobalStartTiming(self.r.choice((1, 2, 3))), *self.value())
        if self.r.random() < 0.2:
            span = ClosedTimeInterval(GlobalStartTiming(self.r.choice((0, 1))), GlobalEndTiming())
            self.problem.add_condition(span, self.condition())

    def timing(self, a):
        point, delay = self.r.choice((a.start, a.end)), self.r.choice((0, 0, 1, 2))
        return Timing(delay if point is a.start else -delay, point)

    def value(self):
        if self.r.random() < 0.5:
            return self.flag, self.r.random() < 0.75
        return self.at, self.r.choice(self.places)

    def condition(self):
        here = Equals(self.at, self.r.choice(self.places))
        either = [self.flag(), here]
        self.r.shuffle(either)
        return self.r.choice(
            [self.flag(), self.flag(), here, Not(here), Or(either), Not(self.flag)]
        )


def drawn(seed):
    return _Drawn(seed).problem


def check(problem, schedule):
    return [str(v) for v in validate_schedule(problem, schedule).violations]


def end_inside(delay):
    """A gate that is to stay open while its keeper works, who says so once more at end - delay;
    a walker passes after that."""
    problem = SchedulingProblem("gate")
    gate = problem.add_fluent("open", BoolType(), default_initial_value=True)
    keep, walk = problem.add_activity("keep", 3), problem.add_activity("walk", 2)
    keep.add_condition(ClosedTimeInterval(Timing(0, keep.start), Timing(0, keep.end)), gate())
    keep.add_effect(Timing(-delay, keep.end), gate, True)
    walk.add_condition(ClosedTimeInterval(Timing(0, walk.start), Timing(0, walk.end)), gate())
    problem.add_quality_metric(MinimizeMakespan())
    return problem


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_an_effect_inside_its_own_condition(engine, delay):
    problem = end_inside(delay)
    with open_scheduler(engine, problem, check=check) as scheduler:
        report = scheduler.solve(Deadline.after(20.0))
    best = brute_force(problem, HORIZON)
    assert report.schedule is not None, (report.status, report.message)
    if engine != "aries":  # which seeks no optimum
        assert report.status is ScheduleStatus.OPTIMAL
        assert report.schedule.makespan == best.makespan


def compare(engine, seeds):
    """Return what is wrong by seed, and how many of the solvable problems were not solved."""
    from up_samp.scheduling.adapters import _engine_class
    from up_samp.scheduling.quirks import quirks_of

    wrong, missed = {}, 0
    with open_scheduler(engine, drawn(0), check=check) as scheduler:
        quirks = quirks_of(_engine_class(engine, drawn(0).environment))
        for seed in seeds:
            problem = drawn(seed)
            scheduler._problem, best = problem, brute_force(problem, HORIZON)
            try:
                report = scheduler.solve(Deadline.after(20.0))
                exact = chain(read_problem(problem), compilers_for(quirks)).exact
            except UnsupportedError:
                missed += best is not None
                continue
            proven = report.status is ScheduleStatus.OPTIMAL
            if report.status is ScheduleStatus.ERROR:
                wrong[seed] = report.message
            elif report.schedule is None and best is not None:
                missed += 1
                if exact or report.status is ScheduleStatus.INFEASIBLE:
                    wrong[seed] = f"{report.status.name}, yet there is {best}"
            elif report.schedule is not None and best is None:
                if report.schedule.makespan <= HORIZON:
                    wrong[seed] = f"a schedule where there is none: {report.schedule}"
            elif proven and best is not None and report.schedule.makespan != best.makespan:
                wrong[seed] = f"{report.schedule} called optimal, yet there is {best}"
    return wrong, missed


@pytest.mark.parametrize("engine", ENGINES)
def test_what_effects_renew_is_not_lost(engine):
    wrong, missed = compare(engine, range(30))
    assert wrong == {}
    assert missed <= 3


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_what_effects_renew_is_not_lost_in_many(engine):
    wrong, missed = compare(engine, range(1000, 2000))
    assert wrong == {}
    assert missed <= 50
