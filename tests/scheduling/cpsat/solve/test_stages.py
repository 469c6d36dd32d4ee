"""The order of a solve, as data, and models that are whole when they are made."""

import threading

import pytest
from ortools.sat.python import cp_model

from tests.scheduling.cpsat.random_problems import random_problem
from tests.scheduling.cpsat.sites import shop as small_shop
from tests.scheduling.cpsat.styles import Style
from tests.scheduling.cpsat.writer import write
from up_samp.model import Deadline, OutOfTimeError, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession, model, normal
from up_samp.scheduling.cpsat.encode import timeline
from up_samp.scheduling.cpsat.model import FAMILIES, ScheduleModel
from up_samp.scheduling.cpsat.solve.attempts import Attempts, Orders
from up_samp.scheduling.cpsat.solve.runner import run
from up_samp.scheduling.cpsat.solve.strategy import STAGES, Solve, solve
from up_samp.tuning import Tuning


def solved(problem, *, guess=None, optimal=True, **tuning):
    orders = Orders(0, 1, optimal, Tuning(**tuning), threading.Event())
    whole = Attempts(ScheduleModel(problem), orders, Deadline.after(60), 0)
    search = Solve(whole, guess)
    solve(search)
    return search


def shop():
    from tests.scheduling.cpsat.routing.test_tours import RandomShop

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


def test_a_problem_without_routes_has_no_tours():
    found = solved(random_problem(3))
    assert not found.routes
    assert not {"bound by work", "anneal tours"} & {*found.done}


def test_tuning_changes_the_way_and_not_the_answer():
    plain = solved(shop())
    other = solved(shop(), tour_rounds=0, tiny=0)
    assert other.whole.proven
    assert other.whole.value == plain.whole.value


@pytest.mark.parametrize("looks", [1, 2, 5, 20, 60, 200])
def test_a_model_that_grows_while_the_time_ends_is_not_used_any_more(monkeypatch, looks):
    """Wherever the time ends, the next answer is that of a whole model."""
    problem = write(small_shop(1, 2, 2), Style())
    session = CpsatSession(problem, workers=1)
    best = session.solve(Deadline.after(60)).schedule.makespan
    for activity in problem.activities:
        late = problem.environment.expression_manager.LE(7, activity.start)
        problem.add_constraint(late, [activity.present] if activity.optional else [])
    left = iter(range(looks))

    def look(grace=0.0):
        if next(left, None) is None:
            raise OutOfTimeError("no time is left")

    with monkeypatch.context() as patched:
        for module in (model, normal, timeline):
            patched.setattr(module, "check_time", look)
        session.solve(Deadline.after(60))
    report = session.solve(Deadline.after(60))
    assert report.status is ScheduleStatus.OPTIMAL
    assert report.schedule.makespan == report.bound == best + 7


def test_a_model_is_whole_or_there_is_none():
    problem = random_problem(5)
    with pytest.raises(OutOfTimeError):
        ScheduleModel(problem, deadline=Deadline.after(0))
    whole = ScheduleModel(problem)
    assert whole.limit > 0
    assert len(FAMILIES) == len({name for name, _ in FAMILIES})
    report = CpsatSession(problem, workers=1).solve(Deadline.after(0))
    assert report.status is ScheduleStatus.OUT_OF_TIME


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("workers", [2, 4])
def test_the_searches_that_break_memory_are_never_run(workers, first, capfd):
    jobs, machines = 5, 4
    plain = cp_model.CpModel()
    ends, on = [], {m: [] for m in range(machines)}
    for j in range(jobs):
        for m in range(machines):
            size = 1 + (3 * j + 5 * m + j * m) % 7
            start = plain.new_int_var(0, 200, "")
            on[(m + j) % machines].append(plain.new_fixed_size_interval_var(start, size, ""))
            ends.append(start + size)
    for intervals in on.values():
        plain.add_no_overlap(intervals)
    makespan = plain.new_int_var(0, 200, "")
    plain.add_max_equality(makespan, ends)
    plain.minimize(makespan)
    options = {"log_search_progress": True, "stop_after_first_solution": first}
    options |= {"num_workers": workers, "random_seed": 0}
    answer = run(plain, Deadline.after(30), lambda *_: None, options=options)
    assert answer.status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    lines = capfd.readouterr().out.splitlines()
    told = [line for line in lines if "subsolver" in line and "[" in line]
    assert told
    running = [line for line in told if "ignored" not in line]
    names = {n.strip("[],") for line in running for n in line.split(": ", 1)[1].split(", ")}
    assert names
    assert not {n for n in names if n.startswith(("ls", "fj"))}, told
