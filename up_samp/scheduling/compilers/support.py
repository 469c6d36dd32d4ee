"""Where engines ask for one supporter and the meaning of a condition does not.

Engines with fluents (and the formulas that stand for them) want one effect, or the initial value,
to support a condition over the whole of its interval. Effects of other activities stay out of
it anyway, but an effect of the condition's own activity, or one between a condition and an effect
of which one belongs to the problem itself, may give the fluent another right value, or the same
one again, halfway. Such conditions are asked for at the start of their interval, and of what each
such effect within leaves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from up_samp.scheduling.compilers.expressions import (
    TRUE,
    Expr,
    disjunction,
    later,
    negation,
    rewrite,
    subexpressions,
)
from up_samp.scheduling.compilers.ground import least, never_empty
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, PlainProblem
from up_samp.scheduling.compilers.stillness import outside
from up_samp.scheduling.compilers.values import evaluate


def compile_support(problem: PlainProblem) -> Compiled:
    """State conditions that effects may renew so that one supporter each loses nothing; likewise
    those over an interval that relate several fluents, which engines take for several conditions.

    The result is not exact where an interval may be empty, and where what an effect leaves hangs
    on other fluents and on whether it comes within.
    """
    conditions: list[Condition] = []
    constraints: list[Expr] = []
    exact = True
    for condition in _conjuncts(problem.conditions):
        behind = least(problem, condition.high, condition.low)
        if behind is not None and behind > 0:
            continue  # over nothing
        read = {f[1] for f in _fluents(condition.expression)}
        near = [e for e in problem.effects if e.fluent[1] in read]
        instant = behind == 0  # or nothing
        renewed = not instant and any(
            _own(condition, e) and _renews(problem, condition, e) for e in near
        )
        wanted = renewed or (len(read) > 1 and not instant)
        said = _effect_by_effect(problem, condition, near) if wanted else None
        if said is None:
            exact = exact and not renewed
            conditions.append(condition)
        else:
            conditions += said[0]
            constraints += said[1]
    every = (*problem.constraints, *(c for c in constraints if c != TRUE))
    found = replace(problem, conditions=tuple(dict.fromkeys(conditions)), constraints=every)
    return Compiled(found, exact=exact)


def _conjuncts(conditions: Iterable[Condition]) -> Iterator[Condition]:
    for condition in conditions:
        whole = condition.expression
        for part in whole[1:] if whole[0] == "and" else (whole,):
            yield replace(condition, expression=part)


def _own(condition: Condition, effect: Effect) -> bool:
    """Return whether the effect may come within the interval of the condition at all."""
    return None in (condition.owner, effect.owner) or condition.owner == effect.owner


def _effect_by_effect(
    problem: PlainProblem, condition: Condition, effects: list[Effect]
) -> tuple[list[Condition], list[Expr]] | None:
    """Return conditions at instants, and constraints, that say the same as a condition over an
    interval, given all effects on what it reads; ``None`` where these cannot say it.
    """
    low, high, optional = condition.low, condition.high, problem.optional_names()
    flat = all(len(f) == 2 for f in (*_fluents(condition.expression), *(e.fluent for e in effects)))
    before_the_end = high[1] == "horizon" and high[3] < 0
    if not flat or before_the_end or not never_empty(problem, condition):
        return None
    conditions = [replace(condition, high=low)]
    constraints: list[Expr] = []
    for effect in effects:
        if not _own(condition, effect):
            constraints.append(outside(condition, effect, optional))
            continue
        since, until = least(problem, low, effect.time), least(problem, effect.time, high)
        if effect.kind != "assign" or _fluents(effect.value) or _fluents(effect.condition):
            return None
        after = evaluate(rewrite(condition.expression, {effect.fluent: effect.value}.get))
        ways = [negation(("pres", o)) for o in {condition.owner, effect.owner} & optional]
        ways += [negation(effect.condition), ("lt", effect.time, low)]
        if high[1] != "horizon":  # which comes after all effects
            ways.append(("le", high, effect.time))
        if not _fluents(after):
            constraints.append(disjunction([*ways, after]))
        elif since is None or since < 0 or until is None or until < 1:
            return None
        elif effect.owner not in (None, condition.owner):
            return None  # which may be absent
        else:
            then = later(effect.time, 1)
            conditions.append(replace(condition, low=then, high=then))
    return conditions, constraints


def _fluents(expression: Expr) -> list[Expr]:
    return [e for e in subexpressions(expression) if e[0] == "flu"]


def _renews(problem: PlainProblem, condition: Condition, effect: Effect) -> bool:
    """Return whether the effect may come within the interval and keep the condition true."""
    if _breaks(condition, effect):
        return False
    before = least(problem, effect.time, condition.low)
    after = least(problem, condition.high, effect.time)
    return not ((before is not None and before >= 1) or (after is not None and after >= 0))


def _breaks(condition: Condition, effect: Effect) -> bool:
    """Return whether the condition asks for a constant other than the effect's."""
    expression = condition.expression
    if effect.kind != "assign" or expression[0] != "eq":
        return False
    wanted = [e for e in expression[1:] if e != effect.fluent]
    constants = ("obj", "int", "bool")
    if len(wanted) != 1 or wanted[0][0] not in constants or effect.value[0] not in constants:
        return False
    return bool(wanted[0] != effect.value)
