"""Fluents with constant arguments become fluents without any; what nothing changes, its value.

``robot_at(r0)`` and ``robot_at(r1)`` are different state variables from the start, so later passes
(and engines) need not ask whether they are the same.
"""

from __future__ import annotations

from dataclasses import replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.expressions import (
    FALSE,
    TRUE,
    Expr,
    conjunction,
    disjunction,
    later,
    negation,
    rewrite,
    show,
    subexpressions,
)
from up_samp.scheduling.compilers.fresh import fresh, names_in_use
from up_samp.scheduling.compilers.plain import (
    Activity,
    Compiled,
    Condition,
    Effect,
    Fluent,
    PlainProblem,
)
from up_samp.scheduling.compilers.values import evaluate


def compile_ground(problem: PlainProblem) -> Compiled:
    """Return the problem over ground fluents where all arguments are constants, without fluents
    that never change.

    Raises:
        UnsupportedError: a duration that reads a fluent which effects change, or one of parameters.
    """
    fluents = _fluent_expressions(problem)
    open_names = {e[1] for e in fluents if any(a[0] not in ("obj", "int", "bool") for a in e[2:])}
    changed = {e.fluent[1] if e.fluent[1] in open_names else e.fluent for e in problem.effects}
    taken = names_in_use(problem)
    replaced: dict[Expr, Expr] = {}
    ground: dict[str, Fluent] = {n: problem.fluents[n] for n in sorted(open_names)}
    for fluent in fluents:
        if fluent[1] in open_names:
            continue
        if fluent not in changed:
            replaced[fluent] = problem.initial_value(fluent)
        elif len(fluent) == 2:
            ground[fluent[1]] = replace(
                problem.fluents[fluent[1]], default=problem.initial_value(fluent)
            )
        else:
            name = fresh(show(fluent), taken)
            replaced[fluent] = ("flu", name)
            declared = problem.fluents[fluent[1]]
            ground[name] = Fluent(declared.type, (), problem.initial_value(fluent))
    compiled = _Rewriter(replaced).problem(problem, ground, open_names)
    for activity in compiled.activities:
        _refuse_fluents(activity, {e.fluent[1] for e in problem.effects})
    return Compiled(compiled)


def _refuse_fluents(activity: Activity, changed: set[str]) -> None:
    """Raise ``UnsupportedError`` if the duration reads a fluent (those of constants that effects
    never change have been replaced).
    """
    for bound in (activity.lower, activity.upper):
        for expression in subexpressions(bound):
            if expression[0] == "flu":
                what = f"the duration of {activity.name} reads the fluent {show(expression)}"
                why = "which effects change" if expression[1] in changed else "with its parameters"
                raise UnsupportedError(f"{what}, {why}")


def _fluent_expressions(problem: PlainProblem) -> list[Expr]:
    """Return every fluent expression of the problem once, in order of appearance."""
    places = [*problem.constraints]
    for activity in problem.activities:
        places += [activity.lower, activity.upper]
    places += [c.expression for c in problem.conditions]
    for effect in problem.effects:
        places += [effect.fluent, effect.value, effect.condition]
    found: dict[Expr, None] = {}
    for place in places:
        found.update((e, None) for e in subexpressions(place) if e[0] == "flu")
    return list(found)


class _Rewriter:
    def __init__(self, replaced: dict[Expr, Expr]):
        self.replaced = replaced

    def __call__(self, expression: Expr) -> Expr:
        return evaluate(rewrite(expression, self.replaced.get))

    def problem(
        self, problem: PlainProblem, fluents: dict[str, Fluent], kept: set[str]
    ) -> PlainProblem:
        conditions: list[Condition] = []
        constraints = [self(c) for c in problem.constraints]
        for condition in problem.conditions:
            said = rewrite(condition.expression, self.replaced.get)
            expression = evaluate(said)
            # what decides nothing still keeps others' effects away
            idle = dict.fromkeys(e for e in subexpressions(said) if e[0] == "flu")
            idle = {f: None for f in idle if f not in set(subexpressions(expression))}
            conditions += [replace(condition, expression=("eq", f, f)) for f in idle]
            if any(e[0] == "flu" for e in subexpressions(expression)):
                conditions.append(replace(condition, expression=expression))
            else:
                constraints.append(_timeless(problem, condition, expression))
        return replace(
            problem,
            activities=tuple(self._activity(a) for a in problem.activities),
            constraints=tuple(c for c in constraints if c != TRUE),
            conditions=tuple(conditions),
            effects=tuple(e for e in map(self._effect, problem.effects) if e.condition != FALSE),
            fluents=fluents,
            initial={k: v for k, v in problem.initial.items() if k[1] in kept},
        )

    def _activity(self, a: Activity) -> Activity:
        return replace(a, lower=self(a.lower), upper=self(a.upper))

    def _effect(self, e: Effect) -> Effect:
        return replace(e, fluent=self(e.fluent), value=self(e.value), condition=self(e.condition))


def _timeless(problem: PlainProblem, condition: Condition, expression: Expr) -> Expr:
    """Return the constraint that a condition without fluents amounts to: it holds, or its owner
    is absent, or its interval empty.
    """
    if expression == TRUE:
        return TRUE
    ways = [] if expression == FALSE else [expression]
    if condition.owner in problem.optional_names():
        ways.append(negation(("pres", condition.owner)))
    if not never_empty(problem, condition):
        ways.append(empty(problem, condition))
    return disjunction(ways)


def never_empty(problem: PlainProblem, condition: Condition) -> bool:
    """Return whether the condition's interval is certain to hold an instant."""
    low, high = condition.low, condition.high
    if high[1] == "horizon" and low[1] != "horizon":
        high = later(high, 1)  # in conditions the plan's end comes after all ends and effects
    gap = least(problem, low, high)
    return gap is not None and gap >= 0


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


def empty(problem: PlainProblem, condition: Condition) -> Expr:
    """Return the constraint that the condition's interval holds no instant.

    In conditions the plan's end is one after the last of all ends and effects, not the makespan.
    """
    low, high = condition.low, condition.high
    if high[1] != "horizon" or low[1] == "horizon":
        return ("lt", high, low)
    optional = problem.optional_names()
    early = [("lt", later(high, 1), low)]
    for effect in problem.effects:
        absent = [negation(("pres", effect.owner))] if effect.owner in optional else []
        if effect.condition != TRUE:
            absent.append(negation(effect.condition))
        early.append(disjunction([*absent, ("lt", later(effect.time, 1 + high[3]), low)]))
    return conjunction(early)
