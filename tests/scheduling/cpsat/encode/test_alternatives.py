"""Alternatives share their times; nothing is lost or let through by that."""

import itertools
import random

import pytest
from unified_planning.model import TimePointInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    LT,
    Equals,
    MinimizeMakespan,
    Not,
    Or,
    Plus,
    UserType,
)

from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession, model
from up_samp.scheduling.cpsat.encode.disjunctions import find_groups, merge_forms
from up_samp.scheduling.cpsat.encode.forms import Cmp
from up_samp.scheduling.cpsat.normal import Watcher, normal_form
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule


def exactly_one(problem, activities):
    problem.add_constraint(Or([a.present for a in activities]))
    for a, b in itertools.combinations(activities, 2):
        problem.add_constraint(Or(Not(a.present), Not(b.present)))


def random_shop(seed):
    """Tasks with one alternative a worker; workers and machines do one thing at a time; some
    differences are said of some alternatives only.
    """
    rng = random.Random(seed)
    problem = SchedulingProblem(f"shop{seed}")
    workers, tasks = rng.randint(1, 3), rng.randint(2, 5)
    ways = []
    for t in range(tasks):
        duration = rng.randint(0, 3)
        ways.append(
            [
                problem.add_activity(f"t{t}_w{w}", duration=duration, optional=True)
                for w in range(workers)
            ]
        )
        exactly_one(problem, ways[-1])
    for some, others in itertools.combinations(ways, 2):
        kind = rng.choice(["order", "apart", "nothing", "window"])
        for a, b in itertools.product(some, others):
            scope = [a.present, b.present]
            if kind == "order":
                problem.add_constraint(LT(a.end, b.start), scope)
            elif kind == "apart":
                problem.add_constraint(Or(LT(a.end, b.start), LT(b.end, a.start)), scope)
            elif kind == "window" and rng.random() < 0.7:
                problem.add_constraint(
                    Or(LE(Plus(a.start, rng.randint(0, 3)), b.start), LE(b.end, a.start)), scope
                )
    for w in range(workers):
        for a, b in itertools.combinations([way[w] for way in ways], 2):
            problem.add_constraint(
                Or(LT(a.end, b.start), LT(b.end, a.start)), [a.present, b.present]
            )
    for way in ways:
        if rng.random() < 0.3:
            problem.add_constraint(LE(rng.randint(0, 6), rng.choice(way).start))
        if rng.random() < 0.2:
            problem.add_constraint(LE(rng.choice(way).end, rng.randint(2, 12)))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def switch_problem(openers=2):
    """Whoever opens the door needs it closed; walks through need it open."""
    problem = SchedulingProblem("switch")
    state = UserType("state")
    closed, opened = (problem.add_object(n, state) for n in ("closed", "opened"))
    door = problem.add_fluent("door", state, default_initial_value=closed)
    opens = []
    for i in range(openers):
        a = problem.add_activity(f"open{i}", duration=1, optional=True)
        a.add_condition(TimePointInterval(Timing(0, a.start)), Equals(door, closed))
        a.add_effect(a.end, door, opened)
        opens.append(a)
    walk = problem.add_activity("walk", duration=2)
    walk.add_condition(TimePointInterval(Timing(0, walk.start)), Equals(door, opened))
    problem.add_quality_metric(MinimizeMakespan())
    return problem, opens, closed


@pytest.mark.parametrize("block", range(4))
def test_sharing_times_changes_no_optimum(block, monkeypatch):
    for seed in range(block * 15, block * 15 + 15):
        problem = random_shop(seed)
        shared = CpsatSession(problem, workers=1).solve(Deadline.after(30))
        with monkeypatch.context() as patch:
            patch.setattr(model, "find_groups", lambda *_: [])
            plain = CpsatSession(problem, workers=1).solve(Deadline.after(30))
        assert shared.status is plain.status, seed
        if shared.status is ScheduleStatus.OPTIMAL:
            assert shared.bound == plain.bound, seed
            plan = build_schedule(problem, shared.schedule)
            assert not validate_schedule(problem, plan).violations


def test_groups_are_found_where_they_are_written():
    problem = random_shop(5)
    found = find_groups(normal_form(Watcher(problem).look()))
    tasks = {a.name.split("_")[0] for a in problem.activities}
    many = len(problem.activities) > len(tasks)
    assert {g[0].split("_")[0] for g in found} == (tasks if many else set())


def test_a_switch_that_is_never_set_back_is_set_once():
    problem, opens, _ = switch_problem()
    report = CpsatSession(problem, workers=1).solve(Deadline.after(30))
    assert report.schedule.makespan == 4
    assert sum(a.name in report.schedule.times for a in opens) == 1


def test_a_switch_that_may_be_set_back_is_no_group():
    problem, _, closed = switch_problem()
    door = problem.fluent("door")
    close = problem.add_activity("close", duration=1, optional=True)
    close.add_effect(close.end, door, closed)
    assert find_groups(normal_form(Watcher(problem).look())) == []


def test_forms_of_whole_products_are_said_once():
    a, b = (3, 4), (6, 7)
    groups = {m: g for g in (a, b) for m in g}
    forms = [
        ("|", *(~x for x in sorted((p, q))), Cmp(((10, 1), (11, -1)), 2, "<=", (p, q)))
        for p in a
        for q in b
    ]
    assert merge_forms(forms, groups) == [Cmp(((10, 1), (11, -1)), 2, "<=", ())]
    assert merge_forms(forms[1:], groups) == forms[1:]
