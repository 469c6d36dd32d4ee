"""Fluents of real types as whole numbers: by what their values are multiplied."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import UnsupportedError
from up_samp.scheduling.cpsat.encode.durations import MAGNITUDE


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
