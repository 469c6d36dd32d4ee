"""The Unified Planning face of the validator."""

from __future__ import annotations

from typing import Any

from unified_planning.engines import (
    Credits,
    Engine,
    FailedValidationReason,
    LogLevel,
    LogMessage,
    ValidationResult,
    ValidationResultStatus,
)
from unified_planning.engines.mixins import PlanValidatorMixin
from unified_planning.model import ProblemKind
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.problem_kind_versioning import LATEST_PROBLEM_KIND_VERSION
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import PlanKind, Schedule

from up_samp.engines.features import BESIDES, SCHEDULES
from up_samp.model import ProblemError

_REASONS = {
    "condition": FailedValidationReason.INAPPLICABLE_ACTION,
    "interference": FailedValidationReason.MUTEX_CONFLICT,
    "effect-conflict": FailedValidationReason.MUTEX_CONFLICT,
    "overlap": FailedValidationReason.MUTEX_CONFLICT,
    "collision": FailedValidationReason.MUTEX_CONFLICT,
}
"""UP's nearest word for the first violation, by its kind; for the others:"""
_OTHER = FailedValidationReason.UNSATISFIED_GOALS


class SampValidator(Engine, PlanValidatorMixin):
    """``PlanValidator(name="samp-validator")``: judges schedules with and without motions.

    A schedule is valid if it is so by the PDDL 2.1 reading of effects and conditions or by the
    one of Definition 3 (see ``docs/semantics.md``; ``metrics["reading"]`` says which):
    Unified Planning does not say what it means, and its own recorded plans need the second one.
    ``seconds_per_unit`` is the length of one unit of schedule time (s), by default the one that the
    plan was made with (1 where it says none).
    """

    def __init__(self, seconds_per_unit: float | None = None, **options: Any) -> None:
        Engine.__init__(self)
        PlanValidatorMixin.__init__(self)
        if options:
            raise ProblemError(f"samp-validator has no option {', '.join(sorted(options))}")
        self._seconds_per_unit = seconds_per_unit

    @property
    def name(self) -> str:
        """The engine's name."""
        return "samp-validator"

    @staticmethod
    def supported_kind() -> ProblemKind:
        """Return the features that the validator has rules for (a new object at each call)."""
        return ProblemKind([*SCHEDULES, *BESIDES], version=LATEST_PROBLEM_KIND_VERSION)

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        """Return whether problems of this kind can be judged."""
        return bool(problem_kind <= SampValidator.supported_kind())

    @staticmethod
    def supports_plan(plan_kind: PlanKind) -> bool:
        """Return whether plans of this kind can be judged."""
        return bool(plan_kind == PlanKind.SCHEDULE)

    @staticmethod
    def get_credits(**kwargs: Any) -> Credits | None:
        """Return nothing: no credits are printed for a validator."""
        return None

    def validate(self, problem: Any, plan: Any) -> ValidationResult:
        """Judge a plan as every UP validator does, also where UP cannot compute the kind."""
        from up_samp.upio.expressions import has_bare_ends

        if isinstance(problem, SchedulingProblem) and has_bare_ends(problem):
            return self._validate(problem, plan)
        result: ValidationResult = super().validate(problem, plan)
        return result

    def _validate(self, problem: Any, plan: Any) -> ValidationResult:
        from up_samp.validation import judge_plan

        if not isinstance(problem, SchedulingProblem) or not isinstance(plan, Schedule):
            raise ProblemError("samp-validator judges schedules of scheduling problems")
        motion = isinstance(problem, SchedulingMotionProblem)
        unit = self._seconds_per_unit
        if unit is None:
            unit = getattr(plan, "seconds_per_unit", 1.0)
        verdict, values = judge_plan(problem, plan, motion=motion, seconds_per_unit=unit)
        accepted = verdict.valid or verdict.definition3
        reading = "PDDL 2.1" if verdict.valid else "Definition 3" if accepted else "none"
        return ValidationResult(
            ValidationResultStatus.VALID if accepted else ValidationResultStatus.INVALID,
            self.name,
            log_messages=[LogMessage(LogLevel.INFO, str(v)) for v in verdict.violations],
            metric_evaluations=values if accepted else None,
            reason=None if accepted else _REASONS.get(verdict.violations[0].kind, _OTHER),
            metrics={"reading": reading},
        )
