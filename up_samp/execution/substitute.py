"""Constraints of the rest of a problem: what is over is a known time, what is gone is absent."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from unified_planning.environment import Environment
from unified_planning.model import FNode, TimepointKind, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.graph import At, Event
from up_samp.execution.state import FloorState, TaskPhase
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.objective import Cost
from up_samp.scheduling.compilers.plain import Expr, show, subexpressions
from up_samp.scheduling.compilers.read import read_expression
from up_samp.scheduling.partial_order.differences import Planned, constant, kept
from up_samp.upio.expressions import Decided


@dataclass(eq=False)
class ValuesNow:
    """What effects of ``source`` that have happened leave behind, ``since`` units (of ``unit`` s)
    after the plan's start. Activities that are ``gone`` have given back what they took.
    """

    source: SchedulingProblem
    planned: Planned
    state: FloorState
    unit: float
    since: int
    gone: frozenset[str]

    def holds(self, node: FNode) -> bool:
        """Return whether a condition holds in the new initial state."""
        return kept(self.now, read_expression(self.source, node)) == []

    @cached_property
    def now(self) -> Planned:
        """The plan, with fluents as they are now."""
        changed = {key: constant(value) for key, value in self.changed.items()}
        problem = self.planned.problem
        initial = {**problem.initial, **changed}
        return replace(self.planned, problem=replace(problem, initial=initial))

    @cached_property
    def changed(self) -> dict[Expr, Any]:
        """The values of fluents that effects have changed."""
        values: dict[Expr, Any] = {}
        for _, _, key, kind, amount in self._happened:
            old = values.get(key)
            if old is None and kind != "assign":
                old = self.planned.value(self.planned.problem.initial_value(key))
            if kind == "assign":
                values[key] = amount
            else:
                values[key] = old + (amount if kind == "increase" else -amount)
        return values

    def check_bounds(self) -> None:
        """Raise :class:`ProblemError` where a fluent has a value that its type does not have."""
        for key, value in self.changed.items():
            kind, *bounds = self.planned.problem.fluents[key[1]].type
            if kind != "int" or isinstance(value, bool):
                continue
            least, most = bounds
            if (least is not None and value < least) or (most is not None and value > most):
                by = [f"'{owner}'" for _, owner, other, *_ in self._happened if other == key]
                raise ProblemError(
                    f"what has happened is against the problem: '{show(key)}' is {value} now, and "
                    f"may be {least} to {most}; it was changed by {', '.join(by)}"
                )

    @cached_property
    def uses(self) -> frozenset[str]:
        """Fluents that are only taken from and given back to: nothing reads their values."""
        problem = self.planned.problem
        read = [c.expression for c in problem.conditions]
        read += [part for e in problem.effects for part in (e.value, e.condition)]
        read += [bound for a in problem.activities for bound in (a.lower, a.upper)]
        told = {e[1] for whole in read for e in subexpressions(whole) if e[0] == "flu"}
        told |= {e.fluent[1] for e in problem.effects if e.kind == "assign"}
        return frozenset(problem.fluents.keys() - told)

    def before(self, key: Expr) -> Any:
        """Return the new initial value of a fluent: what is under way takes anew what it uses."""
        value = self.changed[key]
        for _, owner, other, kind, amount in self._happened if key[1] in self.uses else ():
            if other == key and self.under_way(owner):
                value += amount if kind == "decrease" else -amount
        return value

    def under_way(self, name: str) -> bool:
        """Return whether an activity has begun, goes on, and is not over."""
        return name not in self.gone and self.state.phase.get(name) is TaskPhase.RUNNING

    @cached_property
    def _happened(self) -> list[tuple[float, str, Expr, str, Any]]:
        """Effects that have happened, in their order: when (s), whose, on what, how."""
        return sorted(self._effects(), key=lambda e: e[0])

    def _effects(self) -> Iterator[tuple[float, str, Expr, str, Any]]:
        for effect in self.planned.problem.effects:
            time = self._when(effect)
            if time is None:
                continue
            key = self.planned.ground(effect.fluent)
            if effect.condition != ("bool", True):
                raise UnsupportedError(f"conditional effect on {show(effect.fluent)}, from now on")
            amount = self.planned.value(effect.value)
            if key is not None:
                yield time, effect.owner or "the problem", key, effect.kind, amount

    def _when(self, effect: Any) -> float | None:
        """Return when an effect happened (s), ``None`` if it has not."""
        _, anchor, owner, delay = effect.time
        if anchor == "zero":
            time = delay * self.unit
            return time if time < self.since * self.unit else None
        if owner is None or owner not in self.state.phase:
            return None
        at = At.START if anchor == "start" else At.END
        fired = self.state.fired.get(Event(at, owner))
        if fired is None:
            return None
        if owner in self.gone and at is At.START:
            # what a robot that is out of order has taken, it gives back
            return None
        time = fired + delay * self.unit
        return time if at is At.END or time <= (self.since + 1e-9) * self.unit else None


_COMPARISONS = (Op.LE, Op.LT, Op.EQUALS)


def whole_units(exact: Mapping[str, tuple[float, float]]) -> dict[str, tuple[int, int]]:
    """Return starts and ends as the schedule's whole units."""
    return {n: (math.floor(a + 1e-9), math.floor(b + 1e-9)) for n, (a, b) in exact.items()}


