"""Answers of cpsat with and without what it recognises, and its bounds without search."""

from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.workload import bound_by_assignment, bound_by_work
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


def bound_without_search(problem):
    """Return the lower bound by all the work there is (None: there are no routes).

    That by who does what must not be greater than what is proven elsewhere, either: the greater
    one is returned.
    """
    full = ScheduleModel(problem)
    routes = find_routes(full)
    work = find_work(full, routes) if routes else None
    return None if work is None else max(bound_by_work(work).value, bound_by_assignment(work, 0))


def disagreement(problem):
    """Return (what differs if things are recognised in a problem, whether it has routes)."""
    truth, found = answer(problem, plain=True), answer(problem)
    if truth is None or found is None:
        return None, False
    if found != truth:
        return f"{found}, but in truth {truth}", True
    quick = bound_without_search(problem)
    wrong = quick is not None and truth[1] is not None and quick > truth[1]
    return (f"bound by work {quick} above {truth[1]}" if wrong else None), quick is not None
