"""``cpsat``: exact scheduling on OR-Tools CP-SAT, as a Unified Planning engine."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from fractions import Fraction
from typing import IO, TYPE_CHECKING, Any, ClassVar

from unified_planning.engines import (
    Credits,
    Engine,
    LogLevel,
    LogMessage,
    PlanGenerationResult,
    PlanGenerationResultStatus,
)
from unified_planning.engines.mixins import AnytimePlannerMixin, OneshotPlannerMixin
from unified_planning.engines.mixins.anytime_planner import AnytimeGuarantee
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.model import ProblemKind
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.problem_kind_versioning import LATEST_PROBLEM_KIND_VERSION
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule

from up_samp.engines.faces import Call, DirectFace
from up_samp.engines.features import SCHEDULES
from up_samp.model import (
    CandidateSchedule,
    Deadline,
    ProblemError,
    ScheduleReport,
    ScheduleStatus,
    UnsupportedError,
)
from up_samp.model.errors import short

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat import CpsatSession


# OR-Tools and the validator are imported when a problem is solved: UP imports this module when it
# is asked for its engines


CREDITS = Credits(
    "cpsat",
    "the up_samp authors",
    "",
    "https://developers.google.com/optimization/cp/cp_solver",
    "Apache-2.0",
    "Exact scheduling with OR-Tools CP-SAT",
    "Schedules with optional activities, fluents and resources as a CP-SAT model.",
)


class CpsatEngine(DirectFace, Engine, OneshotPlannerMixin, AnytimePlannerMixin):
    """``OneshotPlanner(name="cpsat")`` and ``AnytimePlanner(name="cpsat")``.

    :param seed: of the search; with ``workers=1`` the same seed gives the same plan.
    :param workers: threads (``None``: one per core).
    :param tuning: tunables (:mod:`up_samp.tuning`), or a table or TOML file of them.
    """

    has_sessions: ClassVar[bool] = True
    """Solved by a :class:`CpsatSession` where one problem is solved again and again."""

    def __init__(
        self, seed: int = 0, workers: int | None = None, tuning: Any = None, **options: Any
    ) -> None:
        Engine.__init__(self)
        OneshotPlannerMixin.__init__(self)
        AnytimePlannerMixin.__init__(self)
        if options:
            raise ProblemError(f"cpsat has no option {', '.join(sorted(options))}")
        count = 1 if workers is None else workers
        for name, value in (("seed", seed), ("workers", count)):
            if not isinstance(value, int) or isinstance(value, bool):
                raise ProblemError(f"cpsat's {name} must be a whole number, not {short(value)}")
        if count < 1:
            raise ProblemError(f"cpsat needs at least one worker, not {workers}")
        self.seed = seed
        self.workers = workers
        self.tuning = tuning

    @property
    def name(self) -> str:
        """The engine's name."""
        return "cpsat"

    @staticmethod
    def supported_kind() -> ProblemKind:
        """Return the features that are supported (a new object at each call)."""
        return ProblemKind(SCHEDULES, version=LATEST_PROBLEM_KIND_VERSION)

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        """Return whether problems of this kind can be scheduled."""
        return bool(problem_kind <= CpsatEngine.supported_kind())

    @staticmethod
    def satisfies(optimality_guarantee: OptimalityGuarantee) -> bool:
        """Return whether plans come with this guarantee: both do."""
        return True

    @staticmethod
    def ensures(anytime_guarantee: AnytimeGuarantee) -> bool:
        """Return whether the anytime mode gives this guarantee: each plan beats the last."""
        return bool(anytime_guarantee == AnytimeGuarantee.INCREASING_QUALITY)

    @staticmethod
    def get_credits(**kwargs: Any) -> Credits | None:
        """Return who made the solver that does the work."""
        return CREDITS

    # ------------------------------------------------------------------ solving
    def _is_direct(self, problem: Any) -> bool:
        return type(problem) is SchedulingProblem

    def _solve_directly(self, call: Call) -> PlanGenerationResult:
        deadline = Deadline.after(call.timeout)
        try:
            session = self._session(call.problem)
            report = session.solve(deadline, hint=_candidate(call.warm_start_plan))
        except UnsupportedError as error:
            return self._unsupported(error)
        result = self._result(call.problem, report)
        _write(call.output_stream, result)
        return result

    def _improve_directly(self, call: Call) -> Iterator[PlanGenerationResult]:
        deadline = Deadline.after(call.timeout)
        try:
            session = self._session(call.problem)
        except UnsupportedError as error:
            yield self._unsupported(error)
            return
        found: queue.Queue[tuple[ScheduleReport | BaseException, bool]] = queue.Queue()
        stop = threading.Event()

        def progress(schedule: CandidateSchedule, bound: int | Fraction | None) -> None:
            if stop.is_set():
                raise RuntimeError("whoever asked for schedules has gone")
            seconds = deadline.elapsed()
            found.put((ScheduleReport(ScheduleStatus.FOUND, schedule, bound, "", seconds), False))

        def work() -> None:
            try:
                hint = _candidate(call.warm_start_plan)
                found.put((session.solve(deadline, hint=hint, on_solution=progress), True))
            except BaseException as error:  # raised again by the generator
                found.put((error, True))

        thread = threading.Thread(target=work, daemon=True)
        try:
            thread.start()
            yield from self._stream(call.problem, found, call.output_stream)
        finally:
            stop.set()
            session.interrupt()
            if thread.ident is not None:  # Ctrl-C may come before it is started
                thread.join()

    def _stream(
        self,
        problem: Any,
        found: queue.Queue[tuple[ScheduleReport | BaseException, bool]],
        output: IO[str] | None,
    ) -> Iterator[PlanGenerationResult]:
        """Yield intermediate plans as they are found, then the final result."""
        final = False
        while not final:
            item, final = found.get()
            if isinstance(item, UnsupportedError):
                yield self._unsupported(item)
                return
            if isinstance(item, BaseException):
                raise item
            result = self._result(problem, item, final=final)
            _write(output, result)
            yield result

    def _session(self, problem: Any) -> CpsatSession:
        if not isinstance(problem, SchedulingProblem):
            raise ProblemError("cpsat schedules scheduling problems only")
        if isinstance(problem, SchedulingMotionProblem) and problem.motion_activities:
            name = problem.motion_activities[0].name
            raise UnsupportedError(
                f"cpsat alone plans no motions, and activity '{name}' has some: samp-refine[cpsat] "
                "plans both"
            )
        from up_samp.scheduling.cpsat import CpsatSession
        from up_samp.tuning import tuning_of

        tuning = tuning_of(self.tuning)
        session = CpsatSession(problem, seed=self.seed, workers=self.workers, tuning=tuning)
        session.doubts = True
        return session

    def _unsupported(self, error: UnsupportedError) -> PlanGenerationResult:
        messages = [LogMessage(LogLevel.ERROR, str(error))]
        status = PlanGenerationResultStatus.UNSUPPORTED_PROBLEM
        return PlanGenerationResult(status, None, self.name, {}, messages)

    def _result(
        self, problem: Any, report: ScheduleReport, final: bool = True
    ) -> PlanGenerationResult:
        from up_samp.engines.plain import result_of_schedule

        metrics = {"engine_internal_time": f"{report.seconds:.3f}"}
        return result_of_schedule(self.name, problem, report, metrics, promised=True, final=final)


def _write(stream: IO[str] | None, result: PlanGenerationResult) -> None:
    if stream is not None:
        metrics = result.metrics or {}
        makespan, bound = metrics.get("makespan", "-"), metrics.get("lower_bound", "-")
        stream.write(f"cpsat: {result.status.name} makespan {makespan} bound {bound}\n")


def _candidate(plan: Any) -> CandidateSchedule | None:
    """Return a UP schedule as plain values (``None`` for no plan)."""
    if plan is not None and not isinstance(plan, Schedule):
        raise ProblemError("cpsat starts from schedules only")
    from up_samp.upio.plan import to_candidate

    return None if plan is None else to_candidate(plan)
