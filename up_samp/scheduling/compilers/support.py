"""Where engines ask for one supporter and the meaning of a condition does not.

Engines with fluents (and the formulas that stand for them) want one effect, or the initial value,
to support a condition over the whole of its interval. Effects of other activities stay out of
it anyway, but an effect of the condition's own activity, or one between a condition and an effect
of which one belongs to the problem itself, may give the fluent another right value, or the same
one again, halfway. Such schedules are lost.
"""

from __future__ import annotations

from collections import defaultdict

from up_samp.scheduling.compilers.expressions import Expr, subexpressions
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, PlainProblem


def compile_support(problem: PlainProblem) -> Compiled:
    """Return the problem as it is, and whether one supporter each loses nothing."""
    effects: dict[str | None, list[Effect]] = defaultdict(list)
    for effect in problem.effects:
        effects[effect.owner].append(effect)
    for condition in problem.conditions:
        if condition.low == condition.high:
            continue
        read = {e[1] for e in subexpressions(condition.expression) if e[0] == "flu"}
        owners = list(effects) if condition.owner is None else [condition.owner, None]
        near = (e for owner in owners for e in effects.get(owner, ()) if e.fluent[1] in read)
        if any(_renews(problem, condition, e) for e in near):
            return Compiled(problem, exact=False)
    return Compiled(problem)


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


def least(problem: PlainProblem, early: Expr, late: Expr) -> int | None:
    """Return a lower bound on ``late - early`` (``None``: nothing is known)."""
    (_, first, a, before), (_, second, b, after) = early, late
    gap = int(after - before)
    if (first, a) == (second, b) or first == "zero":
        return gap
    if second == "horizon" and a is not None:
        return gap + (_lower(problem, a) if first == "start" else 0)
    if a is None or a != b:
        return None
    if first == "start":
        return gap + _lower(problem, a)
    upper = problem.activity(a).upper
    return gap - int(upper[1]) if upper[0] == "int" else None


def _lower(problem: PlainProblem, activity: str) -> int:
    lower = problem.activity(activity).lower
    return int(lower[1]) if lower[0] == "int" else 0
