"""The meta-engine ``samp-refine``: any UP scheduling engine, with motions."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Generator, Iterator
from fractions import Fraction
from functools import partial
from typing import IO, TYPE_CHECKING, Any

from unified_planning.engines import (
    Credits,
    Engine,
    MetaEngine,
    PlanGenerationResult,
    PlanGenerationResultStatus,
)
from unified_planning.engines.mixins.anytime_planner import AnytimeGuarantee, AnytimePlannerMixin
from unified_planning.engines.mixins.oneshot_planner import OneshotPlannerMixin, OptimalityGuarantee
from unified_planning.model import ProblemKind
from unified_planning.model.motion import MotionModels, MovableObject, SchedulingMotionProblem
from unified_planning.plans import Plan

from up_samp.engines.faces import Call, ReplanningFace
from up_samp.engines.features import COMPILED, PASSED_ON
from up_samp.engines.indirect import InOrder, costs_in_order
from up_samp.engines.results import (
    SampResult,
    broke_down,
    result_of,
    status_of,
    too_late,
    was_asked_for,
    with_progress,
)
from up_samp.model import (
    CandidateSchedule,
    Deadline,
    EngineError,
    MotionModel,
    OutOfTimeError,
    ProblemError,
    SampError,
    UnsupportedError,
    Violation,
    in_force,
)
from up_samp.model.errors import InterruptedSearch
from up_samp.scheduling.quirks import is_compatible
from up_samp.search.params import split_parameters
from up_samp.system.imports import interrupt_behind

if TYPE_CHECKING:
    from up_samp.motion.compile import Compilation
    from up_samp.search.conclusion import SearchResult
    from up_samp.search.knowledge import Incumbent
    from up_samp.search.search import Search
    from up_samp.upio import SampSchedule


def begin_compiling(problem: SchedulingMotionProblem) -> Compilation:
    """Begin to compile what the problem's bodies need, once per machine, before the clock runs and
    beside the imports.
    """
    from up_samp.motion.compile import begin

    movers = _movers(problem)
    kinds = [o.motion_model for o in movers if isinstance(o.motion_model, MotionModels)]
    models = {MotionModel[k.name] for k in kinds}  # the others are refused by name later
    return begin(models, several=len(movers) > 1)


def _movers(problem: SchedulingMotionProblem) -> set[MovableObject]:
    """Return what is moved by a motion constraint (doors and loads change place in one instant)."""
    moved = (c.movable for a in problem.motion_activities for c in a.motion_constraints)
    return {expression.object() for expression in moved if expression.is_object_exp()}


# schedulers, motion planners and the validator are imported when a problem is solved: UP imports
# this module when it is asked for its engines

log = logging.getLogger(__name__)

credits = Credits(
    "samp-refine",
    "the up_samp authors",
    "https://arxiv.org/abs/2603.10651",
    "https://arxiv.org/abs/2603.10651",
    "Apache-2.0",
    "Scheduling and motion planning, interleaved by learning from motion checks",
    "Scheduling and motion planning, interleaved: a scheduler proposes, motion planners check, "
    "and what they learn refines the scheduling problem until schedule and motions fit.",
)


class SampRefine(ReplanningFace, MetaEngine, OneshotPlannerMixin, AnytimePlannerMixin):  # type: ignore[misc]
    """Schedules with the wrapped engine and refines with motion planning.

    Parameters that are fields of :class:`up_samp.search.Parameters` are ours; all others go to
    the wrapped engine.
    """

    def __init__(
        self,
        *args: Any,
        problem: Any = None,
        error_on_failed_checks: bool = True,
        **kwargs: Any,
    ):
        self.params, self.engine_params = split_parameters(kwargs)
        if self.params.reproducible and self._native:
            self.engine_params.setdefault("workers", 1)
        MetaEngine.__init__(self, *args, **self.engine_params)
        OneshotPlannerMixin.__init__(self)
        AnytimePlannerMixin.__init__(self)
        if problem is not None:  # UP's factory makes a replanner
            self._keep(problem, error_on_failed_checks)

    @property
    def name(self) -> str:
        """Return the name in UP's factory."""
        return f"samp-refine[{self.engine.name}]"

    @staticmethod
    def get_credits(**kwargs: Any) -> Credits:
        """Return whom to cite."""
        return credits

    @staticmethod
    def is_compatible_engine(engine: type[Engine]) -> bool:
        """Return whether ``engine`` can schedule."""
        return is_compatible(engine) is True

    @staticmethod
    def _supported_kind(engine: type[Engine]) -> ProblemKind:
        """Return what an engine's kind becomes with compilers and motions."""
        kind = engine.supported_kind()  # which engines may share: it is not changed
        features = set(kind.features)
        if not getattr(engine, "has_sessions", False):  # else nothing is compiled for it
            features = features.intersection(PASSED_ON).union(COMPILED)
        return ProblemKind({*features, "SAMP"}, version=kind.version)

    @staticmethod
    def _supports(problem_kind: ProblemKind, engine: type[Engine]) -> bool:
        return bool(problem_kind <= SampRefine._supported_kind(engine))

    @classmethod
    def satisfies(cls, optimality_guarantee: OptimalityGuarantee) -> bool:
        """Return whether the wrapped engine can prove optimality, and so can we."""
        if optimality_guarantee is OptimalityGuarantee.SATISFICING:
            return True
        return bool(cls._engine_class.satisfies(OptimalityGuarantee.SOLVED_OPTIMALLY))

    @staticmethod
    def ensures(anytime_guarantee: AnytimeGuarantee) -> bool:
        """Return whether plans get better and better (they do)."""
        return anytime_guarantee is AnytimeGuarantee.INCREASING_QUALITY

    # ------------------------------------------------------------------ solving
    def _is_direct(self, problem: Any) -> bool:
        return isinstance(problem, SchedulingMotionProblem)

    def _solve_directly(self, call: Call) -> PlanGenerationResult:
        if call.heuristic is not None:
            warnings.warn(f"{self.name} ignores the heuristic", stacklevel=3)
        return list(self._results(call, *self._goal(call)))[-1]

    def _improve_directly(self, call: Call) -> Iterator[PlanGenerationResult]:
        optimal = bool(call.problem.quality_metrics) and not self.params.first_plan
        return self._results(call, optimal)

    def _goal(self, call: Call) -> tuple[bool, float]:
        """Return whether to go on after the first plan, and with how much patience.

        From a plan to begin from, one like it is asked for, and no better one.
        """
        params = self.params
        if not call.problem.quality_metrics or params.first_plan:
            return False, math.inf
        engine_proves = self._engine_class.satisfies(OptimalityGuarantee.SOLVED_OPTIMALLY)
        promised = self.optimality_metric_required or (engine_proves and not self._native)
        if params.optimal or promised:
            return True, math.inf
        return call.warm_start_plan is None, params.patience

    @property
    def _native(self) -> bool:
        return bool(getattr(self._engine_class, "has_sessions", False))

    def _results(
        self,
        call: Call,
        optimal: bool,
        patience: float = math.inf,
        before: list[Search] | None = None,
    ) -> Iterator[PlanGenerationResult]:
        """Yield each better plan as INTERMEDIATE, and last the final result.

        A plan to begin from is of this problem, or of one with some of its activities. ``before``
        holds the search of this problem by the objective ranked before, if there was one; this one
        takes its place.
        """
        from up_samp.engines.indirect import solve_settled
        from up_samp.upio.movers import settle_movers

        problem, timeout, start = call.problem, call.timeout, call.warm_start_plan
        moves = isinstance(problem, SchedulingMotionProblem) and problem.motion_activities
        if moves and (settled := settle_movers(problem)) is not None:
            again = partial(self._results, optimal=optimal, patience=patience)
            yield from solve_settled(settled, call, again, self.params.seconds_per_unit)
            return
        ranked = costs_in_order(problem)
        if ranked is not None:
            again = partial(self._results, optimal=optimal, patience=patience, before=[])
            yield from InOrder(ranked, call, again, self.params.reproducible).solve(
                first=not optimal and self.params.first_plan
            )
            return
        compiling = begin_compiling(problem) if moves else None
        # imports, too, are made before the clock runs
        from up_samp.engines.plain import schedule_plainly
        from up_samp.search.session import run

        if compiling is not None:
            compiling.wait()
        self._check_reproducible()
        counted = self.params.reproducible
        deadline = Deadline.counted(timeout) if counted else Deadline.after(timeout)
        if not moves:
            yield schedule_plainly(self, problem, deadline, optimal, start)
            return
        try:
            with in_force(deadline):
                search = self._open(problem, deadline, call.output_stream, start, before)
        except OutOfTimeError:
            yield too_late(self.name, self.params, deadline)
            return
        steps = run(search, optimal=optimal, patience=patience)
        yield from self._told(problem, search, steps, deadline)

    def _told(
        self, problem: Any, search: Search, steps: Generator[Any, None, Any], deadline: Deadline
    ) -> Iterator[PlanGenerationResult]:
        """Yield what a search finds, and how it ended, whatever ended it."""
        from up_samp.search.conclusion import Conclusion, SearchResult

        try:
            yield from self._plans(problem, search, steps, deadline)
        except (KeyboardInterrupt, Exception) as error:
            planned = search.bounds.incumbent is not None
            stop = interrupt_behind(error)
            if stop is not None and planned:
                best = SearchResult(Conclusion.SOLVED, "stopped; this is the best plan until then")
                raise InterruptedSearch(self._final(problem, search, best)) from stop
            if stop is not None and stop is not error:
                raise stop from None
            asked = stop is not None or was_asked_for(error)
            if asked or (isinstance(error, SampError) and not planned):
                raise
            log.exception("the search broke down")
            yield self._failure(problem, search, broke_down(error))
        finally:
            steps.close()

    def _check_reproducible(self) -> None:
        """Raise where the clock, or what runs beside, decides what is found."""
        if not self.params.reproducible:
            return
        if not self._native:
            raise UnsupportedError(
                f"reproducible=True: when '{self._engine_class.name}' answers hangs on the clock; "
                "use samp-refine[cpsat]"
            )
        if self.engine_params.get("workers") != 1:
            raise ProblemError("reproducible=True needs workers=1: CP-SAT's threads race")

    def _plans(
        self,
        problem: SchedulingMotionProblem,
        search: Search,
        steps: Generator[Incumbent, None, SearchResult],
        deadline: Deadline,
    ) -> Iterator[PlanGenerationResult]:
        """Yield each better plan, and what the search ends with, if it ends as it should."""
        from up_samp.search.conclusion import conclude
        from up_samp.search.loop import InvalidPlanError

        try:
            while True:
                with in_force(deadline):
                    better = next(steps)
                status = PlanGenerationResultStatus.INTERMEDIATE
                yield self._result(status, better.plan, search, "")
        except StopIteration as stop:
            yield self._final(problem, search, stop.value)
        except OutOfTimeError:
            yield self._final(problem, search, conclude(search))
        except (InvalidPlanError, EngineError) as error:
            yield self._failure(problem, search, str(error))

    def _open(
        self,
        problem: SchedulingMotionProblem,
        deadline: Deadline,
        stream: IO[str] | None,
        start: Plan | None,
        before: list[Search] | None,
    ) -> Search:
        from up_samp.engines.plain import wrong_in
        from up_samp.search.search import Wrapped
        from up_samp.search.session import open_search
        from up_samp.upio.plan import build_schedule
        from up_samp.validation import validate_plan, value_of

        params = self.params
        if stream is not None and params.progress is None:
            params = with_progress(params, stream)
        spu = params.seconds_per_unit

        def check_plan(plan: SampSchedule) -> list[Violation]:
            return list(validate_plan(problem, plan, seconds_per_unit=spu).violations)

        def worth(schedule: CandidateSchedule) -> int | Fraction:
            return value_of(problem, build_schedule(problem, schedule))

        engine, own, native = self._engine_class, self.engine_params, self._native
        wrapped = Wrapped(engine, own, wrong_in, check_plan, native, worth)
        service = before[-1].motions.service if before else None
        search = open_search(problem, wrapped, params, deadline, start=start, service=service)
        if before is not None:
            for other in before:
                search.learn(other.knowledge.sure)
            before[:] = [search]
        return search

    # ------------------------------------------------------------------ results
    def _failure(self, problem: Any, search: Search, why: str) -> PlanGenerationResult:
        """Return what went wrong, and the best plan until then, if there is one."""
        from up_samp.search.conclusion import Conclusion, SearchResult

        return self._final(problem, search, SearchResult(Conclusion.FAILED, why))

    def _final(self, problem: Any, search: Search, ending: SearchResult) -> PlanGenerationResult:
        from up_samp.search.conclusion import Conclusion, conclude_with_what_was_given

        if search.bounds.incumbent is None:
            ending = conclude_with_what_was_given(search, ending)
        best = search.bounds.incumbent
        plan, status = None if best is None else best.plan, status_of(ending.conclusion)
        failed = plan is not None and ending.conclusion is Conclusion.FAILED
        if failed or (ending.conclusion is Conclusion.OPTIMAL and not problem.quality_metrics):
            status = PlanGenerationResultStatus.SOLVED_SATISFICING
        return self._result(status, plan, search, ending.why)

    def _result(
        self, status: PlanGenerationResultStatus, plan: Plan | None, search: Search, why: str
    ) -> PlanGenerationResult:
        return result_of(self.name, self.params, search, status, plan, why)


__all__ = ["SampRefine", "SampResult"]
