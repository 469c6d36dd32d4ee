"""Durations, constants and fractions as whole numbers, and how large these may be."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import DurationInterval

from up_samp.model import UnsupportedError
from up_samp.upio.expressions import whole_bounds

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
    lower, upper = whole_bounds(duration)
    return (
        None if lower is None else max(0, lower),
        None if upper is None else min(upper, LARGEST),
    )


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


# ------------------ Fluents of real types: by what their values are multiplied


def scales_of(problem: Any) -> dict[str, int]:
    """Return for each fluent of a real type by what its values are multiplied, to be whole numbers
    whatever happens.

    :raises UnsupportedError: where no number does, or only a huge one.
    """
    real = {f.name: f for f in problem.fluents if f.type.is_real_type()}
    scales = dict.fromkeys(real, 1)
    if not real:
        return {}
    for fluent, value in problem.fluents_defaults.items():
        if fluent.name in real:
            _multiply(scales, fluent.name, value)
    for fluent, value in problem.explicit_initial_values.items():
        if fluent.fluent().name in real:
            _multiply(scales, fluent.fluent().name, value)
    effects = [e for _, e, _ in problem.all_effects() if e.fluent.fluent().name in real]
    for _ in range(len(real) + 1):
        before = dict(scales)
        for effect in effects:
            _multiply(scales, effect.fluent.fluent().name, effect.value)
        if scales == before:
            return scales
    name = next(n for n in scales if scales[n] != before[n])
    raise UnsupportedError(
        f"cpsat counts in whole numbers, and '{name}' takes ever finer fractions"
    )


def _multiply(scales: dict[str, int], name: str, value: FNode) -> None:
    scales[name] = math.lcm(scales[name], denominator(value, scales))
    if scales[name] > MAGNITUDE:
        raise UnsupportedError(
            f"cpsat counts in whole numbers, and '{name}' has too fine fractions"
        )


def denominator(node: FNode, scales: dict[str, int]) -> int:
    """Return a number by which the value of an expression is whole."""
    kind = node.node_type
    if kind is Op.REAL_CONSTANT:
        return Fraction(node.constant_value()).denominator
    if kind is Op.FLUENT_EXP:
        return scales.get(node.fluent().name, 1)
    parts = [denominator(arg, scales) for arg in node.args]
    if kind in (Op.PLUS, Op.MINUS):
        return math.lcm(*parts)
    if kind is Op.TIMES:
        return math.prod(parts)
    if kind is Op.DIV and node.arg(1).is_constant():
        by = Fraction(node.arg(1).constant_value())
        return parts[0] * abs(by.numerator)
    if kind is Op.TIMING_EXP:
        return Fraction(node.timing().delay).denominator
    return 1
