"""An independent judge of plans.

It shares no map reading, collision checking, timing or scheduling code with the planners: what it
accepts was found right twice. The rules are stated in ``docs/semantics.md``.
"""

from up_samp.model.violation import Violation
from up_samp.validation.plan import judge_plan, validate_plan
from up_samp.validation.schedule import Verdict, ranked, terms_of, validate_schedule, value_of

__all__ = [
    "Verdict",
    "Violation",
    "judge_plan",
    "ranked",
    "terms_of",
    "validate_plan",
    "validate_schedule",
    "value_of",
]
