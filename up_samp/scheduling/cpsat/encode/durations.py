"""Durations and constants as integers (schedule units), and how large these may be."""

from __future__ import annotations

import math
from fractions import Fraction

from unified_planning.model import FNode
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import DurationInterval

from up_samp.model import UnsupportedError

MAGNITUDE = 10**9
"""Largest magnitude of an integer variable that the problem does not bound."""
LARGEST = 2**50
"""Largest number that a problem may name; sums of many have to fit into 63 bits."""
PLACEHOLDER = 10**7
"""Latest time of variables until the horizon is known."""
INFINITE = 10**12
"""Longer than anything: what cannot be."""


def constant_bounds(duration: DurationInterval) -> tuple[int | None, int | None]:
    """Return the least and greatest integer duration, ``None`` where it is not constant."""
    lower = upper = None
    if duration.lower.is_constant():
        value = Fraction(duration.lower.constant_value())
        lower = -(-value.numerator // value.denominator)
        if duration.is_left_open() and lower == value:
            lower += 1
        lower = max(0, lower)
    if duration.upper.is_constant():
        value = Fraction(duration.upper.constant_value())
        upper = value.numerator // value.denominator
        if duration.is_right_open() and upper == value:
            upper -= 1
        upper = min(upper, LARGEST)
    return lower, upper


def check_duration(activity: Activity) -> None:
    """Refuse a duration that whole numbers cannot tell: times are counted in units.

    :raises UnsupportedError: if there are durations, but no whole ones, or it is too long.
    """
    duration = activity.duration
    lower, upper = constant_bounds(duration)
    if lower is None or upper is None:
        return
    if lower > LARGEST:
        raise UnsupportedError(
            f"activity '{activity.name}' lasts {duration.lower} units and more; "
            f"cpsat counts to {LARGEST}"
        )
    if lower > upper and Fraction(duration.upper.constant_value()) > 0:
        raise UnsupportedError(
            f"cpsat plans in whole units, and the duration of activity '{activity.name}', "
            f"{duration}, holds no whole number: choose a smaller unit for all times"
        )


def least(duration: DurationInterval) -> int:
    """Return the least integer duration (0 where it is not constant)."""
    return constant_bounds(duration)[0] or 0


def constants(node: FNode) -> int:
    """Return the sum of the magnitudes of the constants in ``node``."""
    if node.is_int_constant():
        return abs(int(node.constant_value()))
    if node.is_real_constant():
        return math.ceil(abs(node.constant_value()))
    if node.is_timing_exp():
        return int(abs(node.timing().delay)) + 1
    return sum(constants(a) for a in node.args)
