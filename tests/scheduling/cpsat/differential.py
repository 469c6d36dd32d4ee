"""Compare cpsat with brute force on one random problem."""

from __future__ import annotations

from tests.oracles.brute_force_schedule import solve as brute_force
from tests.scheduling.cpsat.random_problems import HORIZON, random_problem
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.tuning import Tuning
from up_samp.upio.plan import build_schedule
from up_samp.validation.schedule import evaluate_metric, judge_schedule


def disagreement(seed: int, workers: int = 1, tuning: Tuning = Tuning()) -> str | None:
    """Return what differs on the problem of ``seed`` (``None``: nothing)."""
    problem = random_problem(seed)
    best = brute_force(problem, HORIZON)
    session = CpsatSession(problem, seed=seed, workers=workers, tuning=tuning)
    report = session.solve(Deadline.after(60))
    if best is None:
        if report.status is ScheduleStatus.INFEASIBLE:
            return None
        return f"{report.status.value} {report.schedule}, but there is no schedule"
    if report.schedule is None:
        return f"{report.status.value}, but there is {best}"
    plan = build_schedule(problem, report.schedule)
    verdict, timeline = judge_schedule(problem, plan)
    if not verdict.valid:
        return f"invalid: {verdict.violations} {report.schedule}; best {best}"
    metrics = problem.quality_metrics
    if not metrics:
        return None if report.status is ScheduleStatus.FOUND else f"status {report.status}"
    if report.status is not ScheduleStatus.OPTIMAL:
        return f"status {report.status}"
    value = evaluate_metric(metrics[0], timeline)
    wanted = best.value if not metrics[0].is_maximize_expression_on_final_state() else -best.value
    if value != wanted:
        return f"value {value} {report.schedule}, best {best}"
    if metrics[0].is_minimize_makespan() and report.bound != (best.value or None):
        return f"bound {report.bound} is not the optimum {best.value}"
    return None


def grown_disagreement(seed: int) -> str | None:
    """Take constraints and conditions off a random problem, add them again one by one with a
    solve after each, and compare with brute force in the end.
    """
    problem = random_problem(seed)
    constraints = problem._base._constraints
    later = constraints[len(constraints) // 2 :]
    del constraints[len(constraints) // 2 :]
    conditions = [(a, dict(a._conditions)) for a in problem.activities]
    for a in problem.activities:
        a._conditions.clear()
    session = CpsatSession(problem, seed=seed, workers=1)
    session.solve(Deadline.after(60))
    for item in later:
        constraints.append(item)
        session.solve(Deadline.after(60))
    for a, spans in conditions:
        for span, parts in spans.items():
            for part in parts:
                a.add_condition(span, part)
        session.solve(Deadline.after(60))
    report = session.solve(Deadline.after(60))
    best = brute_force(problem, HORIZON)
    if best is None or report.schedule is None:
        same = best is None and report.status is ScheduleStatus.INFEASIBLE
        return None if same else f"{report.status} {report.schedule}, best {best}"
    verdict, _ = judge_schedule(problem, build_schedule(problem, report.schedule))
    if not verdict.valid:
        return f"invalid: {verdict.violations}"
    metrics = problem.quality_metrics
    if metrics and metrics[0].is_minimize_makespan():
        if report.schedule.makespan != best.value:
            return f"{report.schedule}, best {best}"
        if report.bound != (best.value or None):
            return f"bound {report.bound}, best {best.value}"
    return None
