import random
import threading

import pytest
from unified_planning.model import ClosedTimeInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    LT,
    Equals,
    GlobalEndTiming,
    MinimizeMakespan,
    Not,
    Or,
    TimePointInterval,
    UserType,
)

from tests.oracles.clocks import Watch
from up_samp.model import Deadline, ScheduleStatus, UnsupportedError
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule


def line_of(durations, optional=False):
    problem = SchedulingProblem("line")
    activities = [
        problem.add_activity(f"a{i}", d, optional=optional) for i, d in enumerate(durations)
    ]
    problem.add_quality_metric(MinimizeMakespan())
    return problem, activities


def travels(places=3, visits=4):
    """One robot, moves between all places (each once), visits in any order, home at the end."""
    problem = SchedulingProblem("travels")
    place = UserType("spot")
    spots = [problem.add_object(f"s{i}", place) for i in range(places)]
    at = problem.add_fluent("at", place, default_initial_value=spots[0])
    busy = []
    for i, a in enumerate(spots):
        for j, b in enumerate(spots):
            if a is not b:
                m = problem.add_activity(f"m{i}{j}", 3 + abs(i - j), optional=True)
                m.add_condition(
                    ClosedTimeInterval(Timing(0, m.start), Timing(0, m.end)), Equals(at, a)
                )
                m.add_effect(m.end, at, b)
                busy.append(m)
    for v in range(visits):
        w = problem.add_activity(f"v{v}", 2)
        w.add_condition(
            ClosedTimeInterval(Timing(0, w.start), Timing(0, w.end)),
            Equals(at, spots[v % places]),
        )
        busy.append(w)
    for i, a in enumerate(busy):
        for b in busy[:i]:
            scope = [x.present for x in (a, b) if x.optional]
            problem.add_constraint(Or(LT(a.end, b.start), LT(b.end, a.start)), scope=scope)
    problem.add_condition(TimePointInterval(GlobalEndTiming()), Equals(at, spots[0]))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def solve(problem, **options):
    return CpsatSession(problem, workers=1).solve(Deadline.after(60), **options)


def test_routes_are_recognised_and_solved():
    problem = travels()
    session = CpsatSession(problem, workers=1)
    report = session.solve(Deadline.after(60))
    assert report.status is ScheduleStatus.OPTIMAL
    (route,) = find_routes(session._model)
    assert len(route.moves) == 6
    assert len(route.stops) == 4
    # two visits at s0, then s1, s2 and home: 8 for the visits, 4 + 4 + 5 on the way, 6 gaps of 1
    assert report.schedule.makespan == report.bound == 27
    assert validate_schedule(problem, build_schedule(problem, report.schedule)).valid


def test_appending_keeps_model_and_bound():
    problem, (a, b, c) = line_of([2, 3, 4])
    session = CpsatSession(problem, workers=1)
    assert session.solve(Deadline.after(20)).bound == 4
    problem.add_constraint(LE(a.end, b.start))
    assert session.solve(Deadline.after(20)).schedule.makespan == 5
    problem.add_constraint(LE(b.end, c.start))
    report = session.solve(Deadline.after(20))
    assert (report.status, report.bound, session.rebuilds) == (ScheduleStatus.OPTIMAL, 9, 1)


def test_taking_back_makes_a_new_model():
    problem, (a, b) = line_of([2, 3])
    problem.add_constraint(LE(a.end, b.start))
    session = CpsatSession(problem, workers=1)
    assert session.solve(Deadline.after(20)).bound == 5
    problem._base._constraints.clear()
    report = session.solve(Deadline.after(20))
    assert (report.schedule.makespan, report.bound, session.rebuilds) == (3, 3, 2)


def test_narrower_durations_fit_into_the_model():
    problem, (a,) = line_of([0])
    a.set_duration_bounds(2, 9)
    session = CpsatSession(problem, workers=1)
    assert session.solve(Deadline.after(20)).schedule.times["a0"] == (0, 2)
    a.set_duration_bounds(5, 9)
    assert session.solve(Deadline.after(20)).schedule.times["a0"] == (0, 5)
    assert session.rebuilds == 1
    a.set_duration_bounds(1, 9)
    assert session.solve(Deadline.after(20)).bound == 1


