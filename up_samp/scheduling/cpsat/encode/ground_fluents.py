"""The ground fluents of a problem: which one an expression stands for, and what it is at first."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from unified_planning.model import FNode

from up_samp.model import ProblemError, UnsupportedError
from up_samp.scheduling.cpsat.encode.forms import FALSE, TRUE, Lin, Literal, compare
from up_samp.scheduling.cpsat.encode.limits import LIMITS
from up_samp.scheduling.cpsat.encode.statevars import Key, StateVar
from up_samp.scheduling.cpsat.encode.store import Store
from up_samp.scheduling.cpsat.encode.terms import Terms, World, int_bounds


class GroundFluents:
    """State variables by fluent and arguments, made when they are asked for."""

    def __init__(self, world: World, problem: Any) -> None:
        self.world = world
        self.store: Store = world.store
        self.problem = problem
        self.vars: dict[Key, StateVar] = {}
        self.explicit = problem.explicit_initial_values
        self.defaults = problem.fluents_defaults
        self.declared = frozenset(problem.fluents)

    def var(self, fluent: Any, args: tuple[int, ...]) -> StateVar:
        """Return the state variable of ``fluent`` at ``args`` (codes of objects, numbers)."""
        key = (fluent.name, *args)
        found = self.vars.get(key)
        if found is None:
            found = self.vars[key] = self._make(key, fluent, args)
        return found

    def _make(self, key: Key, fluent: Any, args: tuple[int, ...]) -> StateVar:
        if fluent not in self.declared and fluent not in self.problem.fluents:
            raise ProblemError(f"the fluent '{fluent.name}' is used, but it is not in the problem")
        tpe = fluent.type
        if tpe.is_bool_type() or tpe.is_user_type():
            values: list[int] | None = self.world.values_of(tpe)
            bounds = (min(values), max(values)) if values else (0, 0)
        else:
            bounds = int_bounds(tpe)
            few = bounds[1] - bounds[0] < LIMITS.domain
            values = list(range(bounds[0], bounds[1] + 1)) if few else None
        return StateVar(key, bounds, values, self._initial(fluent, args))

    def _initial(self, fluent: Any, args: tuple[int, ...]) -> int | None:
        names = {code: name for name, code in self.world.objects.items()}
        manager = self.problem.environment.expression_manager
        nodes = []
        for parameter, code in zip(fluent.signature, args, strict=True):
            if parameter.type.is_user_type():
                nodes.append(manager.ObjectExp(self.problem.object(names[code])))
            elif parameter.type.is_bool_type():
                nodes.append(manager.Bool(bool(code)))
            else:
                nodes.append(manager.Int(code))
        value = self.explicit.get(manager.FluentExp(fluent, tuple(nodes)))
        if value is None:
            value = self.defaults.get(fluent)
        if value is None:
            return None
        return Terms(self.world, no_fluents).linear(value).const

    def grounds(self, node: FNode, terms: Terms) -> Iterator[tuple[Literal, StateVar]]:
        """Yield (literal, variable) for each ground fluent that ``node`` may stand for."""
        fluent = node.fluent()
        choices: list[list[tuple[Literal, int]]] = []
        for arg, parameter in zip(node.args, fluent.signature, strict=True):
            lin = terms.linear(arg)
            if not lin.terms:
                choices.append([(TRUE, lin.const)])
                continue
            var = self._plain(lin)
            choices.append(
                [(self.store.is_value(var, v), v) for v in self.world.values_of(parameter.type)]
            )
        for combination in itertools.product(*choices):
            literal = self.store.all_of(x for x, _ in combination)
            if literal != FALSE:
                yield literal, self.var(fluent, tuple(v for _, v in combination))

    def _plain(self, lin: Lin) -> int:
        if len(lin.terms) == 1 and lin.terms[0][1] == 1 and lin.const == 0:
            return lin.terms[0][0]
        low, high = self.store.range(lin)
        var = self.store.integer(low, high)
        self.store.enforce(compare(lin.plus(Lin(((var, 1),)), -1)._replace(needs=()), "=="))
        return var

    # -- effects -------------------------------------------------------------------------------


def no_fluents(node: FNode) -> Lin:
    """Refuse a fluent by name, where there is no time at which it could be read."""
    raise UnsupportedError(f"the fluent '{node}' is read at no time; cpsat needs one")
