"""Problems without motions are simply scheduled."""

from __future__ import annotations

from typing import Any

from unified_planning.engines import (
    LogLevel,
    LogMessage,
    PlanGenerationResult,
    PlanGenerationResultStatus,
)
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Plan, Schedule

from up_samp.engines.results import STATUSES
from up_samp.model import (
    Deadline,
    OutOfTimeError,
    ScheduleReport,
    ScheduleStatus,
    in_force,
)
from up_samp.scheduling import open_scheduler
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.resolve import start_of
from up_samp.upio import build_schedule, read_problem, relax
from up_samp.upio.objective import measure_of, only_makespan
from up_samp.validation import validate_schedule, value_of


def schedule_plainly(
    engine: Any, problem: Any, deadline: Deadline, optimal: bool, start: Plan | None = None
) -> PlanGenerationResult:
    """Return the wrapped engine's schedule for a problem that moves nothing, validated.

    ``start`` is a plan to begin from, for engines that can.
    """
    plain = problem
    if isinstance(problem, SchedulingMotionProblem):
        plain = relax(problem, read_problem(problem, engine.params.seconds_per_unit)).problem
    scheduler = open_scheduler(
        engine._engine_class,
        plain,
        params=engine.engine_params,
        seed=engine.params.seed,
        check=wrong_in,
        environment=problem.environment,
    )
    if isinstance(scheduler, CpsatSession):
        scheduler.doubts = True
    try:
        hint = None if start is None else start_of(plain, start)
        wanted = optimal or (bool(problem.quality_metrics) and not engine.params.first_plan)
        with in_force(deadline):
            report = scheduler.solve(deadline, optimal=wanted, hint=hint)
    except OutOfTimeError as error:
        report = ScheduleReport(ScheduleStatus.OUT_OF_TIME, message=str(error))
    finally:
        scheduler.close()
    metrics = {
        "seconds_scheduler": f"{report.seconds:.3f}",
        "preset": engine.params.preset,
        "seconds_per_unit": repr(engine.params.seconds_per_unit),
    }
    promised = engine.satisfies(OptimalityGuarantee.SOLVED_OPTIMALLY)
    return result_of_schedule(engine.name, problem, report, metrics, promised=promised)


def worth_of(
    problem: Any, report: ScheduleReport, plan: Schedule | None
) -> tuple[dict[str, str], bool]:
    """Return what is told of a schedule's worth and its bound, and whether the validator's value of
    the plan is the one that the scheduler claims.
    """
    if only_makespan(problem):
        bound = {} if report.bound is None else {"lower_bound": str(report.bound)}
        return bound, True
    measure = measure_of(problem, lambda schedule: value_of(problem, schedule))
    cost = None if plan is None else measure.cost(plan)
    return measure.metrics(report.bound, cost), plan is None or cost == report.cost


def wrong_in(problem: Any, schedule: Schedule) -> list[str]:
    """Return what the validator has against a schedule of a problem without motions."""
    return [str(v) for v in validate_schedule(problem, schedule).violations]


def result_of_schedule(
    name: str,
    problem: Any,
    report: ScheduleReport,
    metrics: dict[str, str],
    *,
    promised: bool,
    final: bool = True,
) -> PlanGenerationResult:
    """Return a scheduler's answer in UP's words, its schedule validated.

    :param metrics: what else is told.
    :param promised: whether the engine ``name`` says that its plans are optimal.
    :param final: whether it is the engine's last word.
    """
    status, plan = STATUSES[report.status], None
    metrics = dict(metrics)
    level = LogLevel.ERROR if report.status is ScheduleStatus.ERROR else LogLevel.INFO
    messages = [LogMessage(level, report.message)] if report.message else []
    if report.refuted:
        metrics["refuted"] = report.refuted
        messages.append(LogMessage(LogLevel.ERROR, report.refuted))
    if report.recognised or report.left_over:
        metrics["recognised"] = "; ".join(report.recognised)
        metrics["left_over"] = "; ".join(report.left_over)
        told = f"recognised: {metrics['recognised']}. Left over: {metrics['left_over'] or '-'}"
        messages.append(LogMessage(LogLevel.INFO, told))
    if report.schedule is not None:
        plan = build_schedule(problem, report.schedule)
        metrics["makespan"] = str(report.schedule.makespan)
        violations = wrong_in(problem, plan)
        if violations:
            messages.append(LogMessage(LogLevel.ERROR, f"invalid schedule: {violations[0]}"))
            status, plan = PlanGenerationResultStatus.INTERNAL_ERROR, None
    worth, honest = worth_of(problem, report, plan)
    proven = status is PlanGenerationResultStatus.SOLVED_OPTIMALLY
    if proven and not (honest and problem.quality_metrics):
        status = PlanGenerationResultStatus.SOLVED_SATISFICING
    elif plan is not None and not final:
        status = PlanGenerationResultStatus.INTERMEDIATE
    elif plan is not None and report.late and promised and problem.quality_metrics:
        status = PlanGenerationResultStatus.TIMEOUT  # with the best plan until then
    return PlanGenerationResult(status, plan, name, metrics | worth, messages)
