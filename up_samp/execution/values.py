"""The values of fluents when a remaining problem starts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from unified_planning.model import FNode

from up_samp.execution.graph import At, Event
from up_samp.execution.state import State
from up_samp.model import ProblemError, UnsupportedError
from up_samp.scheduling.compilers.expressions import Expr, show
from up_samp.scheduling.partial_order.differences import Planned


@dataclass(eq=False)
class ValuesNow:
    """What effects that have happened leave behind, ``since`` units (of ``unit`` s) after the
    plan's start. Activities that are ``gone`` have given back what they took.
    """

    planned: Planned
    state: State
    unit: float
    since: int
    gone: frozenset[str]

    def holds(self, node: FNode) -> bool:
        """Return whether a condition certainly holds in the new initial state."""
        if node.is_bool_constant():
            return bool(node.constant_value())
        if node.is_and():
            return all(self.holds(a) for a in node.args)
        if node.is_fluent_exp():
            return self.value(node) is True
        if node.is_not() and node.arg(0).is_fluent_exp():
            return self.value(node.arg(0)) is False
        if node.is_equals():
            one, two = (self.value(a) for a in node.args)
            return one is not None and bool(one == two)
        return False

    def value(self, node: FNode) -> Any:
        """Return the value of a fluent or a constant in the new initial state (``None``: open)."""
        if node.is_object_exp():
            return node.object().name
        if node.is_constant():
            return node.constant_value()
        if not node.is_fluent_exp() or not all(a.is_object_exp() for a in node.args):
            return None
        key: Expr = (
            "flu",
            node.fluent().name,
            *(("obj", a.object().name) for a in node.args),
        )
        if key in self.changed:
            return self.changed[key]
        return self.planned.value(self.planned.problem.initial_value(key))

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
        return fired + delay * self.unit
