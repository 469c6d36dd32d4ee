"""Large-neighbourhood search: what is kept stays, what is freed gets better, nothing is proven."""

import gc
import logging
import os
import random
import weakref
from concurrent.futures import (
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context

import pytest

from tests.oracles.fresh import fresh_environment
from tests.oracles.odd_executors import Backwards, Killing
from up_samp.benchmarks.instances import instance
from up_samp.model import CandidateSchedule, Deadline, ScheduleReport, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.attempt import try_candidate
from up_samp.search.neighbourhoods import CHOICES, Descent, DescentSettings, Freed, Roulette
from up_samp.search.neighbourhoods.choices import (
    View,
    last_robots,
    owners_of,
    random_robots,
    time_window,
)
from up_samp.search.neighbourhoods.descent import small_problem
from up_samp.search.params import Parameters
from up_samp.search.session import Wrapped, open_search
from up_samp.system.workers import Workers
from up_samp.upio.restrict import restrict
from up_samp.validation import validate_plan

NAME = "logistics-do-oc-r3-i3"


def search_of(name=NAME, encoding="lean", seed=0):
    """A search that knows bounds on motions, and has no plan."""
    with fresh_environment():
        problem = instance(name).build(encoding, True)
    judge = partial(refused, problem)
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], judge, native=True)
    search = open_search(problem, wrapped, Parameters(seed=seed), Deadline.after(300.0))
    search.learn(search.components.statements[0].find(search))
    return search


def refused(problem, plan):
    assert validate_plan(problem, plan).valid
    return []


def poor_plan(search):
    """A plan in which robot 0 does all that can be done by several."""
    relaxation = search.knowledge.relaxation
    problem = relaxation.problem.clone()
    manager = problem.environment.expression_manager
    of = owners_of(relaxation).of
    first = min(robot for own in of.values() for robot in own)
    for activity in problem.activities:
        if of[activity.name] and first not in of[activity.name]:
            problem.add_constraint(manager.Not(activity.present))
    report = CpsatSession(problem, workers=1).solve(Deadline.after(100.0), optimal=False)
    tried = try_candidate(search, ScheduleReport(ScheduleStatus.FOUND, report.schedule))
    assert tried.better is not None
    return tried.better


@pytest.fixture(scope="module")
def begun():
    search = search_of()
    return search, poor_plan(search)


def view_of(search, plan):
    relaxation = search.own_relaxation()
    return View(relaxation, search.facts.snapshot, owners_of(relaxation), plan)


@pytest.mark.parametrize("encoding", ["lean", "fluents"])
def test_everything_belongs_to_its_robot(encoding):
    relaxation = search_of(encoding=encoding).knowledge.relaxation
    owners = owners_of(relaxation)
    assert len(owners.robots) == 3
    for robot in owners.robots:
        mine = [n for n, own in owners.of.items() if own == {robot}]
        assert len(mine) == len(owners.of) / 3
    picks = [n for n in owners.of if n.startswith("pick")]
    assert all(owners.rivals[n] for n in picks)
    # who keeps its item leaves nothing to do there for others
    first, other = owners.robots[:2]
    kept = min(n for n in picks if owners.of[n] == {first})
    place = min(owners.places[kept])
    more = owners.open_to({other}, {kept})
    assert not owners.rivals[kept] & more
    assert not any(place in owners.ways.get(n, ()) for n in more)
    assert owners.open_to({other}, ()) > more


def test_a_part_of_a_plan_is_a_part_of_the_problem(begun):
    """Whatever is freed: a schedule of what is left is one of the whole, and what is kept stays."""
    search, plan = begun
    view, chance = view_of(search, plan), random.Random(3)
    for choice in CHOICES:
        freed = choice(view, chance, 2)
        assert freed.robots <= set(view.robots)
        assert 1 <= len(freed.robots) <= 4
        small = small_problem(view, freed)
        session = CpsatSession(small.problem, workers=1, effort=0.1)
        report = session.solve(Deadline.after(60.0), hint=plan.schedule)
        assert report.schedule is not None, choice.__name__
        assert small.kept <= report.schedule.times.keys()
        assert report.schedule.times.keys() <= small.kept | small.open
        assert report.schedule.makespan <= plan.schedule.makespan
        exact = restrict(view.relaxation, view.snapshot, report.schedule)
        manager = exact.environment.expression_manager
        for activity in exact.activities:
            start, end = report.schedule.times[activity.name]
            exact.add_constraint(manager.Equals(activity.start, start))
            exact.add_constraint(manager.Equals(activity.end, end))
        again = CpsatSession(exact, workers=1).solve(Deadline.after(60.0), optimal=False)
        assert again.status is not ScheduleStatus.INFEASIBLE, choice.__name__
        assert again.schedule is not None


