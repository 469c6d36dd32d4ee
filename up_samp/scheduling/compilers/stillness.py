"""Conditions that only keep others away, and conditions that another one implies.

A condition that every value satisfies (``f = f``) still keeps the effects of other activities on
``f`` out of its interval. That is said by differences, which spares engines a supporter.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from up_samp.scheduling.compilers.expressions import (
    TRUE,
    Expr,
    disjunction,
    later,
    negation,
    subexpressions,
)
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, PlainProblem


def compile_stillness(problem: PlainProblem) -> Compiled:
    """Turn tautologies over a fluent without arguments into constraints; drop conditions over
    a part of the interval of an equal one.
    """
    effects: dict[Expr, list[Effect]] = defaultdict(list)
    for effect in problem.effects:
        effects[effect.fluent].append(effect)
    optional = problem.optional_names()
    constraints: list[Expr] = []
    conditions: dict[Condition, None] = {}
    for condition in problem.conditions:
        fluent = _still(condition)
        if fluent is None:
            conditions[condition] = None
        else:
            constraints += [
                outside(condition, e, optional)
                for e in effects[fluent]
                if e.owner is not None and condition.owner not in (None, e.owner)
            ]
    return Compiled(
        replace(
            problem,
            conditions=tuple(_without_implied(list(conditions))),
            constraints=(*problem.constraints, *constraints),
        )
    )


def compile_apart(problem: PlainProblem) -> Compiled:
    """Say by differences, for every condition, that effects of other activities stay out of its
    interval: for engines that sometimes let one coincide with an end of it (quadratic).
    """
    optional = problem.optional_names()
    constraints = [
        outside(condition, effect, optional)
        for condition in problem.conditions
        for effect in problem.effects
        if effect.fluent in set(subexpressions(condition.expression))
        and effect.owner is not None
        and condition.owner not in (None, effect.owner)
    ]
    return Compiled(replace(problem, constraints=(*problem.constraints, *constraints)))


def _still(condition: Condition) -> Expr | None:
    """Return the fluent if the condition says ``f = f`` (or ``f or not f``), else ``None``."""
    expression = condition.expression
    if expression[0] in ("eq", "iff", "le") and expression[1] == expression[2]:
        fluent: Expr = expression[1]
    elif expression[0] == "or" and len(expression) == 3:
        a, b = expression[1:]
        if negation(a) != b:
            return None
        fluent = a[1] if a[0] == "not" else a
    else:
        return None
    return fluent if fluent[0] == "flu" and len(fluent) == 2 else None


def outside(condition: Condition, effect: Effect, optional: frozenset[str]) -> Expr:
    """State that the effect does not happen within the interval (always, if that is empty)."""
    owners = (condition.owner, effect.owner)
    ways: list[Expr] = [negation(("pres", owner)) for owner in owners if owner in optional]
    if effect.condition != TRUE and all(s[0] != "flu" for s in subexpressions(effect.condition)):
        ways.append(negation(effect.condition))
    before = ("le", later(effect.time, 1), condition.low)
    after = ("le", later(condition.high, 1), effect.time)
    return disjunction([*ways, before, after])


def _without_implied(conditions: list[Condition]) -> list[Condition]:
    by_content: dict[tuple[str | None, Expr], list[Condition]] = defaultdict(list)
    for condition in conditions:
        by_content[condition.owner, condition.expression].append(condition)
    return [
        c
        for c in conditions
        if not any(_inside(c, d) for d in by_content[c.owner, c.expression] if d is not c)
    ]


def _inside(c: Condition, d: Condition) -> bool:
    """Return whether the interval of ``c`` is surely a part of that of ``d``."""
    if c.low == d.low and c.high == d.high:
        return False  # the same (kept once, as conditions are a set here)
    begins = c.low == d.low or (c.low[:3] == d.low[:3] and c.low[3] >= d.low[3])
    ends = c.high[:3] == d.high[:3] and c.high[3] <= d.high[3]
    point = c.low == c.high and c.low[1] == "start" and d.high[1:3] == ("end", c.low[2])
    return begins and (ends or (point and d.high[3] >= c.high[3]))
