"""What has happened by now: effects, as the initial values of what is left of a problem."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.graph import At, Event
from up_samp.execution.state import FloorState, TaskPhase
from up_samp.model import ProblemError, UnsupportedError
from up_samp.scheduling.compilers.plain import Expr, fluents_in, show
from up_samp.scheduling.compilers.translate import read_expression
from up_samp.scheduling.partial_order.differences import Planned, constant, kept


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
        told = {e[1] for whole in problem.read() for e in fluents_in(whole)}
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
