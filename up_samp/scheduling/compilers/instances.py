"""Fluents with parameters to ground ones, by cases over the values of the arguments.

An effect on ``f(p)`` becomes one effect on ``f(o)`` for every value ``o`` of ``p``, that happens if
``p = o``; a condition becomes one for every choice of values, that holds if the choice is another.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.expressions import (
    Expr,
    conjunction,
    disjunction,
    negation,
    rewrite,
    show,
    subexpressions,
)
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, PlainProblem
from up_samp.scheduling.compilers.values import evaluate, values_of


def compile_instances(problem: PlainProblem) -> Compiled:
    """Expand conditions and effects over the parameters in arguments of fluents."""
    conditions: list[Condition] = []
    for condition in problem.conditions:
        for guard, put in _choices(problem, [condition.expression]):
            chosen = evaluate(rewrite(condition.expression, put))
            expression = disjunction([negation(guard), chosen])
            conditions.append(replace(condition, expression=expression))
    effects: list[Effect] = []
    for effect in problem.effects:
        parts = [effect.fluent, effect.value, effect.condition]
        for guard, put in _choices(problem, parts):
            fluent, value, given = (evaluate(rewrite(e, put)) for e in parts)
            effects.append(
                replace(effect, fluent=fluent, value=value, condition=conjunction([guard, given]))
            )
    for constraint in problem.constraints:
        if any(e[0] == "flu" and len(e) > 2 for e in subexpressions(constraint)):
            raise UnsupportedError(f"the constraint over fluents {show(constraint)}")
    return Compiled(replace(problem, conditions=tuple(conditions), effects=tuple(effects)))


def _choices(problem: PlainProblem, expressions: list[Expr]) -> Iterator[tuple[Expr, _Put]]:
    """Yield each choice of values for the parameters in arguments of fluents: a guard that says
    it is taken, and the substitution.
    """
    types = problem.parameter_types()
    open_parameters: dict[Expr, None] = {}
    for expression in expressions:
        for fluent in (e for e in subexpressions(expression) if e[0] == "flu"):
            for argument in fluent[2:]:
                if argument[0] == "par":
                    open_parameters[argument] = None
                elif argument[0] not in ("obj", "int", "bool"):
                    raise UnsupportedError(f"the nested fluent {show(fluent)}")
    domains = [values_of(problem, types[p[1]]) for p in open_parameters]
    for choice in itertools.product(*domains):
        values = dict(zip(open_parameters, choice, strict=True))
        yield conjunction(equals(p, v) for p, v in values.items()), _Put(values)


def equals(variable: Expr, value: Expr) -> Expr:
    """Return ``variable = value`` for a constant value."""
    if value[0] == "bool":
        return variable if value[1] else negation(variable)
    return ("eq", variable, value)


class _Put:
    """Replaces parameters by values, everywhere."""

    def __init__(self, values: dict[Expr, Expr]):
        self.values = values

    def __call__(self, expression: Expr) -> Expr | None:
        return self.values.get(expression)
