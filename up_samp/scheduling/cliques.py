"""Find "one at a time" in what users write pair by pair: cliques of pairs that are kept apart.

``Or(a.end + k <= b.start, b.end + k <= a.start)`` for every pair of a set of activities is one
NoOverlap over intervals [start, end + k). Pure functions on graphs.
"""

from __future__ import annotations

from collections.abc import Iterable

from up_samp.model import check_time

Graph = dict[int, set[int]]


def graph_of(edges: Iterable[tuple[int, int]]) -> Graph:
    """Return adjacency sets."""
    graph: Graph = {}
    for a, b in edges:
        graph.setdefault(a, set()).add(b)
        graph.setdefault(b, set()).add(a)
    return graph


def clique_cover(
    graph: Graph,
    covered: Iterable[Iterable[int]] = (),
    spare: Iterable[tuple[int, int]] = (),
) -> list[list[int]]:
    """Return cliques that together contain every edge (greedy, deterministic).

    Edges in ``spare`` and inside the sets in ``covered`` need not be in any. Each clique is grown
    from an edge that is not covered yet, first by vertices that cover many uncovered edges; that
    finds the intended sets of unary resources at once.
    """
    uncovered = {v: set(others) for v, others in graph.items()}
    for done in covered:
        members = set(done)
        for a in members & uncovered.keys():
            uncovered[a] -= members
    for a, b in spare:
        uncovered[a].discard(b)
        uncovered[b].discard(a)
    cliques = []
    for v in sorted(graph, key=lambda x: (-len(graph[x]), x)):
        while uncovered[v]:
            w = max(uncovered[v], key=lambda x: (len(graph[x] & graph[v]), -x))
            clique = _grow(graph, uncovered, v, w)
            for a in clique:
                uncovered[a].difference_update(clique)
            cliques.append(sorted(clique))
    return cliques


def _grow(graph: Graph, uncovered: Graph, v: int, w: int) -> set[int]:
    clique = {v, w}
    candidates = graph[v] & graph[w]
    gains = {x: len(uncovered[x] & clique) for x in candidates}
    while candidates:
        check_time()
        best = max(candidates, key=lambda x: (gains[x], len(graph[x]), -x))
        clique.add(best)
        candidates = candidates & graph[best]
        for x in candidates & uncovered[best]:
            gains[x] += 1
    return clique
