"""Unary places: configurations that overlap hold one driving object at a time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from operator import itemgetter

from up_samp.model import avoids
from up_samp.model.refinement import Refinement
from up_samp.model.snapshot import MotionTask, TermKind
from up_samp.refinement import rules
from up_samp.search.facts import Facts
from up_samp.search.motions import Motions
from up_samp.search.world import near

Edges = set[tuple[int, int]]
"""Which two nodes are not taken at one time."""


def unary_places(motions: Motions) -> list[Refinement]:
    """State that configurations which overlap hold one driving object at a time, and so do those
    to which no motions lead two objects together.
    """
    nodes = resting_nodes(motions.facts)
    overlapping, in_order = _overlapping(motions, nodes), _in_order(motions, nodes)
    found = []
    for edges, named, why in (
        (overlapping, itemgetter(1), "objects that rest at these configurations would overlap"),
        (in_order - overlapping, "_at_".join, "nobody passes anybody on the way there"),
    ):
        covered: Edges = set()
        for pair in sorted(edges):
            if pair in covered:
                continue
            clique = _grow(pair, edges, nodes)
            covered |= {p for p in itertools.combinations(sorted(clique), 2)}
            members = [nodes[i] for i in sorted(clique)]
            name = "_".join(sorted({named(member) for member in members}))
            found.append(_place(motions.facts, members, name, why))
    return found


def resting_nodes(facts: Facts) -> list[tuple[str, str]]:
    """Return (object, configuration) for objects whose whole motion is known and heeds all."""
    snapshot = facts.snapshot
    nodes: set[tuple[str, str]] = set()
    # what comes and goes by other means than its own motions is not counted right
    elsewise = snapshot.moved_otherwise
    for name in sorted(facts.drivers):
        tasks = snapshot.by_object[name]
        ends = [places_of(facts, task, i) for task in tasks for i in (0, -1)]
        heeds = all(avoids(t.avoid, *(facts.drivers - {name})) for t in tasks)
        if all(ends) and heeds and name not in elsewise:
            nodes |= {(name, place) for places in ends for place in places}
            nodes.add((name, snapshot.initial[name]))
    return sorted(nodes)


def places_of(facts: Facts, task: MotionTask, which: int) -> dict[str, str | None]:
    """Return where a motion may begin (``which`` 0) or end (-1), with the variable that tells it
    (None: it is no choice).
    """
    term = task.terms[which]
    if term.kind is TermKind.CONSTANT:
        return {term.name: None}
    choice = facts.choices.get((task.activity, term, False))
    return {} if choice is None else dict.fromkeys(choice.values, choice.variable)


def _overlapping(motions: Motions, nodes: list[tuple[str, str]]) -> Edges:
    snapshot = motions.facts.snapshot
    edges: Edges = set()
    for i, j in itertools.combinations(range(len(nodes)), 2):
        (a, place_a), (b, place_b) = nodes[i], nodes[j]
        if a == b:
            continue
        bodies = snapshot.objects[a].body, snapshot.objects[b].body
        poses = snapshot.configurations[place_a], snapshot.configurations[place_b]
        if near(bodies[0], poses[0], bodies[1], poses[1]) and motions.service.overlap(
            bodies[0], poses[0], bodies[1], poses[1]
        ):
            edges.add((i, j))
    return edges


def _in_order(motions: Motions, nodes: list[tuple[str, str]]) -> Edges:
    """Return which two objects rest nowhere at one time as nobody passes anybody on the way."""
    index = {node: i for i, node in enumerate(nodes)}
    return {(index[one], index[other]) for one, other in never_together(motions, nodes, 2)}


def never_together(
    motions: Motions, nodes: list[tuple[str, str]], count: int
) -> Iterator[tuple[tuple[str, str], ...]]:
    """Yield so many (object, configuration) each, to which no motions lead these objects together,
    as far as time allows.
    """
    facts = motions.facts
    at, tasks = facts.snapshot.configurations, facts.snapshot.tasks
    # only what all of them heed
    fixed = [o for o in facts.fixed if all(avoids(t.avoid, o.name) for t in tasks)]
    places: dict[str, list[tuple[str, str]]] = {}
    for node in nodes:
        places.setdefault(node[0], []).append(node)
    deadline = motions.budget.part("orders that cannot change")
    for names in itertools.combinations(places, count):
        if deadline.expired():
            return
        first = [facts.placed(name, facts.snapshot.initial[name]) for name in names]
        apart = motions.service.in_order(first, fixed)
        if apart is not None:
            every = itertools.product(*(places[name] for name in names))
            yield from (some for some in every if apart([at[place] for _, place in some]))


def _grow(pair: tuple[int, int], edges: Edges, nodes: list[tuple[str, str]]) -> set[int]:
    """Return a clique around an edge: all of different objects overlap each other."""
    clique = set(pair)
    for node in range(len(nodes)):
        if node not in clique and all(
            nodes[node][0] == nodes[m][0] or (min(node, m), max(node, m)) in edges for m in clique
        ):
            clique.add(node)
    return clique


def _place(facts: Facts, members: list[tuple[str, str]], name: str, why: str) -> Refinement:
    inside = set(members)
    always: dict[int, set[str]] = {0: set(), -1: set()}
    decided: dict[int, set[tuple[str, str, str]]] = {0: set(), -1: set()}
    for task in facts.snapshot.tasks:
        for which in always:
            for place, variable in places_of(facts, task, which).items():
                if (task.object, place) not in inside:
                    continue
                if variable is None:
                    always[which].add(task.activity)
                else:
                    decided[which].add((task.activity, variable, place))
    taken = any(facts.snapshot.initial[name] == place for name, place in members)
    told = rules.unary_place(name, always[-1], always[0], taken, decided[0], decided[-1])
    return replace(told, why=why)
