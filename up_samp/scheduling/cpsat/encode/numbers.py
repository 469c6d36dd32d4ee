"""Numeric state variables: resources that are borrowed, levels that rise and fall, and reads.

Increases and decreases of one instant add up, and bounds are looked at after each instant. So a
borrowing over [start, end) may begin when another one ends, and one of duration 0 takes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model import ProblemError
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Lin,
    Literal,
    compare,
    conjunction,
    constant,
    indicator_sum,
)
from up_samp.scheduling.cpsat.encode.guards import guard
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.statevars import Read, StateVar, Write


@dataclass
class Use:
    """``amount`` is borrowed from ``start`` (inclusive) to ``end`` (exclusive)."""

    owner: int | None
    active: Literal
    start: Lin
    end: Lin
    amount: int


def pair_uses(states: States, state: StateVar) -> list[Use] | None:
    """Return the borrowings that ``state`` consists of, or ``None`` if there is anything else."""
    if any(not w.add or w.value.terms for w in state.writes):
        return None
    waiting: dict[tuple[int | None, Literal], list[Write]] = {}
    for write in state.writes:
        waiting.setdefault((write.owner, write.active), []).append(write)
    uses = []
    for (owner, active), writes in waiting.items():
        takes = [w for w in writes if w.value.const < 0]
        gives = [w for w in writes if w.value.const > 0]
        for take in takes:
            give = next(
                (
                    g
                    for g in gives
                    if g.value.const == -take.value.const
                    and states.difference(g.time, take.time)[0] >= 0
                ),
                None,
            )
            if give is None:
                return None
            gives.remove(give)
            uses.append(Use(owner, active, take.time, give.time, give.value.const))
        if gives:
            return None
    return uses


class NumericTimeline:
    """A state variable that is increased or decreased (and possibly assigned)."""

    def __init__(self, states: States, state: StateVar) -> None:
        self.states = states
        self.state = state
        self.store = states.store

    def build(self) -> None:
        """Add bounds and all reads so far."""
        state = self.state
        if state.initial is None:
            raise ProblemError(
                f"the fluent '{state.key[0]}' is increased or decreased, but has no initial value"
            )
        simple = all(w.add and not w.value.terms for w in state.writes)
        uses = pair_uses(self.states, state)
        if uses is not None:
            self._cumulative(uses)
        elif simple:
            self._reservoir()
        else:
            self._bounds_by_query()
        self._no_coincidences()
        for read in state.reads:
            self.add_read(read)

    def _cumulative(self, uses: list[Use]) -> None:
        store, model = self.store, self.store.model
        capacity = (self.state.initial or 0) - self.state.bounds[0]
        intervals, demands = [], []
        for use in uses:
            low, high = self.states.difference(use.end, use.start)
            if high <= 0 or use.active == FALSE:
                continue
            size = Lin((), low) if low == high else Lin(((store.integer(low, high), 1),))
            args = (store.affine(use.start), store.expression(size), store.affine(use.end))
            if use.active == TRUE:
                intervals.append(model.new_interval_var(*args, ""))
            else:
                intervals.append(model.new_optional_interval_var(*args, store.raw(use.active), ""))
            demands.append(use.amount)
        if intervals:
            model.add_cumulative(intervals, demands, capacity)
            self._energy(uses, capacity)

    def _energy(self, uses: list[Use], capacity: int) -> None:
        """State that all borrowing fits into capacity times makespan (implied; a lower bound)."""
        load = []
        for use in uses:
            if use.owner is not None:
                activity = self.states.activity(use.owner)
                early = self.states.difference(use.start, activity.start)[0] >= 0
                if early and self.states.difference(activity.end, use.end)[0] >= 0:
                    least = max(0, self.states.difference(use.end, use.start)[0])
                    load.append((use.active, least * use.amount))
        space = Lin(((self.states.world.makespan, capacity),))
        self.store.enforce(indicator_sum(load).le(space))

    def _reservoir(self) -> None:
        store, state = self.store, self.state
        initial = state.initial or 0
        low, high = state.bounds
        writes = [w for w in state.writes if w.active != FALSE]
        if writes:
            store.model.add_reservoir_constraint_with_active(
                [store.affine(w.time) for w in writes],
                [w.value.const for w in writes],
                [store.raw(w.active) for w in writes],
                low - initial,
                high - initial,
            )

    def _bounds_by_query(self) -> None:
        low, high = self.state.bounds
        for write in self.state.writes:
            if write.add:
                level = self.query(write.time.shift(1), write.active)
                self.store.enforce(constant(low).le(level), (write.active,))
                self.store.enforce(level.le(constant(high)), (write.active,))

    def _no_coincidences(self) -> None:
        """Keep assignments apart from every other effect on the variable."""
        writes = self.state.writes
        for i, a in enumerate(writes):
            for b in writes[i + 1 :]:
                if not (a.add and b.add):
                    form = compare(a.time.plus(b.time, -1), "!=")
                    self.store.enforce(form, (a.active, b.active))

    def add_read(self, read: Read) -> None:
        """Add a read: the value just before ``read.lo``, undisturbed until ``read.hi``."""
        store = self.store
        if read.active == FALSE:
            return
        if not read.loose:
            guard(self.states, self.state, read)
        if read.guard_only:
            return
        level = self.query(read.lo, read.active)
        if read.value is not None:
            store.enforce(compare(read.value.plus(level, -1), "=="), (read.active,))
        if read.allowed is not None:
            low, high = store.range(level)
            var = store.integer(low, high)
            store.enforce(compare(level.plus(Lin(((var, 1),)), -1), "=="))
            options = [store.is_value(var, v) for v in sorted(read.allowed)]
            store.clause([*options, ~read.active])

    def query(self, time: Lin, active: Literal) -> Lin:
        """Return the value seen at ``time`` (all effects before it), right when ``active``."""
        sets = [w for w in self.state.writes if not w.add and w.active != FALSE]
        adds = [w for w in self.state.writes if w.add and w.active != FALSE]
        bases = self._supports(sets, time, active)
        total = constant(0)
        for value, literal in bases:
            total = total.plus(self._contribution(value, literal))
        for write in adds:
            counted = self._counted(write, sets, bases, time, active)
            total = total.plus(self._contribution(write.value, counted))
        return total

    def _supports(self, sets: list[Write], time: Lin, active: Literal) -> list[tuple[Lin, Literal]]:
        """Return (value, literal) for each assignment and the initial value: the last one before
        ``time`` has a true literal.
        """
        store = self.store
        initial = constant(self.state.initial or 0)
        if not sets:
            return [(initial, TRUE)]
        bases = [(w.value, store.boolean()) for w in sets] + [(initial, store.boolean())]
        store.model.add_exactly_one([store.raw(x) for _, x in bases])
        for i, write in enumerate(sets):
            literal = bases[i][1]
            store.enforce(
                conjunction([write.active, write.time.shift(1).le(time)]), (literal, active)
            )
            for j, other in enumerate(sets):
                if i != j:
                    earlier = store.literal(other.time.shift(1).le(write.time))
                    later = store.literal(time.le(other.time))
                    store.clause([~literal, ~active, ~other.active, earlier, later])
            store.enforce(time.le(write.time), (bases[-1][1], active, write.active))
        return bases

    def _counted(
        self,
        write: Write,
        sets: list[Write],
        bases: list[tuple[Lin, Literal]],
        time: Lin,
        active: Literal,
    ) -> Literal:
        store = self.store
        counted = store.boolean()
        store.clause([~counted, write.active])
        store.enforce(write.time.shift(1).le(time), (counted, active))
        late = store.literal(time.le(write.time))
        if not sets:
            store.clause([counted, ~write.active, ~active, late])
            return counted
        for i, base in enumerate(sets):
            literal = bases[i][1]
            store.enforce(base.time.shift(1).le(write.time), (counted, literal, active))
            early = store.literal(write.time.shift(1).le(base.time))
            store.clause([counted, ~write.active, ~active, ~literal, late, early])
        store.clause([counted, ~write.active, ~active, ~bases[-1][1], late])
        return counted

    def _contribution(self, value: Lin, literal: Literal) -> Lin:
        """Return ``value`` if ``literal``, else 0."""
        store = self.store
        if literal == TRUE:
            return value
        if not value.terms:
            if literal >= 0:
                return Lin(((literal, value.const),)) if value.const else constant(0)
            return Lin(((~literal, -value.const),), value.const)
        low, high = store.range(value)
        part = Lin(((store.integer(min(low, 0), max(high, 0)), 1),))
        store.enforce(compare(part.plus(value, -1), "=="), (literal,))
        store.enforce(compare(part, "=="), (~literal,))
        return part
