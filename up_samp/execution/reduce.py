"""Transitive reduction: edges that follow from others are dropped.

Events lie on chains (a motion's points, and its activity's start and end), so what happened before
an event is told by one position for each chain, as in vector clocks (Mattern 1989). An edge is
redundant where another edge into the same event tells as much.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from up_samp.execution.graph import Edge, Graph
from up_samp.execution.tolerances import TOLERANCES

Clock = npt.NDArray[np.int32]
"""The latest place on each chain that is known to come before (-1: none)."""


MEETING = "meeting"
"""The kind of edges that say who goes first where two bodies would meet."""


def reduced(graph: Graph) -> list[Edge]:
    """Return the edges that do not follow from the others. Those with a lag of their own are all
    kept; "strictly after" follows from any way that has a lag.

    What the problem asks for is dropped only where it follows from other things that the problem
    asks for: who goes first where bodies would meet, and what is free to be turned round, may still
    change.
    """
    orders = [e for e in graph.edges if e.kind != MEETING and not e.free]
    alone = Graph(graph.tasks, graph.events, graph.times, tuple(orders), lengths=graph.lengths)
    kept = set(_needed(alone, frozenset()))
    meetings = [e for e in graph.edges if e.kind == MEETING or e.free]
    both = Graph(graph.tasks, graph.events, graph.times, (*kept, *meetings), lengths=graph.lengths)
    needed = set(_needed(both, frozenset(kept)))
    return [e for e in graph.edges if e in needed]


def _needed(graph: Graph, always: frozenset[Edge]) -> list[Edge]:
    """Return the edges ``always`` kept, and those others that do not follow."""
    chain, place, count = _chains(graph)
    nobody = np.full(count, -1, dtype=np.int32)
    clocks: list[Clock] = [nobody] * len(graph.events)
    strictly: list[Clock] = [nobody] * len(graph.events)
    into: dict[int, list[Edge]] = defaultdict(list)
    for edge in graph.edges:
        into[edge.then].append(edge)
    before: dict[int, list[int]] = defaultdict(list)
    for first, then in graph.implied:
        before[then].append(first)
    rank = {event: k for k, event in enumerate(graph.order)}
    found = []
    for event in graph.order:
        clock, strict = nobody.copy(), nobody.copy()
        for first in before[event]:
            np.maximum(clock, clocks[first], out=clock)
            np.maximum(strict, strictly[first], out=strict)
        # latest first: what comes before it follows from it
        for edge in sorted(into[event], key=lambda e: (e not in always, -rank[e.first], -e.lag)):
            known = clock if edge.lag <= 0.0 else strict
            missing = known[chain[edge.first]] < place[edge.first]
            if edge in always or edge.lag > TOLERANCES.strict or missing:
                found.append(edge)
                np.maximum(clock, clocks[edge.first], out=clock)
                source = strictly if edge.lag <= 0.0 else clocks
                np.maximum(strict, source[edge.first], out=strict)
        clock[chain[event]] = place[event]
        clocks[event], strictly[event] = clock, strict
    return found


def _chains(graph: Graph) -> tuple[list[int], list[int], int]:
    """Cover the events with chains along implied pairs: (chain, place in it) of each event."""
    chain, place = [-1] * len(graph.events), [0] * len(graph.events)
    after: dict[int, list[int]] = defaultdict(list)
    for first, then in graph.implied:
        after[first].append(then)
    count = 0
    for event in graph.order:
        if chain[event] < 0:
            chain[event], count = count, count + 1
        for then in after[event]:
            if chain[then] < 0:
                chain[then], place[then] = chain[event], place[event] + 1
                break
    return chain, place, count