def test_new_activities_and_objects_are_picked_up():
    problem = travels()
    session = CpsatSession(problem, workers=1)
    before = session.solve(Deadline.after(60)).bound
    at = problem.fluent("at")()
    move = problem.get_activity("m01")
    watch = problem.add_activity("watch", optional=True)
    watch.set_duration_bounds(0, 100)
    span = ClosedTimeInterval(Timing(0, watch.start), Timing(0, watch.end))
    watch.add_condition(span, Not(Equals(at, problem.object("s2"))))
    problem.add_constraint(Equals(watch.start, move.start), scope=[watch.present])
    problem.add_constraint(watch.present)
    report = session.solve(Deadline.after(60))
    assert report.bound >= before
    assert validate_schedule(problem, build_schedule(problem, report.schedule)).valid
    new = problem.add_object("s9", UserType("spot"))
    problem.add_condition(TimePointInterval(GlobalEndTiming()), Not(Equals(at, new)))
    assert session.solve(Deadline.after(60)).status is ScheduleStatus.OPTIMAL


def test_infeasible_is_a_proof():
    problem, (a, b) = line_of([2, 2])
    problem.add_constraint(LT(a.end, b.start))
    problem.add_constraint(LT(b.end, a.start))
    assert solve(problem).status is ScheduleStatus.INFEASIBLE


def test_time_limits_are_no_proof():
    problem = travels(places=8, visits=24)
    watch = Watch()
    report = CpsatSession(problem, workers=1).solve(Deadline.after(0.0))
    assert report.status is ScheduleStatus.OUT_OF_TIME
    assert report.schedule is None
    assert watch.late(0.0) < 20


def test_without_metric_nothing_is_optimal():
    problem = SchedulingProblem("free")
    problem.add_activity("a", 3)
    report = solve(problem)
    assert (report.status, report.schedule.makespan) == (ScheduleStatus.FOUND, 3)


def test_one_worker_is_deterministic():
    one, other = (
        CpsatSession(travels(visits=6), seed=5, workers=1).solve(Deadline.never(), optimal=False)
        for _ in range(2)
    )
    assert one.schedule == other.schedule


def test_progress_and_hints():
    seen = []
    problem = travels()
    report = solve(problem, on_solution=lambda schedule, bound: seen.append((schedule, bound)))
    assert seen
    assert seen[-1][0].makespan == report.schedule.makespan
    again = solve(problem, hint=report.schedule, lower_bound=report.bound)
    assert again.schedule.makespan == report.schedule.makespan


def test_errors_in_callbacks_come_out():
    def fail(schedule, bound):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        solve(travels(), on_solution=fail)


def test_interrupting_stops_the_search():
    session = CpsatSession(travels(places=7, visits=20), workers=1)
    timer = threading.Timer(1.0, session.interrupt)
    timer.start()
    watch = Watch()
    session.solve(Deadline.after(600))
    assert watch.seconds < 300


def test_a_changing_fluent_in_a_constraint_is_refused_by_name():
    problem = travels()
    problem.add_constraint(Equals(problem.fluent("at")(), problem.object("s0")))
    with pytest.raises(UnsupportedError, match="at"):
        solve(problem)


def test_zero_durations_borrow_nothing():
    problem = SchedulingProblem("zero")
    machine = problem.add_resource("machine", 1)
    work = problem.add_activity("work", 4)
    work.uses(machine)
    blink = problem.add_activity("blink", 0)
    blink.uses(machine)
    problem.add_constraint(Equals(blink.start, 2))
    problem.add_quality_metric(MinimizeMakespan())
    assert solve(problem).schedule.makespan == 4
    problem.add_constraint(Or(LE(work.end, blink.start), LE(blink.end, work.start)))
    assert solve(problem).schedule.makespan == 6


def test_effort_ends_a_search_in_the_same_way_each_time():
    answers = []
    for _ in range(2):
        problem = disjunctive_shop(jobs=12, machines=12)
        session = CpsatSession(problem, workers=1, effort=0.02)
        answers.append(session.solve(Deadline.never()))
    first, second = answers
    assert first.status is ScheduleStatus.FOUND  # too little for a proof
    assert first.schedule == second.schedule
    assert first.bound == second.bound


def disjunctive_shop(jobs, machines):
    """Jobs through all machines, orders and durations drawn at random."""
    draw = random.Random(3)
    problem = SchedulingProblem("shop")
    on = {m: [] for m in range(machines)}
    for j in range(jobs):
        last = None
        for k, m in enumerate(draw.sample(range(machines), machines)):
            a = problem.add_activity(f"j{j}k{k}", draw.randint(1, 99))
            if last is not None:
                problem.add_constraint(LE(last.end, a.start))
            for b in on[m]:
                problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)))
            on[m].append(a)
            last = a
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def test_time_that_runs_out_while_the_model_is_built_is_told_and_can_be_made_good():
    problem = travels(places=5, visits=8)
    session = CpsatSession(problem)
    report = session.solve(Deadline.after(0.001))
    assert report.status is ScheduleStatus.OUT_OF_TIME
    assert report.seconds < 1
    again = session.solve(Deadline.after(60))
    assert again.status is ScheduleStatus.OPTIMAL
    assert again.schedule is not None
