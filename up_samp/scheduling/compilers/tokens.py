"""Cliques of disjunctions to tokens, for engines with object fluents: linear, not quadratic.

A token is a state variable whose value names an activity. Each member of the clique takes it at
its start and needs it unchanged while it runs: over ``[start + 1, end - 1 + gap]``. Another member
then cannot start in between, and two cannot start at one instant, as their effects would meet.
"""

from __future__ import annotations

from dataclasses import replace

from up_samp.scheduling.compilers.cliques import Clique, find_cliques, pairs_of
from up_samp.scheduling.compilers.expressions import Expr, end, start
from up_samp.scheduling.compilers.fresh import fresh, names_in_use
from up_samp.scheduling.compilers.plain import Compiled, Condition, Effect, Fluent, PlainProblem


def compile_tokens(problem: PlainProblem) -> Compiled:
    """Replace the disjunctions (in normal form) of each clique by a token.

    Only activities take part for which the token says exactly the same: those that last at least
    ``1 - gap`` (with ``gap`` 0 an activity without duration may coincide with another one's start)
    and whose interval is never empty or always.
    """
    pairs = pairs_of(problem)
    lengths = {a.name: (a.lower, a.upper) for a in problem.activities}

    def exact(name: str, gap: int) -> bool:
        lower, upper = lengths[name]
        if lower[0] != "int" or upper[0] != "int" or gap not in (0, 1) or lower[1] + gap < 1:
            return False
        return bool(lower[1] + gap >= 2 or upper[1] + gap < 2)

    edges = {k: gap for k, (gap, _) in pairs.items() if all(exact(name, gap) for name in k)}
    cliques = find_cliques(edges, [a.name for a in problem.activities])
    return Compiled(_with_tokens(problem, cliques, pairs)) if cliques else Compiled(problem)


def _with_tokens(
    problem: PlainProblem,
    cliques: list[Clique],
    pairs: dict[tuple[str, str], tuple[int, Expr]],
) -> PlainProblem:
    taken = names_in_use(problem)
    types, objects = dict(problem.types), dict(problem.objects)
    fluents, conditions, effects = dict(problem.fluents), [], []
    covered: set[Expr] = set()
    for clique in cliques:
        token_type = fresh("Token", taken)
        types[token_type] = None
        idle = fresh("nobody", taken)
        objects[idle] = token_type
        token = fresh("token", taken)
        fluents[token] = Fluent(("user", token_type), (), ("obj", idle))
        for i, name in enumerate(clique.members):
            mine = fresh(f"{token}_{name}", taken)
            objects[mine] = token_type
            effects.append(Effect(start(name), "assign", ("flu", token), ("obj", mine), owner=name))
            upper = problem.activity(name).upper[1]
            if upper + clique.gap >= 2:
                held = ("eq", ("flu", token), ("obj", mine))
                low, high = start(name, 1), end(name, clique.gap - 1)
                conditions.append(Condition(low, high, held, name))
            for other in clique.members[:i]:
                covered.add(pairs[min(name, other), max(name, other)][1])
    return replace(
        problem,
        constraints=tuple(c for c in problem.constraints if c not in covered),
        conditions=(*problem.conditions, *conditions),
        effects=(*problem.effects, *effects),
        types=types,
        objects=objects,
        fluents=fluents,
    )
