"""Who goes first, decided again: sides of components and orders of activities as binaries (CP-SAT).

The idea of the switchable action dependency graph in a receding horizon (Berndt, van Duijkeren,
Palmieri, Kleiner & Keviczky, "Receding horizon re-ordering of multi-agent execution schedules",
IEEE T-RO 40, 2024; switchable dependencies also in Jiang, Lin & Li, arXiv 2412.15908, and Su,
Veerapaneni & Li, arXiv 2401.00315), here over the components of continuous obstacles, and over
the orders in which machines, places and unary resources are used. An order is changed only where
no robot is committed yet, and only if the new graph has no cycle and is forecast to be better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ortools.sat.python import cp_model

from up_samp.execution.build import with_sides
from up_samp.execution.decisions import Decision, Followed, can_wait, open_decisions
from up_samp.execution.forecast import Forecast, routes_of
from up_samp.execution.graph import Graph, Precedence
from up_samp.execution.sides import Key
from up_samp.execution.times import SCALE, tied
from up_samp.model import ProblemError


@dataclass(frozen=True)
class Proposal:
    """Another order: ``flips`` says how decisions are to be, and ``graph`` is what comes of them
    where orders were ``base`` (sides and turned choices) before.
    """

    flips: Mapping[Key | int, bool]
    graph: Graph
    base: tuple[Mapping[Key, bool], frozenset[int]]


def propose(executor: Followed) -> Proposal | None:
    """Return an order that is forecast to end sooner than the present one, if one is found.

    Which decisions are looked at, and for how long, is said by ``executor.tuning.reorder``. The
    executor is used up: it is left with whatever order was tried last.
    """
    tuning = executor.tuning.reorder
    base = dict(executor.sides), executor.turned
    before = executor.retime()
    decisions = open_decisions(executor, before, tuning.horizon, tuning.most)
    if not decisions:
        return None
    chosen = _solve(executor, before, decisions)
    flips = {d.key: chosen[d.key] for d in decisions if chosen.get(d.key, d.now) != d.now}
    if not flips:
        return None
    try:
        graph = with_sides(executor.dependencies, *_with(base, flips))
    except ProblemError:  # it would have opened a cycle
        return None
    proposal = Proposal(flips, graph, base)
    return proposal if adopt(executor, proposal) else None


def adopt(executor: Followed, proposal: Proposal) -> int:
    """Take over an order, if it still can be kept and still is better; return how many orders
    changed. Nothing that has begun is touched.
    """
    if proposal.base != (executor.sides, executor.turned):
        return 0
    old, state = executor.state.graph, executor.state
    known = {(old.events[e.first], old.events[e.then], e.lag) for e in old.edges}
    for edge in proposal.graph.edges:
        events = proposal.graph.events
        need = Precedence(events[edge.first], events[edge.then], edge.lag)
        if (need.first, need.then, need.lag) not in known and not can_wait(state, need):
            return 0
    before = executor.retime()
    _load(executor, proposal.graph)
    if not _better(before, executor.retime(), executor.tuning.reorder.worth):
        _load(executor, old)
        return 0
    executor.sides, executor.turned = _with(proposal.base, proposal.flips)
    return len(proposal.flips)


def _with(
    base: tuple[Mapping[Key, bool], frozenset[int]], flips: Mapping[Key | int, bool]
) -> tuple[dict[Key, bool], frozenset[int]]:
    """Return the sides and the turned choices with some decisions changed."""
    sides, turned = dict(base[0]), set(base[1])
    for key, way in flips.items():
        if not isinstance(key, int):
            sides[key] = way
        elif way:
            turned.discard(key)
        else:
            turned.add(key)
    return sides, frozenset(turned)


def _load(executor: Followed, graph: Graph) -> None:
    executor.state.load(graph)
    executor.routes = routes_of(graph, executor.state.ways)


def _better(before: Forecast, after: Forecast, worth: float) -> bool:
    """Return whether all is over ``worth`` s sooner, and no deadline is missed by more."""
    sooner = before.makespan - after.makespan > worth
    return sooner and _missed(after) <= _missed(before) + 1e-3


def _missed(ahead: Forecast) -> float:
    """Return by how much (s) deadlines, windows and longest durations will be missed, in all."""
    return sum(
        max(0.0, ahead.times[b.then] - ahead.times[b.first] - b.most) for b in ahead.graph.bounds
    )


def _solve(executor: Followed, ahead: Forecast, decisions: list[Decision]) -> dict[Key | int, bool]:
    """Return how each decision should be; empty where nothing better was found."""
    state, tuning = executor.state, executor.tuning.reorder
    times, ends = tied(executor, decisions)
    low = times.earliest()
    latest = math.ceil((ahead.makespan - tuning.worth - state.now) * SCALE)
    if max((low[k] for k in ends), default=0) > latest:
        return {}  # not even without all that is open
    model = cp_model.CpModel()
    literals = [model.new_bool_var("") for _ in decisions]
    found = times.variables(model, low, latest, literals)
    last = model.new_int_var(0, latest, "")
    for k in ends:
        model.add(last >= found[k])
    model.minimize(10 * len(ends) * last + sum(found[k] for k in ends))
    for literal, decision in zip(literals, decisions, strict=True):
        model.add_hint(literal, decision.now)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = 0
    solver.parameters.cp_model_probing_level = 0
    solver.parameters.linearization_level = 0
    solver.parameters.max_deterministic_time = tuning.effort
    status = solver.solve(model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return {}
    return {d.key: bool(solver.boolean_value(x)) for d, x in zip(decisions, literals, strict=True)}


class Reorderer:
    """Reorders when the predicted makespan has grown by more than a threshold since it last did,
    but not too often (``executor.tuning.reorder``).
    """

    def __init__(self) -> None:
        self.known: float | None = None
        self.since = -math.inf

    def __call__(self, executor: Followed) -> int:
        """Look at the executor; return how many orders were changed."""
        tuning = executor.tuning.reorder
        if executor.now < self.since + tuning.pause:
            return 0
        ahead = executor.predicted_makespan()
        if self.known is None:
            planned = (t.planned[1] for t in executor.state.graph.tasks.values())
            self.known = min(ahead, max(planned, default=ahead))
        if ahead < self.known + tuning.threshold:
            return 0
        self.since = executor.now
        changed = executor.reorder()
        self.known = executor.predicted_makespan()
        return changed
