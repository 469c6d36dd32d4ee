"""Half-open conditions where time is dense: what is set in their last unit is seen inside.

A condition over ``[low, high + 1)`` holds at ``high``, and also right after it. Effects of other
activities keep out of it anyway; one of its own activity, or of the problem itself, may come at
``high``. Then the condition has to hold with what that sets, which engines that know integer times
only do not ask for.
"""

from __future__ import annotations

from dataclasses import replace

from up_samp.scheduling.compilers.expressions import (
    TRUE,
    Expr,
    disjunction,
    negation,
    rewrite,
    subexpressions,
)
from up_samp.scheduling.compilers.ground import least
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, PlainProblem
from up_samp.scheduling.compilers.values import evaluate


def compile_dense(problem: PlainProblem) -> Compiled:
    """State for every effect that may come in the last unit of a half-open condition that it does
    not, or keeps it true.

    The result is not exact where what it sets cannot be told from parameters alone: there it is
    kept away.
    """
    optional = problem.optional_names()
    constraints: list[Expr] = []
    conditions: dict[Condition, None] = {}
    exact = True
    for condition in problem.conditions:
        conditions[replace(condition, dense=False)] = None
        for effect in problem.effects if condition.dense else ():
            if not _may_meet(problem, condition, effect):
                continue
            after = _after(condition.expression, effect)
            exact = exact and after is not None
            ways = [negation(("pres", o)) for o in {condition.owner, effect.owner} & optional]
            if effect.condition != TRUE:
                ways.append(negation(effect.condition))
            if any(e[0] == "flu" for e in subexpressions(effect.condition)):
                ways.pop()  # whether it holds cannot be told: as if it did
                exact = False
            ways += _at_other_times(problem, condition, effect)
            constraints.append(disjunction([*ways, *([after] if after is not None else [])]))
    every = (*problem.constraints, *(c for c in constraints if c != TRUE))
    found = replace(problem, conditions=tuple(conditions), constraints=every)
    return Compiled(found, exact=exact)


def _may_meet(problem: PlainProblem, condition: Condition, effect: Effect) -> bool:
    """Return whether an effect may come at the condition's last instant, and matters to it."""
    read = {e[1] for e in subexpressions(condition.expression) if e[0] == "flu"}
    if effect.fluent[1] not in read:
        return False
    if None not in (condition.owner, effect.owner) and condition.owner != effect.owner:
        return False
    before = least(problem, effect.time, condition.high)
    after = least(problem, condition.high, effect.time)
    return not ((before or 0) >= 1 or (after or 0) >= 1)


def _after(expression: Expr, effect: Effect) -> Expr | None:
    """Return an expression with what an effect sets; ``None`` if other fluents matter, too."""
    if effect.kind != "assign" or any(e[0] == "flu" for e in subexpressions(effect.value)):
        return None
    said = evaluate(rewrite(expression, lambda e: effect.value if e == effect.fluent else None))
    return None if any(e[0] == "flu" for e in subexpressions(said)) else said


def _at_other_times(problem: PlainProblem, condition: Condition, effect: Effect) -> list[Expr]:
    """Return the ways in which an effect is not at the last instant of a condition that asks for
    anything.
    """
    ways: list[Expr] = []
    if least(problem, condition.high, effect.time) != 0:
        ways.append(("lt", effect.time, condition.high))
    if least(problem, effect.time, condition.high) != 0:
        ways.append(("lt", condition.high, effect.time))
    span = least(problem, condition.low, condition.high)
    if span is None or span < 0:
        ways.append(("lt", condition.high, condition.low))
    return ways
