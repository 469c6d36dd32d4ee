"""Finds "one thing at a time": cliques of activities that are pairwise apart."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from up_samp.scheduling.compilers.expressions import Expr
from up_samp.scheduling.compilers.plain import PlainProblem


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


def find_cliques(
    pairs: dict[tuple[str, str], int], order: list[str], smallest: int = 3
) -> list[Clique]:
    """Cover the edges ``pairs`` (sorted names -> gap) greedily by cliques of one gap.

    Edges that fall into no clique of at least ``smallest`` members stay uncovered. Greedy edge
    clique cover after Kellerman (1973): grow a clique from each uncovered edge, preferring those
    who add most uncovered edges.
    """
    number = {name: i for i, name in enumerate(order)}
    found: list[Clique] = []
    for gap in sorted(set(pairs.values())):
        neighbours: dict[int, int] = defaultdict(int)
        for (a, b), g in pairs.items():
            if g == gap:
                neighbours[number[a]] |= 1 << number[b]
                neighbours[number[b]] |= 1 << number[a]
        found += [
            Clique(tuple(order[i] for i in members), gap)
            for members in _cover(dict(neighbours), smallest)
        ]
    return found


def _cover(neighbours: dict[int, int], smallest: int) -> list[list[int]]:
    uncovered = dict(neighbours)
    cliques = []
    for a in sorted(neighbours):
        left = uncovered[a]
        while left:
            b = (left & -left).bit_length() - 1
            left &= left - 1
            clique = _grow(neighbours, uncovered, a, b)
            if len(clique) < smallest:
                continue
            mask = sum(1 << i for i in clique)
            for i in clique:
                uncovered[i] &= ~mask
            left &= uncovered[a]
            cliques.append(sorted(clique))
    return cliques


def _grow(neighbours: dict[int, int], uncovered: dict[int, int], a: int, b: int) -> list[int]:
    clique, mask = [a, b], (1 << a) | (1 << b)
    common = neighbours[a] & neighbours[b]
    while common:
        best, most = -1, -1
        rest = common
        while rest:
            i = (rest & -rest).bit_length() - 1
            rest &= rest - 1
            new = (uncovered[i] & mask).bit_count() * 4096 + (neighbours[i] & common).bit_count()
            if new > most:
                best, most = i, new
        clique.append(best)
        mask |= 1 << best
        common &= neighbours[best]
    return clique


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
