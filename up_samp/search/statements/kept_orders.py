"""Orders on rings: three objects rest nowhere in another order than that in which they began."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from up_samp.model.refinement import Given, Refinement
from up_samp.refinement import rules
from up_samp.search.facts import Facts
from up_samp.search.motions import Motions
from up_samp.search.statements.unary_places import never_together, places_of, resting_nodes

Node = tuple[str, str]
Arrival = tuple[str, Given]


def kept_orders(motions: Motions) -> list[Refinement]:
    """State which three objects do not rest somewhere together, since no motions lead them there,
    though they may lead each two of them.
    """
    nodes = resting_nodes(motions.facts)
    apart = set(never_together(motions, nodes, 2))  # which unary places tell
    found = []
    for some in never_together(motions, nodes, 3):
        if apart.isdisjoint(itertools.combinations(some, 2)):
            found += _not_all(motions.facts, some)
    return found


def _not_all(facts: Facts, some: Sequence[Node]) -> list[Refinement]:
    """State that objects do not rest at their places at one time: for all ways to come there."""
    found = []
    for ways in itertools.product(*(_ways(facts, node) for node in some)):
        arrivals = [way for way in ways if way is not None]
        given = {decision for _, decided in arrivals for decision in decided}
        if arrivals and len(dict(given)) == len(given):
            come = [activity for activity, _ in arrivals]
            gone = [
                activity
                for node, way in zip(some, ways, strict=True)
                for activity, _ in _drives(facts, node, 0)
                if way is None or activity != way[0]  # which is over when it has come by that
            ]
            told = rules.not_all_there(come, gone, "nobody passes anybody on the ring")
            found.append(rules.only_given(told, tuple(sorted(given))))
    return found


def _ways(facts: Facts, node: Node) -> list[Arrival | None]:
    """Return how an object comes to a place (None: it begins there)."""
    name, place = node
    begins: list[Arrival | None] = [None] if facts.snapshot.initial[name] == place else []
    return [*begins, *_drives(facts, node, -1)]


def _drives(facts: Facts, node: Node, which: int) -> list[Arrival]:
    """Return the drives of an object that may begin (``which`` 0) or end (-1) at a place, with the
    decisions under which they do.
    """
    name, place = node
    found: list[Arrival] = []
    for task in facts.snapshot.by_object.get(name, ()):
        there = places_of(facts, task, which)
        if place in there:
            variable = there[place]
            found.append((task.activity, () if variable is None else ((variable, place),)))
    return found
