"""The UP face of engines that read a problem without computing its kind first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.exceptions import UPUsageError
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Plan


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
        from up_samp.upio.spans import has_bare_ends

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
