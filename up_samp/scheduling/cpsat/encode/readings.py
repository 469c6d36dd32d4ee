"""How conditions and values read state variables: the reads that are registered for them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from unified_planning.model import FNode

from up_samp.model import UnsupportedError
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    compare,
    constant,
)
from up_samp.scheduling.cpsat.encode.ground_fluents import GroundFluents, no_fluents
from up_samp.scheduling.cpsat.encode.nodes import (
    equals_object,
    equals_parameter,
    fluents_in,
    has_decisions,
    unless_decided,
)
from up_samp.scheduling.cpsat.encode.statevars import Read, StateVar
from up_samp.scheduling.cpsat.encode.terms import ActivityVars, Terms, World


class Readings(GroundFluents):
    """State variables, and who reads them, when, and with which values."""

    def __init__(self, world: World, problem: Any) -> None:
        super().__init__(world, problem)
        self.dynamic: set[str] = set()
        """Names of the fluents that change."""
        self._allowed: dict[FNode, frozenset[int]] = {}

    def _all_grounds(
        self, node: FNode, owner: ActivityVars | None
    ) -> Iterator[tuple[Literal, StateVar]]:
        for fluent in fluents_in(node):
            args_have_fluents = any(fluents_in(a) for a in fluent.args)
            if args_have_fluents:
                raise UnsupportedError(f"the nested fluent '{fluent}' is not supported by cpsat")
            yield from self.grounds(fluent, Terms(self.world, no_fluents, owner))

    def _hold(
        self,
        node: FNode,
        owner: ActivityVars | None,
        active: Literal,
        lo: Lin,
        hi: Lin,
        loose: bool = False,
    ) -> None:
        if active == FALSE:
            return
        number = None if owner is None else owner.index
        fluents = fluents_in(node)
        single = next(iter(fluents)) if len(fluents) == 1 else None
        if (
            single is not None
            and all(a.is_constant() for a in single.args)
            and not has_decisions(node)
        ):
            ((_, state),) = self.grounds(single, Terms(self.world, no_fluents, owner))
            if state.values is not None:
                allowed = self._values(node, state)
                self._read(state, Read(number, active, lo, hi, allowed=allowed, loose=loose))
                return
        chosen = equals_parameter(node)
        if chosen is not None and single is not None and all(a.is_constant() for a in single.args):
            ((_, state),) = self.grounds(single, Terms(self.world, no_fluents, owner))
            value = self.world.parameters.get(chosen)
            if state.key[0] in self.dynamic and state.values is not None and value is not None:
                # all effects are known by now
                allowed = frozenset(state.held()) & self._left(value)
                self._read(state, Read(number, active, lo, hi, allowed, value, loose=loose))
                return
        decided, rest = unless_decided(node)
        if decided is not None and not loose:
            # whatever is decided, nobody may change meanwhile what is read
            for _, state in self._all_grounds(rest, owner):
                self._read(state, Read(number, active, lo, hi, guard_only=True))
            said = Terms(self.world, no_fluents, owner)
            other = self._literals(said.form(decided, False), said.form(decided))
            self._hold(rest, owner, self.store.all_of([active, *other]), lo, hi)
            return
        terms = Terms(self.world, self.reader(owner, active, lo, hi, loose), owner)
        self.store.enforce(terms.form(node), (active,))

    def _left(self, value: Lin) -> frozenset[int]:
        """Return what a parameter may be."""
        low, high = self.store.range(value)
        known = self.world.domains.get(value.terms[0][0]) if value.terms else None
        return frozenset(range(low, high + 1)) if known is None else known

    def _literals(self, form: Form, opposite: Form) -> list[Literal]:
        """Return literals that together are true exactly if a form of parameters holds."""
        found = []
        for part in form[1:] if form.__class__ is tuple and form[0] == "&" else (form,):
            one = part.terms[0] if part.__class__ is Cmp and len(part.terms) == 1 else (0, 0)
            if abs(one[1]) != 1 or part.op != "==":
                return [self.store.equivalent(form, opposite)]
            found.append(self.store.is_value(one[0], -part.const * one[1]))
        return found

    def _values(self, node: FNode, state: StateVar) -> frozenset[int]:
        """Return the values of ``state`` with which ``node`` holds."""
        found = self._allowed.get(node)
        if found is None:
            values = state.values or []
            fixed = equals_object(node)
            if fixed is not None:
                found = frozenset((self.world.objects[fixed],)).intersection(values)
            else:
                found = frozenset(v for v in values if self._evaluate(node, v) == TRUE)
            self._allowed[node] = found
        return found

    def _evaluate(self, node: FNode, value: int) -> Any:
        return Terms(self.world, lambda _: constant(value)).form(node)

    def _read(self, state: StateVar, read: Read) -> None:
        if state.key[0] in self.dynamic:
            anything = read.allowed is not None and len(read.allowed) == len(state.values or ())
            if anything and state.initial is not None and read.value is None:
                read = replace(read, allowed=None, guard_only=True)
            state.reads.append(read)
        elif state.initial is None or (
            read.allowed is not None and state.initial not in read.allowed
        ):
            self.store.enforce(FALSE, (read.active,))

    def reader(
        self, owner: ActivityVars | None, active: Literal, lo: Lin, hi: Lin, loose: bool = False
    ) -> Any:
        """Return a function fluent expression -> value over lo..hi (cached, reads registered)."""
        cache: dict[FNode, Lin] = {}
        number = None if owner is None else owner.index

        def read(node: FNode) -> Lin:
            if node not in cache:
                grounds = list(self.grounds(node, Terms(self.world, read, owner)))
                pattern = Read(number, active, lo, hi, loose=loose)
                cache[node] = self._value(node, grounds, pattern)
            return cache[node]

        return read

    def _value(self, node: FNode, grounds: list[tuple[Literal, StateVar]], pattern: Read) -> Lin:
        if len(grounds) == 1:
            literal, only = grounds[0]
            static = only.key[0] not in self.dynamic and only.initial is not None
            if static and literal == TRUE:
                return constant(only.initial or 0)
        bounds = [s.bounds for _, s in grounds]
        if node.type.is_user_type():
            result = self.store.member(self.world.values_of(node.type))
        else:
            result = self.store.integer(min(b[0] for b in bounds), max(b[1] for b in bounds))
        value = Lin(((result, 1),))
        for literal, state in grounds:
            when = self.store.all_of([pattern.active, literal])
            if when == FALSE:
                continue
            if state.key[0] in self.dynamic:
                state.reads.append(replace(pattern, active=when, value=value))
            elif state.initial is None:
                self.store.enforce(FALSE, (when,))
            else:
                self.store.enforce(compare(value.shift(-state.initial), "=="), (when,))
        return value
