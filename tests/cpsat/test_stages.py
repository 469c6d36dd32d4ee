"""The order of a solve, as data, and models that are whole when they are made."""

import threading

import pytest

from cpsat.random_problems import random_problem
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import FAMILIES, OutOfTimeError, ScheduleModel
from up_samp.scheduling.cpsat.problem import Watcher
from up_samp.scheduling.cpsat.solve.attempts import Attempts, Orders
from up_samp.scheduling.cpsat.solve.runner import SolverRun
from up_samp.scheduling.cpsat.solve.strategy import STAGES, Solve, solve
from up_samp.scheduling.cpsat.tuning import StagesTuning


def solved(problem, *, guess=None, optimal=True, **tuning):
    orders = Orders(SolverRun(0, 1), optimal, StagesTuning(**tuning), threading.Event())
    whole = Attempts(ScheduleModel(problem), orders, Deadline.after(60), 0)
    search = Solve(whole, Watcher(problem).look, guess)
    solve(search)
    return search


def shop():
    from tests.scheduling.test_tours import RandomShop

    return next(p for p in (RandomShop(s).problem for s in range(50)) if solved(p).routes)


def test_stages_run_in_their_order_and_only_where_they_apply():
    names = [s.name for s in STAGES]
    assert len(set(names)) == len(names)
    first = solved(shop())
    assert first.whole.proven
    assert "look for routes" in first.done
    assert "make the given schedule fit" not in first.done
    places = [names.index(n) for n in first.done]
    assert places == sorted(set(places))
    again = solved(shop(), guess=first.whole.best)
    assert again.done[0] == "make the given schedule fit"
    assert again.whole.value == first.whole.value


def test_a_problem_without_routes_is_not_relaxed():
    found = solved(random_problem(3))
    assert not found.routes
    assert not {"bound by work", "anneal tours", "solve the routing relaxation"} & {*found.done}


def test_tuning_changes_the_way_and_not_the_answer():
    plain = solved(shop())
    other = solved(shop(), tour_rounds=0, few_tasks=0, tiny=0, small=0, realize_caps=(2.0,))
    assert other.whole.proven
    assert other.whole.value == plain.whole.value


def test_a_model_is_whole_or_there_is_none():
    problem = random_problem(5)
    with pytest.raises(OutOfTimeError):
        ScheduleModel(problem, deadline=Deadline.after(0))
    model = ScheduleModel(problem)
    assert model.limit > 0
    assert len(FAMILIES) == len({name for name, _ in FAMILIES})
    report = CpsatSession(problem, workers=1).solve(Deadline.after(0))
    assert report.status is ScheduleStatus.OUT_OF_TIME
