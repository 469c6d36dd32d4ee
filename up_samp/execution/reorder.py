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
from typing import TYPE_CHECKING

from ortools.sat.python import cp_model

from up_samp.execution.build import with_sides
from up_samp.execution.decisions import Decision, open_decisions
from up_samp.execution.forecast import Forecast, routes_of
from up_samp.execution.graph import Graph
from up_samp.execution.sides import Key
from up_samp.execution.times import SCALE, tied
from up_samp.model import ProblemError

if TYPE_CHECKING:
    from up_samp.execution.executor import Executor


def reorder(executor: Executor) -> int:
    """Change who goes first where that is forecast to end sooner; return how many orders changed.

    Which decisions are looked at, and for how long, is said by ``executor.tuning.reorder``. What
    has begun is not touched.
    """
    tuning = executor.tuning.reorder
    before = executor.retime()
    decisions = open_decisions(executor, before, tuning.horizon, tuning.most)
    if not decisions:
        return 0
    chosen = _solve(executor, before, decisions)
    flips = {d.key: chosen[d.key] for d in decisions if chosen.get(d.key, d.now) != d.now}
    if not flips:
        return 0
    old = executor.state.graph, executor.sides, executor.turned
    executor.sides, executor.turned = _with(executor, flips)
    try:
        graph = with_sides(executor.dependencies, executor.sides, executor.turned)
    except ProblemError:  # it would have opened a cycle
        _, executor.sides, executor.turned = old
        return 0
    _load(executor, graph)
    if not _better(before, executor.retime(), tuning.worth):
        _load(executor, old[0])
        _, executor.sides, executor.turned = old
        return 0
    return len(flips)


def _with(
    executor: Executor, flips: Mapping[Key | int, bool]
) -> tuple[dict[Key, bool], frozenset[int]]:
    """Return the sides and the turned choices with some decisions changed."""
    sides, turned = dict(executor.sides), set(executor.turned)
    for key, way in flips.items():
        if not isinstance(key, int):
            sides[key] = way
        elif way:
            turned.discard(key)
        else:
            turned.add(key)
    return sides, frozenset(turned)


def _load(executor: Executor, graph: Graph) -> None:
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


def _solve(executor: Executor, ahead: Forecast, decisions: list[Decision]) -> dict[Key | int, bool]:
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

    def __call__(self, executor: Executor) -> int:
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
        changed = reorder(executor)
        self.known = executor.predicted_makespan()
        return changed
