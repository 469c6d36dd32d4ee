"""Base classes of the engines that UP sees: problems read without their kind, warm starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Any
from warnings import warn

from unified_planning.engines import PlanGenerationResult
from unified_planning.engines.mixins.plan_repairer import PlanRepairerMixin
from unified_planning.engines.mixins.replanner import ReplannerMixin
from unified_planning.exceptions import UPUsageError
from unified_planning.model import TimePointInterval
from unified_planning.model.motion import MotionActivity, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.timing import GlobalEndTiming
from unified_planning.plans import Plan, PlanKind, Schedule

from up_samp.model import UnsupportedError


@dataclass(frozen=True)
class Call:
    """What UP asks an engine, in UP's order: ``timeout`` in s."""

    problem: Any
    heuristic: Callable[[Any], float | None] | None = None
    timeout: float | None = None
    output_stream: IO[str] | None = None
    warm_start_plan: Plan | None = None


class DirectFace:
    """``solve`` and ``get_solutions`` as every UP engine has them, but for its own problems
    without computing the kind: that takes as long as solving a small problem, and seconds for large
    ones, outside the time limit. Reading the problem refuses by name what is not supported.

    To be named before UP's mixins, which do the rest.
    """

    optimality_metric_required: bool

    def solve(
        self,
        problem: Any,
        heuristic: Callable[[Any], float | None] | None = None,
        timeout: float | None = None,
        output_stream: IO[str] | None = None,
        warm_start_plan: Plan | None = None,
        **kwargs: Any,
    ) -> PlanGenerationResult:
        """Solve as every UP engine does (``timeout`` in s)."""
        told = (problem, heuristic, timeout, output_stream, warm_start_plan)
        if not self._takes(problem):
            return super().solve(*told, **kwargs)  # type: ignore[misc,no-any-return]
        self._check_metric(problem)
        return self._solve_directly(Call(*told))

    def get_solutions(
        self,
        problem: Any,
        timeout: float | None = None,
        output_stream: IO[str] | None = None,
        warm_start_plan: Plan | None = None,
        **kwargs: Any,
    ) -> Iterator[PlanGenerationResult]:
        """Yield better and better plans."""
        told = (timeout, output_stream, warm_start_plan)
        if not self._takes(problem):
            yield from super().get_solutions(problem, *told, **kwargs)  # type: ignore[misc]
            return
        self._check_metric(problem)
        yield from self._improve_directly(Call(problem, None, *told))

    # UP asks these once it has seen the kind: by keywords, or, before it knew of plans to begin
    # from, by position
    def _solve_with_params(self, *told: Any, **named: Any) -> PlanGenerationResult:
        return self._solve_directly(Call(*told, **named))

    _solve = _solve_with_params

    def _get_solutions_with_params(
        self, problem: Any, *told: Any, **named: Any
    ) -> Iterator[PlanGenerationResult]:
        return self._improve_directly(Call(problem, None, *told, **named))

    _get_solutions = _get_solutions_with_params

    def _takes(self, problem: Any) -> bool:
        """Return whether to solve without the kind; also where UP could not compute it."""
        from up_samp.upio.expressions import has_bare_ends

        if self._is_direct(problem):
            return True
        return isinstance(problem, SchedulingProblem) and has_bare_ends(problem)

    def _check_metric(self, problem: Any) -> None:
        if self.optimality_metric_required and not problem.quality_metrics:
            raise UPUsageError(
                "The problem has no quality metrics but the engine is required to be optimal!"
            )

    # -- what an engine says -------------------------------------------------------------------
    def _is_direct(self, problem: Any) -> bool:
        """Return whether this is a problem of the engine's own sort."""
        raise NotImplementedError

    def _solve_directly(self, call: Call) -> PlanGenerationResult:
        raise NotImplementedError

    def _improve_directly(self, call: Call) -> Iterator[PlanGenerationResult]:
        raise NotImplementedError


# ------------------ REPLANNER and PLAN_REPAIRER: solve again from the plan that there is