class Substitution(Decided):
    """Rewrites expressions for a clock that starts ``shift`` units later.

    ``exact`` maps activities that are over to their start and end (units, old clock, not rounded:
    what is over is judged by what really was), ``gone`` are activities that cannot
    happen any more and so have no times and no parameters (``lost``), ``values`` known parameters
    of what is over, ``mandatory`` activities that have begun: present.
    """

    def __init__(
        self,
        environment: Environment,
        shift: int,
        exact: Mapping[str, tuple[float, float]],
        gone: frozenset[str],
        values: Mapping[str, FNode],
        mandatory: frozenset[str],
        lost: frozenset[str],
    ) -> None:
        super().__init__(environment)
        self.shift, self.past, self.exact = shift, whole_units(exact), exact
        self.gone, self.values, self.mandatory = gone, values, mandatory
        self.lost = lost

    def leaf(self, node: FNode, positive: bool) -> FNode:
        """See :class:`Decided`."""
        m = self.manager
        if node.is_present_exp():
            name = node.presence().container
            if name in self.gone:
                return m.FALSE()
            known = name in self.past or name in self.mandatory
            return m.TRUE() if known else node
        if node.node_type in _COMPARISONS:
            return self._comparison(node, positive)
        if self._has_none(node):
            return m.Bool(positive)
        if node.is_parameter_exp():
            return self.values.get(node.parameter().name, node)
        parts = tuple(self(a, positive) for a in node.args)
        if parts == tuple(node.args):
            return node
        return m.create_node(node_type=node.node_type, args=parts, payload=node._content.payload)

    def cost(self, cost: Cost) -> Cost | None:
        """Return a cost on the new clock: what is over costs what it cost (``None``: it cannot
        come about any more).
        """
        side = (self(cost.node), 0) if cost.node.type.is_bool_type() else self._side(cost.node)
        if side is None or cost.activity in self.gone:
            return None
        node, live = side
        if live:
            node = self.manager.Plus(node, self.manager.Int(self.shift * live))
        known = cost.activity in self.past or cost.activity in self.mandatory
        return replace(cost, node=node, activity=None if known else cost.activity)

    def tells(self, node: FNode) -> bool:
        """Return whether an expression speaks of parameters that are known, or of lost ones."""
        if node.is_parameter_exp():
            return node.parameter().name in self.values.keys() | self.lost
        return any(map(self.tells, node.args))

    def _has_none(self, node: FNode) -> bool:
        """Return whether a parameter or a fluent has no value: nobody chooses it any more."""
        if node.is_parameter_exp():
            return node.parameter().name in self.lost
        return any(map(self._has_none, node.args))

    def _comparison(self, node: FNode, positive: bool) -> FNode:
        """Return a comparison on the new clock; times without a partner are moved by the shift."""
        m = self.manager
        left, right = (self._side(a) for a in node.args)
        if left is None or right is None:
            return m.Bool(positive)
        (one, live_one), (two, live_two) = left, right
        if not live_one and not live_two and one.is_int_constant() and two.is_int_constant():
            return m.Bool(self._held(node))
        if live_one == live_two:
            return self._compared(node, one, two)
        if one.is_int_constant() and live_two == 1:
            return self._compared(node, m.Int(one.int_constant_value() - self.shift), two)
        if two.is_int_constant() and live_one == 1:
            return self._compared(node, one, m.Int(two.int_constant_value() - self.shift))
        gap = self.shift * (live_one - live_two)
        return self._compared(node, m.Plus(one, m.Int(gap)), two)

    def _compared(self, node: FNode, one: FNode, two: FNode) -> FNode:
        m = self.manager
        if one.is_int_constant() and two.is_int_constant():
            a, b = one.int_constant_value(), two.int_constant_value()
            kind = node.node_type
            return m.Bool(a <= b if kind == Op.LE else a < b if kind == Op.LT else a == b)
        if tuple(node.args) == (one, two):
            return node
        return m.create_node(node_type=node.node_type, args=(one, two), payload=None)

    def _held(self, node: FNode) -> bool:
        """Return whether a comparison of times that are over held."""
        one, two = (self._real(a) for a in node.args)
        if node.node_type == Op.LE:
            return one <= two + 1e-6
        return one < two if node.node_type == Op.LT else abs(one - two) <= 1e-6

    def _real(self, node: FNode) -> float:
        if node.is_timing_exp():
            point = node.timing().timepoint
            delay = float(node.timing().delay)
            if point.kind == TimepointKind.GLOBAL_START:
                return delay
            start, end = self.exact[point.container]
            return delay + (start if point.kind == TimepointKind.START else end)
        if node.is_plus():
            return sum(self._real(a) for a in node.args)
        if node.is_minus():
            return self._real(node.arg(0)) - self._real(node.arg(1))
        if node.is_parameter_exp():
            return float(self.values[node.parameter().name].constant_value())
        return float(node.constant_value())

    def _side(self, node: FNode) -> tuple[FNode, int] | None:
        """Return an arithmetic expression with past times put in, and how many of the times in it
        are still to come (``None``: it has no value).
        """
        m = self.manager
        if node.is_timing_exp():
            return self._timing(node)
        if self._has_none(node):
            return None
        if not node.args or node.is_fluent_exp():
            return self(node), 0
        parts = [self._side(a) for a in node.args]
        if any(p is None for p in parts):
            return None
        nodes = [p[0] for p in parts if p is not None]
        counts = [p[1] for p in parts if p is not None]
        if node.is_plus():
            total = sum(counts)
        elif node.is_minus():
            total = counts[0] - counts[1]
        elif not any(counts):
            total = 0
        else:
            raise UnsupportedError(f"'{node}' in a constraint: times can only be added")
        if all(n.is_int_constant() for n in nodes) and (node.is_plus() or node.is_minus()):
            numbers = [n.int_constant_value() for n in nodes]
            value = sum(numbers) if node.is_plus() else numbers[0] - numbers[1]
            return m.Int(value), total
        fixed = m.create_node(
            node_type=node.node_type, args=tuple(nodes), payload=node._content.payload
        )
        return fixed, total

    def _timing(self, node: FNode) -> tuple[FNode, int] | None:
        m = self.manager
        timing = node.timing()
        point = timing.timepoint
        if point.container in self.gone:
            return None
        if point.kind == TimepointKind.GLOBAL_START:
            return m.Int(int(timing.delay)), 0
        if point.container in self.past:
            start, end = self.past[point.container]
            time = start if point.kind == TimepointKind.START else end
            return m.Int(int(time + timing.delay)), 0
        return node, 1


def later_by(timing: Timing, shift: int) -> Timing:
    """Return an absolute time on a clock that starts ``shift`` units later."""
    absolute = timing.timepoint.kind == TimepointKind.GLOBAL_START
    return Timing(timing.delay - shift, timing.timepoint) if absolute else timing
