"""Numbers to objects: bounded integer fluents that are only assigned, for engines that take no
conditions on numbers over intervals.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.expressions import (
    Expr,
    disjunction,
    rewrite,
    show,
    subexpressions,
)
from up_samp.scheduling.compilers.fresh import fresh, names_in_use
from up_samp.scheduling.compilers.limits import LIMITS
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, PlainProblem
from up_samp.scheduling.compilers.values import evaluate


def compile_numbers(problem: PlainProblem) -> Compiled:
    """Turn integer fluents (without arguments) that conditions read into object fluents.

    Raises:
        UnsupportedError: a fluent that is both assigned and increased or decreased; one that
            conditions read over an interval and that is counted, or assigned something else
            than constants.
    """
    numbers = _numbers(problem)
    if not numbers:
        return Compiled(problem)
    taken = names_in_use(problem)
    types, objects, fluents = dict(problem.types), dict(problem.objects), dict(problem.fluents)
    names: dict[Expr, dict[int, str]] = {}
    for fluent in numbers:
        _, low, high = problem.fluents[fluent[1]].type
        kind = fresh(f"Number_{fluent[1]}", taken)
        types[kind] = None
        names[fluent] = {n: fresh(f"{fluent[1]}_{n}", taken) for n in range(low, high + 1)}
        objects.update(dict.fromkeys(names[fluent].values(), kind))
        initial = problem.initial_value(fluent)
        fluents[fluent[1]] = replace(
            fluents[fluent[1]], type=("user", kind), default=("obj", names[fluent][initial[1]])
        )
    written = {f[1] for f in numbers}
    return Compiled(
        replace(
            problem,
            conditions=tuple(_condition(c, names) for c in problem.conditions),
            effects=tuple(_effect(e, names) for e in problem.effects),
            types=types,
            objects=objects,
            fluents=fluents,
            initial={k: v for k, v in problem.initial.items() if k[1] not in written},
        )
    )


def _numbers(problem: PlainProblem) -> list[Expr]:
    """Return the integer fluents to convert: those that a condition reads over an interval."""
    changes: dict[str, list[Effect]] = defaultdict(list)
    for effect in problem.effects:
        changes[effect.fluent[1]].append(effect)
    for name, effects in changes.items():
        if len({e.kind == "assign" for e in effects}) > 1:
            raise UnsupportedError(f"fluent {name}, both assigned and counted")
    found: dict[Expr, None] = {}
    for condition in problem.conditions:
        fluents = [e for e in subexpressions(condition.expression) if e[0] == "flu"]
        for fluent in fluents:
            _, low, high = (*problem.fluents[fluent[1]].type, None, None)[:3]
            if problem.fluents[fluent[1]].type[0] != "int" or len(fluent) > 2:
                continue
            counted = any(e.kind != "assign" for e in changes[fluent[1]])
            if counted and condition.low == condition.high:
                continue
            constant = all(e.value[0] == "int" for e in changes[fluent[1]])
            if counted or not constant or low is None or high is None or high - low > LIMITS.values:
                raise UnsupportedError(
                    f"the condition {show(condition.expression)} over an interval on the number "
                    f"{show(fluent)}, which is counted, unbounded or not assigned constants"
                )
            found[fluent] = None
    return list(found)


def _condition(condition: Condition, names: dict[Expr, dict[int, str]]) -> Condition:
    def leaf(e: Expr) -> Expr | None:
        if e[0] not in ("eq", "le", "lt"):
            return None
        fluents = {s for s in subexpressions(e) if s in names}
        if not fluents:
            return None
        if len(fluents) > 1 or any(s[0] == "par" for s in subexpressions(e)):
            raise UnsupportedError(f"the condition {show(e)}, which relates several numbers")
        (fluent,) = fluents
        right = [
            ("eq", fluent, ("obj", name))
            for n, name in names[fluent].items()
            if evaluate(rewrite(e, {fluent: ("int", n)}.get)) == ("bool", True)
        ]
        return disjunction(right)

    return replace(condition, expression=rewrite(condition.expression, leaf))


def _effect(effect: Effect, names: dict[Expr, dict[int, str]]) -> Effect:
    if effect.fluent not in names:
        return effect
    # a value outside the bounds is never right: the effect's activity could not be present
    name = names[effect.fluent].get(effect.value[1])
    if name is None:
        raise UnsupportedError(f"the assignment of {effect.value[1]} to {show(effect.fluent)}")
    return replace(effect, value=("obj", name))
