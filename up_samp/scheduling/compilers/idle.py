"""Values with which an absent activity asks nothing: of its parameters, and of private copies."""

from __future__ import annotations

import itertools

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.expressions import (
    TRUE,
    Expr,
    Type,
    integer,
    rewrite,
    show,
    subexpressions,
)
from up_samp.scheduling.compilers.plain import Condition, PlainProblem
from up_samp.scheduling.compilers.values import evaluate, values_of


def touched_fluents(problem: PlainProblem, optional: frozenset[str]) -> set[str]:
    """Return the fluents that optional activities, and effects with conditions, read or write."""
    touched = {e.fluent[1] for e in problem.effects if e.owner in optional or e.condition != TRUE}
    for condition in problem.conditions:
        if condition.owner in optional:
            touched.update(e[1] for e in subexpressions(condition.expression) if e[0] == "flu")
    return touched


def ground_fluents(problem: PlainProblem, fluents: set[str]) -> list[Expr]:
    """Return all ground expressions of these fluents."""
    ground = []
    for name in sorted(fluents):
        domains = [values_of(problem, t) for _, t in problem.fluents[name].parameters]
        ground += [("flu", name, *choice) for choice in itertools.product(*domains)]
    return ground


def some_value(problem: PlainProblem, tpe: Type) -> Expr:
    """Return any value of a type."""
    if tpe[0] == "int":
        return integer(tpe[1] if tpe[1] is not None else tpe[2] if tpe[2] is not None else 0)
    return values_of(problem, tpe)[0]


def idle_values(problem: PlainProblem, owner: str) -> dict[Expr, Expr]:
    """Return values that the parameters of an absent activity may take so that all its conditions
    hold on private copies. Nothing else asks anything of them then.
    """
    conditions = [c for c in problem.conditions if c.owner == owner]
    used = {e: e for c in conditions for e in subexpressions(c.expression) if e[0] == "par"}
    types = problem.parameter_types()
    finite = [(p, types[p[1]]) for p in used]
    finite = [(p, t) for p, t in finite if t[0] != "int" or None not in t[1:]]
    domains = [values_of(problem, t) for _, t in finite]
    for choice in itertools.islice(itertools.product(*domains), 10_000):
        values = dict(zip((p for p, _ in finite), choice, strict=True))
        if all(wished_values(problem, c, values) is not None for c in conditions):
            return values
    shown = ", ".join(show(c.expression) for c in conditions)
    raise UnsupportedError(
        f"the conditions of optional activity {owner} ({shown}): no values of its fluents and "
        "parameters are known to satisfy them"
    )


def wished_values(
    problem: PlainProblem, condition: Condition, idle: dict[Expr, Expr]
) -> dict[Expr, Expr] | None:
    """Return values of the fluents with which the condition holds if the parameters have their
    ``idle`` values, whatever others do; None where none are known.
    """
    atoms = [e for e in subexpressions(condition.expression) if e[0] == "flu"]
    distinct = list(dict.fromkeys(atoms))
    expression = condition.expression
    domains = [_candidates(problem, expression, atom) for atom in distinct]
    for choice in itertools.islice(itertools.product(*domains), 100_000):
        values = dict(zip(distinct, choice, strict=True))
        if evaluate(rewrite(rewrite(expression, values.get), idle.get)) == TRUE:
            return values
    return None


def _candidates(problem: PlainProblem, expression: Expr, atom: Expr) -> list[Expr]:
    tpe = problem.fluents[atom[1]].type
    if tpe[0] != "int":
        return values_of(problem, tpe)
    numbers = {e[1] + d for e in subexpressions(expression) if e[0] == "int" for d in (-1, 0, 1)}
    numbers |= {0} | {bound for bound in tpe[1:] if bound is not None}
    low, high = tpe[1], tpe[2]
    inside = [
        n for n in sorted(numbers) if (low is None or low <= n) and (high is None or n <= high)
    ]
    return [integer(n) for n in inside]
