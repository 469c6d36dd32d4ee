"""Expressions with what is decided put in: who is there, what is over, which values are known."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Set
from dataclasses import replace

from unified_planning.environment import Environment
from unified_planning.model import FNode, TimepointKind
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import UnsupportedError
from up_samp.model.objective import Cost
from up_samp.upio.expressions import activity_named, walk

_COMPARISONS = {Op.LE: operator.le, Op.LT: operator.lt, Op.EQUALS: operator.eq}


def whole_units(exact: Mapping[str, tuple[float, float]]) -> dict[str, tuple[int, int]]:
    """Return starts and ends as the schedule's whole units."""
    return {n: (math.floor(a + 1e-9), math.floor(b + 1e-9)) for n, (a, b) in exact.items()}


class Decided:
    """Puts what is decided into expressions.

    What has no value (times of what is absent, say) is neither true nor false, and a constraint
    that is not false holds (Kleene's logic, as the validator reads it). So a relation without a
    value counts as true where it stands, and as false under a negation.

    :param absent: activities that are not there, and so have no times.
    :param lost: parameters that have no value: of what is absent, mostly.
    :param present: activities that are surely there.
    :param values: known parameters.
    :param exact: start and end of activities that are over (units, not rounded: what is over is
        judged by what really was).
    :param shift: units by which the clock of what is returned starts later.
    """

    def __init__(
        self,
        environment: Environment,
        *,
        absent: Set[str],
        lost: Set[str],
        present: Set[str],
        values: Mapping[str, FNode] | None = None,
        exact: Mapping[str, tuple[float, float]] | None = None,
        shift: int = 0,
    ) -> None:
        self.manager = environment.expression_manager
        self.absent, self.lost = absent, lost
        self.values, self.exact, self.shift = values or {}, exact or {}, shift
        self.past = whole_units(self.exact)
        self.present = present | self.past.keys()
        self._memo: dict[tuple[FNode, bool], FNode] = {}

    def __call__(self, node: FNode, positive: bool = True) -> FNode:
        """Return an expression with what is decided; what has no value counts as ``positive``."""
        done = self._memo.get((node, positive))
        if done is None:
            done = self._memo[node, positive] = self._fix(node, positive)
        return done

    def cost(self, cost: Cost) -> Cost | None:
        """Return a cost on the new clock: what is over costs what it cost (``None``: it cannot
        come about any more).
        """
        side = (self(cost.node), 0) if cost.node.type.is_bool_type() else self._side(cost.node)
        if side is None or cost.activity in self.absent:
            return None
        node, live = side
        if live:
            node = self.manager.Plus(node, self.manager.Int(self.shift * live))
        return replace(
            cost, node=node, activity=None if cost.activity in self.present else cost.activity
        )

    def tells(self, node: FNode) -> bool:
        """Return whether an expression speaks of parameters that are known, or of lost ones."""
        told = self.values.keys() | self.lost
        return any(n.is_parameter_exp() and n.parameter().name in told for n in walk(node))

    def _fix(self, node: FNode, positive: bool) -> FNode:
        m = self.manager
        if node.is_and() or node.is_or():
            return self._join(node, positive)
        if node.is_not():
            inner = self(node.arg(0), not positive)
            return m.Bool(not inner.constant_value()) if inner.is_bool_constant() else m.Not(inner)
        if node.is_implies():
            return self(m.Or(m.Not(node.arg(0)), node.arg(1)), positive)
        return self._iff(node, positive) if node.is_iff() else self._leaf(node, positive)

    def _join(self, node: FNode, positive: bool) -> FNode:
        m, decided = self.manager, node.is_or()
        kept = []
        for argument in node.args:
            fixed = self(argument, positive)
            if not fixed.is_bool_constant():
                kept.append(fixed)
            elif fixed.constant_value() == decided:
                return m.Bool(decided)
        if not kept:
            return m.Bool(not decided)
        return m.Or(kept) if decided else m.And(kept)

    def _iff(self, node: FNode, positive: bool) -> FNode:
        """Return what is left of an equivalence: the other side, where one is known."""
        m, (a, b) = self.manager, node.args
        if self._has_none(node):
            return self(m.And(m.Implies(a, b), m.Implies(b, a)), positive)
        one, two = map(self, node.args)
        for constant, other in ((one, two), (two, one)):
            if constant.is_true():
                return other
            if constant.is_false():
                return m.FALSE() if other.is_true() else m.Not(other)
        return m.Iff(one, two)

    def _leaf(self, node: FNode, positive: bool) -> FNode:
        """Return what is left of an expression that joins no truth values."""
        m = self.manager
        if node.is_present_exp():
            name = node.presence().container
            if name in self.present:
                return m.TRUE()
            return m.FALSE() if name in self.absent else node
        if node.node_type in _COMPARISONS:
            return self._comparison(node, positive)
        if self._has_none(node):
            return m.Bool(positive)
        if node.is_parameter_exp():
            return self.values.get(node.parameter().name, node)
        return self._rebuilt(node, tuple(self(a, positive) for a in node.args))

    def _rebuilt(self, node: FNode, arguments: tuple[FNode, ...]) -> FNode:
        if arguments == tuple(node.args):
            return node
        payload = node._content.payload
        return self.manager.create_node(node_type=node.node_type, args=arguments, payload=payload)

    def _has_none(self, node: FNode) -> bool:
        """Return whether something in it has no value: nobody chooses it any more."""
        return any(
            (n.is_parameter_exp() and n.parameter().name in self.lost)
            or (n.is_timing_exp() and activity_named(n) in self.absent)
            for n in walk(node)
        )

    def _comparison(self, node: FNode, positive: bool) -> FNode:
        """Return a comparison on the new clock; times without a partner are moved by the shift."""
        m = self.manager
        left, right = (self._side(a) for a in node.args)
        if left is None or right is None:
            return m.Bool(positive)
        (one, live_one), (two, live_two) = left, right
        if not live_one and not live_two and one.is_int_constant() and two.is_int_constant():
            return m.Bool(self._held(node))
        gap = self.shift * (live_one - live_two)
        if gap and one.is_int_constant() and live_two == 1:
            one = m.Int(one.int_constant_value() + gap)
        elif gap and two.is_int_constant() and live_one == 1:
            two = m.Int(two.int_constant_value() - gap)
        elif gap:
            one = m.Plus(one, m.Int(gap))
        if one.is_int_constant() and two.is_int_constant():
            holds = _COMPARISONS[node.node_type](one.int_constant_value(), two.int_constant_value())
            return m.Bool(holds)
        sides = [one, two]
        if node.is_equals():  # UP compares times with numbers, not numbers with times
            sides.sort(key=FNode.is_int_constant)
        return self._rebuilt(node, tuple(sides))

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
        if node.is_timing_exp():
            return self._timing(node)
        if self._has_none(node):
            return None
        if not node.args or node.is_fluent_exp():
            return self(node), 0
        known = [p for p in map(self._side, node.args) if p is not None]
        nodes, counts = tuple(n for n, _ in known), [count for _, count in known]
        sums = node.is_plus() or node.is_minus()
        if not sums and any(counts) and self.shift:
            raise UnsupportedError(f"'{node}' in a constraint: times can only be added")
        sign = -1 if node.is_minus() else 1
        total = counts[0] + sign * sum(counts[1:]) if sums else 0
        if sums and all(n.is_int_constant() for n in nodes):
            first, *rest = (n.int_constant_value() for n in nodes)
            return self.manager.Int(first + sign * sum(rest)), total
        return self._rebuilt(node, nodes), total

    def _timing(self, node: FNode) -> tuple[FNode, int] | None:
        timing = node.timing()
        point = timing.timepoint
        if point.container in self.absent:
            return None
        time = 0
        if point.container in self.past:
            time = self.past[point.container][point.kind == TimepointKind.END]
        elif point.kind != TimepointKind.GLOBAL_START:
            return node, 1
        return self.manager.Int(int(time + timing.delay)), 0