def test_who_is_not_freed_keeps_its_order(begun):
    search, plan = begun
    view = view_of(search, plan)
    busy = [r for r in view.robots if view.last_ends[r] > 0]
    assert len(busy) == 1
    small = small_problem(view, Freed(frozenset(view.robots) - set(busy)))
    assert small.kept == plan.schedule.times.keys()
    report = CpsatSession(small.problem, workers=1).solve(Deadline.after(60.0))
    order = sorted(small.kept, key=lambda n: (plan.schedule.times[n], n))
    starts = [report.schedule.times[n][0] for n in order]
    assert starts == sorted(starts)


def test_a_window_keeps_what_is_before_and_after_it(begun):
    search, plan = begun
    view = view_of(search, plan)
    makespan = plan.schedule.makespan
    freed = Freed(frozenset(view.robots), makespan // 3, makespan // 2)
    small = small_problem(view, freed)
    for name, (start, end) in plan.schedule.times.items():
        outside = end < freed.since or start > freed.until
        assert (name in small.kept) == outside


def test_random_numbers_decide(begun):
    view = view_of(*begun)
    for choice in CHOICES:
        one, two = (choice(view, random.Random(5), 2) for _ in range(2))
        assert one == two
    drawn = {random_robots(view, random.Random(k), 1) for k in range(20)}
    assert len(drawn) == 3
    window = time_window(view, random.Random(1), 2)
    assert window.since < window.until < 2 * view.plan.schedule.makespan


def test_those_who_are_done_late_get_help(begun):
    view = view_of(*begun)
    late = max(view.robots, key=lambda r: view.last_ends[r])
    for k in range(10):
        freed = last_robots(view, random.Random(k), 2)
        assert late in freed.robots
        assert len(freed.robots) == 2


def test_the_end_of_a_plan_hangs_on_its_critical_path(begun):
    view = view_of(*begun)
    times = view.times
    assert times[view.critical[0]][1] == view.plan.schedule.makespan
    assert times[view.critical[-1]][0] <= 1
    assert set(view.critical) <= times.keys()


def test_what_brings_more_is_drawn_more():
    tuning = DescentSettings(robots=2, growth=0.5)
    roulette = Roulette(CHOICES, tuning, random.Random(0), most=4)
    for _ in range(30):
        roulette.learn(0, 1.0)
        roulette.learn(1, 0.0)
    assert roulette.weights[0] == pytest.approx(1.0)
    assert roulette.weights[1] == pytest.approx(tuning.least_weight)
    drawn = [roulette.draw() for _ in range(500)]
    assert drawn.count(0) > 3 * drawn.count(1) > 0
    assert roulette.robots == 2
    for _ in range(10):
        roulette.searched(wholly=True)
    assert roulette.robots == 4
    for _ in range(10):
        roulette.searched(wholly=False)
    assert roulette.robots == 1


def test_a_plan_gets_better_and_nothing_is_proven():
    search = search_of()
    plan = poor_plan(search)
    search.bounds.lower = 7
    descent = Descent(DescentSettings(stale=6, effort=0.05))
    found = [better.schedule.makespan for better in descent(search, True)]
    assert found
    assert found == sorted(set(found), reverse=True)
    assert found[0] < plan.schedule.makespan
    assert found[-1] == search.bounds.upper < 0.75 * plan.schedule.makespan
    assert search.bounds.lower == 7
    assert search.history.rounds[-1].lower_bound == 7
    # what a descent knows of a search goes with it
    assert search.remembered
    seen = weakref.ref(search)
    del search
    gc.collect()
    assert seen() is None


def test_one_robot_has_no_neighbours():
    search = search_of("logistics-do-oc-r1-i1")
    poor_plan(search)
    assert list(Descent()(search, True)) == []


def test_what_was_searched_wholly_is_not_searched_again(begun, monkeypatch):
    search, plan = begun
    view = view_of(search, plan)
    whole = Freed(frozenset(view.robots))
    asked = []

    def schedules(self, search, view, some, deadline):
        asked.append(some)
        found = ScheduleReport(ScheduleStatus.OPTIMAL, CandidateSchedule(dict(view.times)))
        return iter([found] * len(some))

    monkeypatch.setattr(Descent, "_schedules", schedules)
    tuning = DescentSettings(stale=12, together=1)
    assert list(Descent(tuning, choices=[lambda *_: whole])(search, True)) == []
    assert asked[0] == [whole]
    assert not any(asked[1:])
    part = Freed(frozenset(view.robots[:1]), 3, 9)
    assert part.within(whole)
    assert not whole.within(part)


def test_the_whole_is_tried_first_where_that_may_help(begun):
    search, _ = begun
    count = sum(a.optional for a in search.knowledge.relaxation.problem.activities)
    assert list(Descent(DescentSettings(activities=count + 1, stale=1))(search, False)) == []
    asked = []

    def choice(view, chance, size):
        asked.append(size)
        return Freed(frozenset())

    descent = Descent(DescentSettings(activities=count, stale=1, together=1), choices=[choice])
    list(descent(search, False))
    assert len(asked) == 1
    list(descent(search, False))  # once only
    assert len(asked) == 1
    list(descent(search, True))
    assert len(asked) == 2


def test_workers_change_nothing(begun, monkeypatch, caplog):
    """Small problems are solved alike, whoever solves them, and in the order asked."""
    search, plan = begun
    view, chance = view_of(search, plan), random.Random(1)
    some = [choice(view, chance, 2) for choice in CHOICES[:4]]
    descent = Descent(DescentSettings(effort=0.1))
    deadline = Deadline.after(100.0)
    alone = list(descent._schedules(search, view, some, deadline))
    assert len({r.schedule.makespan for r in alone}) > 1
    workers = Workers(Backwards(lost={1, 3}))
    monkeypatch.setattr(search, "workers", workers)
    found = list(descent._schedules(search, view, some, deadline))
    assert [r.status for r in found] == [r.status for r in alone]
    assert [r.schedule for r in found] == [r.schedule for r in alone]
    assert all(r.bound is None for r in (*found, *alone))
    assert (workers.executor.handed, workers.lost) == (4, 2)
    told = [r for r in caplog.records if r.levelno >= logging.WARNING]
    assert len(told) == 1
    assert "a worker is lost" in told[0].getMessage()


def test_what_cannot_be_sent_is_solved_here(begun, monkeypatch, caplog):
    search, plan = begun
    view, chance = view_of(search, plan), random.Random(1)
    some = [choice(view, chance, 2) for choice in CHOICES[:2]]
    descent = Descent(DescentSettings(effort=0.1))
    environment = view.relaxation.problem.environment
    monkeypatch.setattr(environment, "law", lambda state: state, raising=False)
    workers = Workers(Backwards())
    monkeypatch.setattr(search, "workers", workers)
    found = list(descent._schedules(search, view, some, Deadline.after(100.0)))
    assert len(found) == 2
    assert workers.executor.handed == 0
    assert "cannot be sent to workers" in caplog.text


@contextmanager
def executor_of(kind):
    """Workers of some kind, one of which is killed on the way (threads cannot be)."""
    if kind == "threads":
        with ThreadPoolExecutor(2) as pool:
            yield pool
    elif kind == "processes":
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
            yield Killing(pool, pool.submit(os.getpid).result())
    else:
        distributed = pytest.importorskip("distributed")
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            victim = next(iter(client.run(os.getpid).values()))
            yield Killing(client.get_executor(), victim)
            assert victim not in client.run(os.getpid).values()


@pytest.fixture(scope="module")
def steps_alone():
    found, _ = steps_of(None)
    assert found
    return found


@pytest.mark.long
@pytest.mark.parametrize("kind", ["threads", "processes", "dask"])
def test_the_same_plans_with_workers(kind, steps_alone):
    """Plan after plan is the same with workers, one of which is killed on the way."""
    with executor_of(kind) as executor:
        found, workers = steps_of(executor)
    assert found == steps_alone
    assert (workers.lost > 0) == (kind == "processes")  # Dask hands on what is lost


def steps_of(executor):
    """The schedules that a descent goes through."""
    search = search_of("logistics-do-oc-r2-i3")
    poor_plan(search)
    search.workers = None if executor is None else Workers(executor)
    descent = Descent(DescentSettings(stale=4, effort=0.02))
    return [better.schedule for better in descent(search, True)], search.workers
