"""An independent judge of plans.

It shares no map reading, collision checking, timing or scheduling code with the planners: what it
accepts was found right twice. ``semantics.py`` beside this file states the rules for schedules.
"""

from up_samp.validation.schedule import validate_schedule
from up_samp.validation.verdict import Verdict, Violation

__all__ = ["Verdict", "Violation", "validate_schedule"]