class ReplanningFace(DirectFace, ReplannerMixin, PlanRepairerMixin):  # type: ignore[misc]
    """``Replanner`` and ``PlanRepairer`` of an engine that can begin from a plan.

    The replanner keeps a copy of the problem and the plan of its last :meth:`resolve`, from which
    the next one begins. Goals are what holds at the plan's end, or of presences and parameters;
    actions are activities.
    """

    _last: Plan | None = None

    def _keep(self, problem: Any, error_on_failed_checks: bool) -> None:
        """Take the problem of a replanner (without its kind where it would be computed in vain)."""
        if not isinstance(problem, SchedulingProblem):
            raise UnsupportedError(f"a {type(problem).__name__}: scheduling problems are replanned")
        from up_samp.upio.objective import check_copied

        check_copied(problem)
        if self._takes(problem):
            self._problem = problem.clone()
            self._error_on_failed_checks = error_on_failed_checks
        else:
            ReplannerMixin.__init__(self, problem, error_on_failed_checks)

    @staticmethod
    def supports_plan(plan_kind: PlanKind) -> bool:
        """Return whether plans of this kind can be repaired: schedules, with or without motions."""
        return bool(plan_kind == PlanKind.SCHEDULE)

    def repair(self, problem: Any, plan: Plan) -> PlanGenerationResult:
        """Return a plan of ``problem`` sought from ``plan`` on, which may be of an older problem.

        :raises UPUsageError: where ``plan`` is no schedule.
        """
        if not isinstance(plan, Schedule):
            raise UPUsageError(f"schedules are repaired, not a {type(plan).__name__}")
        if not self._takes(problem):
            return PlanRepairerMixin.repair(self, problem, plan)
        self._check_metric(problem)
        return self._repair(problem, plan)

    def _repair(self, problem: Any, plan: Plan) -> PlanGenerationResult:
        return self._solve_directly(Call(problem, warm_start_plan=plan))

    # -- the replanner -------------------------------------------------------------------------
    def _resolve(
        self, timeout: float | None = None, output_stream: IO[str] | None = None
    ) -> PlanGenerationResult:
        from up_samp.upio.movers import movers

        problem = self._replanned()
        chosen = any(movers(a) for a in getattr(problem, "motion_activities", ()))
        # who moves may be another one each time, and is not begun from
        start = None if chosen else self._last
        result = self._solve_directly(Call(problem.clone(), None, timeout, output_stream, start))
        self._last = result.plan or self._last
        return result

    def _replanned(self) -> SchedulingProblem:
        problem = getattr(self, "_problem", None)
        if problem is None:
            raise UPUsageError(
                "this engine replans nothing: make one by Replanner(problem, name=...)"
            )
        return problem

    def _update_initial_value(self, fluent: Any, value: Any) -> None:
        """Set a fluent's initial value, or where a movable object stands."""
        problem = self._replanned()
        told, new = problem.environment.expression_manager.auto_promote(fluent, value)
        if not (told.is_object_exp() and told.type.is_movable_type()):
            problem.set_initial_value(fluent, value)
            return
        if not isinstance(problem, SchedulingMotionProblem):
            raise UPUsageError(f"'{told}' stands nowhere: the problem has no motions")
        known = list(problem._initial_configuration)
        problem.set_initial_configuration(told, new)  # which appends, after checks
        problem._initial_configuration[:] = [pair for pair in known if pair[0] != told]
        problem._initial_configuration.append((told, new))

    def _add_goal(self, goal: Any) -> None:
        problem = self._replanned()
        (wanted,) = problem.environment.expression_manager.auto_promote(goal)
        if problem.environment.free_vars_extractor.get(wanted):
            problem.add_condition(TimePointInterval(GlobalEndTiming()), wanted)
        else:
            problem.add_constraint(wanted)

    def _remove_goal(self, goal: Any) -> None:
        problem = self._replanned()
        (unwanted,) = problem.environment.expression_manager.auto_promote(goal)
        base, found = problem._base, False
        for span, conditions in list(base.conditions.items()):
            if span == TimePointInterval(GlobalEndTiming()) and unwanted in conditions:
                conditions.remove(unwanted)
                found = True
        kept = [c for c in base.scoped_constraints if c[0] != unwanted or c[1]]
        found = found or len(kept) < len(base.scoped_constraints)
        base._constraints[:] = kept
        if not found:
            self._complain(f"the problem has no goal '{unwanted}'")

    def _add_action(self, action: Any) -> None:
        problem = self._replanned()
        if not isinstance(action, Activity):
            raise UnsupportedError(
                f"action '{getattr(action, 'name', action)}': schedules consist of activities"
            )
        if problem.has_name(action.name) or any(a.name == action.name for a in problem.activities):
            raise UPUsageError(f"the problem has something named '{action.name}' already")
        if isinstance(action, MotionActivity):
            if not isinstance(problem, SchedulingMotionProblem):
                raise UPUsageError(f"'{action.name}' moves, but the problem has no motions")
            problem._motion_activities.append(action)
        problem._activities.append(action)

    def _remove_action(self, name: str) -> None:
        """Remove an activity; an optional one that others speak of is never done instead."""
        problem = self._replanned()
        gone = next((a for a in problem.activities if a.name == name), None)
        if gone is None:
            self._complain(f"the problem has no activity '{name}'")
            return
        speakers = list(_speakers(problem, gone))
        if speakers and not gone.optional:
            raise UPUsageError(
                f"activity '{name}' has to be done, and others speak of it: {'; '.join(speakers)}"
            )
        if speakers:
            problem.add_constraint(problem.environment.expression_manager.Not(gone.present))
            return
        for listed in (problem._activities, getattr(problem, "_motion_activities", [])):
            listed[:] = [a for a in listed if a.name != name]

    def _complain(self, why: str) -> None:
        """Raise or warn, as UP's replanner does."""
        if self._error_on_failed_checks:
            raise UPUsageError(why)
        warn(why, stacklevel=4)


def _speakers(problem: SchedulingProblem, activity: Activity) -> Iterator[str]:
    """Yield what the problem or another activity says of ``activity``."""
    # with UP problems comes geometry, which engines that are only named need not import
    from up_samp.upio.expressions import activities_in, chronicles_of, effects_of

    for _, chronicle in chronicles_of(problem):
        if chronicle is activity:
            continue
        said: list[tuple[str, tuple[Any, ...], tuple[Any, ...]]]
        said = [(f"constraint '{c}'", (c, *scope), ()) for c, scope in chronicle.scoped_constraints]
        for span, conditions in chronicle.conditions.items():
            said += [(f"condition '{c}'", (c,), (span.lower, span.upper)) for c in conditions]
        for timing, e in effects_of(chronicle):
            said.append((f"effect '{e}'", (e.fluent, e.value, e.condition), (timing,)))
        for text, nodes, times in said:
            named = {name for node in nodes for name in activities_in(node)}
            # ends of intervals may be bare timepoints
            named |= {getattr(time, "timepoint", time).container for time in times}
            if activity.name in named:
                yield text
