"""Cliques of activities that are pairwise apart, and tokens for them: linear, not quadratic."""

from __future__ import annotations

from dataclasses import dataclass, replace

from up_samp.scheduling.cliques import clique_cover, graph_of
from up_samp.scheduling.compilers.plain import (
    Compiled,
    Condition,
    Effect,
    Expr,
    Fluent,
    PlainProblem,
    end,
    fresh,
    names_in_use,
    start,
)


@dataclass(frozen=True)
class Clique:
    """Of any two members that are present, one ends ``gap`` or more before the other starts."""

    members: tuple[str, ...]
    gap: int


def disjunctive_pair(constraint: Expr, optional: frozenset[str]) -> tuple[str, str, int] | None:
    """Return ``(a, b, gap)`` if the constraint (in normal form) says just that ``a`` and ``b``
    are ``gap`` apart, as far as both are present.
    """
    if constraint[0] != "or":
        return None
    orders: list[tuple[str, str, int]] = []
    guards: set[str] = set()
    for part in constraint[1:]:
        if part[0] == "not" and part[1][0] == "pres":
            guards.add(part[1][1])
        elif part[0] == "le" and part[1][0] == part[2][0] == "time":
            (_, first, a, before), (_, second, b, after) = part[1], part[2]
            if first != "end" or second != "start":
                return None
            orders.append((a, b, before - after))
        else:
            return None
    if len(orders) != 2:
        return None
    (a, b, gap), (c, d, other_gap) = orders
    if (a, b) != (d, c) or a == b or gap != other_gap:
        return None
    return (a, b, gap) if guards == {a, b} & optional else None


def find_cliques(pairs: dict[tuple[str, str], int], order: list[str]) -> list[Clique]:
    """Return cliques of three and more of one gap among ``pairs`` (sorted names -> gap)."""
    number = {name: i for i, name in enumerate(order)}
    return [
        Clique(tuple(order[i] for i in members), gap)
        for gap in sorted(set(pairs.values()))
        for members in clique_cover(
            graph_of((number[a], number[b]) for (a, b), g in pairs.items() if g == gap)
        )
        if len(members) > 2
    ]


def pairs_of(problem: PlainProblem) -> dict[tuple[str, str], tuple[int, Expr]]:
    """Return the disjunctive pairs of a problem in normal form: sorted names -> (gap, constraint).

    Of several constraints over one pair the one with the larger gap counts.
    """
    optional = problem.optional_names()
    pairs: dict[tuple[str, str], tuple[int, Expr]] = {}
    for constraint in problem.constraints:
        pair = disjunctive_pair(constraint, optional)
        if pair is not None:
            key = (min(pair[:2]), max(pair[:2]))
            if key not in pairs or pairs[key][0] < pair[2]:
                pairs[key] = (pair[2], constraint)
    return pairs


# ------------------ Cliques of disjunctions to tokens
# Cliques of disjunctions to tokens, for engines with object fluents: linear, not quadratic. A
# token is a state variable whose value names an activity. Each member of the clique takes it at
# its start and needs it unchanged while it runs: over ``[start + 1, end - 1 + gap]``. Another
# member then cannot start in between, and two cannot start at one instant, as their effects would
# meet.


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
