"""Products with constants away, for engines that only add: ``3 * n`` becomes ``n + n + n``."""

from __future__ import annotations

from dataclasses import replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.expressions import Expr, integer, rewrite, show
from up_samp.scheduling.compilers.limits import LIMITS
from up_samp.scheduling.compilers.plain import Activity, Compiled, Condition, Effect, PlainProblem


def compile_products(problem: PlainProblem) -> Compiled:
    """Return the problem without products.

    Raises:
        UnsupportedError: a product of two things that are not constants, or with a large constant.
    """
    return Compiled(
        replace(
            problem,
            activities=tuple(map(_activity, problem.activities)),
            constraints=tuple(map(_sums, problem.constraints)),
            conditions=tuple(map(_condition, problem.conditions)),
            effects=tuple(map(_effect, problem.effects)),
        )
    )


def _activity(a: Activity) -> Activity:
    return replace(a, lower=_sums(a.lower), upper=_sums(a.upper))


def _condition(c: Condition) -> Condition:
    return replace(c, expression=_sums(c.expression))


def _effect(e: Effect) -> Effect:
    return replace(e, value=_sums(e.value), condition=_sums(e.condition))


def _sums(expression: Expr) -> Expr:
    return rewrite(expression, _sum)


def _sum(expression: Expr) -> Expr | None:
    """Return a product as a sum; ``None`` if it is none."""
    if expression[0] != "times":
        return None
    constant, others = 1, []
    for factor in map(_sums, expression[1:]):
        if factor[0] == "int":
            constant *= factor[1]
        else:
            others.append(factor)
    if constant == 0 or not others:
        return integer(constant)
    if len(others) > 1 or abs(constant) > LIMITS.factor:
        raise UnsupportedError(f"the product {show(expression)}")
    total = others[0] if abs(constant) == 1 else ("plus", *others * abs(constant))
    return total if constant > 0 else ("minus", integer(0), total)
