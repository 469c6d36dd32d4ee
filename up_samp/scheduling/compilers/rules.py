"""Rules about effects that UP's meaning has and engines do not always keep, said as constraints.

No effect comes before time 0. Two effects of one owner on one state variable at the same instant
clash (unless both count up or down): they cannot both happen.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import replace

from up_samp.scheduling.compilers.expressions import (
    TRUE,
    Expr,
    disjunction,
    integer,
    negation,
    subexpressions,
)
from up_samp.scheduling.compilers.plain import Compiled, Effect, PlainProblem


def compile_rules(problem: PlainProblem) -> Compiled:
    """Add the rules as constraints, as far as effects can break them."""
    optional = problem.optional_names()
    constraints: list[Expr] = []
    by_instant: dict[tuple[Expr, Expr], list[Effect]] = defaultdict(list)
    for effect in problem.effects:
        by_instant[effect.time, effect.fluent].append(effect)
        if effect.time[3] < 0:
            absent = [negation(("pres", effect.owner))] if effect.owner in optional else []
            constraints.append(disjunction([*absent, ("le", integer(0), effect.time)]))
    for effects in by_instant.values():
        for a, b in itertools.combinations(effects, 2):
            counted = a.kind != "assign" and b.kind != "assign"
            certain = not (_timed_by_state(a) or _timed_by_state(b))
            if certain and not counted and a.owner == b.owner:
                constraints.append(disjunction([*_idle(a, optional), *_idle(b, optional)]))
    if not constraints:
        return Compiled(problem)
    return Compiled(replace(problem, constraints=(*problem.constraints, *constraints)))


def _timed_by_state(effect: Effect) -> bool:
    """Return whether the effect happens or not depending on fluents."""
    return any(e[0] == "flu" for e in subexpressions(effect.condition))


def _idle(effect: Effect, optional: frozenset[str]) -> list[Expr]:
    """Return the ways in which the effect does not happen."""
    ways = [] if effect.condition == TRUE else [negation(effect.condition)]
    return [*ways, negation(("pres", effect.owner))] if effect.owner in optional else ways
