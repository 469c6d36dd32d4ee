"""The scheduling problems inside the SAMP families: moves at 2 m/s, doors opened before they are
passed, no motion planning. The figures ``relaxations`` and ``resolving`` are measured with it.
"""

from __future__ import annotations

import itertools
import math
import time
from typing import Any

from unified_planning.model import ClosedTimeInterval, Timing

from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import improve, steps_of
from up_samp.scheduling.cpsat.routing.workload import bound_by_work
from up_samp.upio import read_problem, relax

SPEED = 2.0
"""m/s: the speed at which unobstructed moves are driven."""


def relaxation(problem: Any) -> Any:
    """Return the plain problem with realistic durations and door conditions stated."""
    snapshot = read_problem(problem)
    result = relax(problem, snapshot)
    plain = result.problem
    em = plain.environment.expression_manager
    for task in snapshot.tasks:
        activity = result.activities[task.activity]
        names = [t.name for t in task.terms]
        poses = [snapshot.configurations[n] for n in names]
        length = sum(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(poses))
        low = max(int(activity.duration.lower.constant_value()), math.ceil(length / SPEED))
        high = max(low, int(activity.duration.upper.constant_value()))
        activity.set_duration_bounds(low, high)
        for door in _doors(names, snapshot):
            closed = em.ObjectExp(plain.object(snapshot.initial[door]))
            is_closed = em.Equals(result.state[door], closed)
            span = ClosedTimeInterval(Timing(1, activity.start), Timing(0, activity.end))
            activity.add_condition(span, em.Not(is_closed))
    return plain


def _doors(names: list[str], snapshot: Any) -> set[str]:
    """Return the doors that a move between these places passes."""
    doors = {d for d in snapshot.initial if d.startswith("door")}
    rooms = [n.removeprefix("machine") for n in names if n.startswith("machine")]
    passed = {f"door{r}" for r in rooms}
    if any(n.endswith("in") and n.startswith("item") for n in names):
        passed |= doors
    return passed & doors


def bounds(problem: Any) -> dict[str, Any]:
    """Return the lower bound without search, and the makespan of the best quick tour (list
    scheduling and annealing).
    """
    model = ScheduleModel(relaxation(problem))
    work = find_work(model, find_routes(model))
    assert work is not None, "the problem has no routes"
    began = time.process_time()
    found = bound_by_work(work)
    cpu, some = time.process_time() - began, found.sequences
    start = steps_of(work, some, some.found[0]) if some is not None and some.found else []
    effort = 60 * len(work.tasks)
    tour = improve(work, effort, 0, Deadline.never(), start=start, enough=found.value)
    makespan = tour.schedule.makespan if tour is not None else None
    return {"bound": found.value, "tour": makespan, "cpu": cpu}


def tighten(problem: Any, schedule: Any, number: int) -> None:
    """Do what a motion check does: a move of the schedule takes longer, or may not overlap."""
    moves = sorted(n for n in schedule.times if n.startswith("move"))
    name = moves[number % len(moves)]
    activity = problem.get_activity(name)
    start, end = schedule.times[name]
    high = int(activity.duration.upper.constant_value())
    activity.set_duration_bounds(min(end - start + 2, high), high)
    em = problem.environment.expression_manager
    other = problem.get_activity(moves[(number + 1) % len(moves)])
    if other is not activity:
        apart = em.Or(em.LT(activity.end, other.start), em.LT(other.end, activity.start))
        problem.add_constraint(apart, scope=[activity.present, other.present])


def resolve(problem: Any, rounds: int, seconds: float = 60.0, workers: int = 2) -> dict[str, float]:
    """Re-solve a relaxation while constraints are added: CPU seconds of one session, and of a new
    one each round, both to the proven optimum.
    """
    plain = relaxation(problem)
    session = CpsatSession(plain, workers=workers)
    report, spent = session.solve(Deadline.after(seconds)), {"warm": 0.0, "cold": 0.0}
    for number in range(rounds):
        tighten(plain, report.schedule, number)
        began = time.process_time()
        report = session.solve(Deadline.after(seconds))
        spent["warm"] += time.process_time() - began
        began = time.process_time()
        fresh = CpsatSession(plain, workers=workers).solve(Deadline.after(seconds))
        spent["cold"] += time.process_time() - began
        assert (report.status, report.bound) == (fresh.status, fresh.bound), "not the same answer"
    return {**spent, "ratio": spent["cold"] / spent["warm"]}
