"""Answers of cpsat with and without what it recognises, and the optimum of a collapsed problem."""

import threading

from ortools.sat.python import cp_model

from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.relaxation import RoutingRelaxation
from up_samp.scheduling.cpsat.routing.workload import bound_by_assignment, bound_by_work
from up_samp.scheduling.cpsat.solve.attempts import Attempts, Orders
from up_samp.tuning import Tuning
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_schedule

EFFORT = 0.3
"""Of CP-SAT, in its deterministic time."""


def answer(problem, *, plain=False):
    """Return (status, makespan), ``None`` where it would take long to prove it; ``plain``: with
    nothing recognised.
    """
    session = CpsatSession(problem, workers=1, effort=EFFORT, plain=plain)
    report = session.solve(Deadline.after(60))
    if report.status in (ScheduleStatus.FOUND, ScheduleStatus.OUT_OF_TIME):
        return None
    if report.schedule is None:
        return report.status, None
    judged = validate_schedule(problem, build_schedule(problem, report.schedule))
    assert not judged.violations, judged.violations
    assert report.status is ScheduleStatus.OPTIMAL
    assert report.bound in (report.schedule.makespan, None)
    return report.status, report.schedule.makespan


ORDERS = Orders(0, 1, True, Tuning(), threading.Event())


def bound_without_search(problem):
    """Return the lower bound by all the work there is (None: there are no routes).

    That by who does what must not be greater than what is proven elsewhere, either: the greater
    one is returned.
    """
    full = ScheduleModel(problem)
    routes = find_routes(full)
    work = find_work(full, routes) if routes else None
    return None if work is None else max(bound_by_work(work).value, bound_by_assignment(work, 0))


def collapsed_optimum(problem):
    """Return the collapsed problem's optimum (-1: it has no schedule; None: there is none)."""
    full = ScheduleModel(problem)
    routes = find_routes(full)
    if not routes:
        return None
    collapsed = RoutingRelaxation(full, routes)
    Attempts(collapsed.model, ORDERS, Deadline.never(), 0)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    status = solver.solve(collapsed.model.store.model)
    assert status in (cp_model.OPTIMAL, cp_model.INFEASIBLE)
    return round(solver.objective_value) if status == cp_model.OPTIMAL else -1


def disagreement(problem):
    """Return (what differs if things are recognised in a problem, whether it has routes)."""
    truth, found = answer(problem, plain=True), answer(problem)
    if truth is None or found is None:
        return None, False
    if found != truth:
        return f"{found}, but in truth {truth}", True
    quick = bound_without_search(problem)
    if quick is not None and truth[1] is not None and quick > truth[1]:
        return f"bound by work {quick} above {truth[1]}", True
    bound = collapsed_optimum(problem)
    wrong = bound is not None and truth[1] is not None and not 0 <= bound <= truth[1]
    return (f"bound {bound} above {truth[1]}" if wrong else None), bound is not None
