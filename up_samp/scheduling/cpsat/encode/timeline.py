"""Exact timelines of state variables: those that are only assigned, and numeric ones (resources
that are borrowed, levels that rise and fall).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter

from up_samp.model import ProblemError, check_time
from up_samp.model.graphs import grouped
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Lin,
    Literal,
    ModelStore,
    compare,
    conjunction,
    constant,
    indicator_sum,
)
from up_samp.scheduling.cpsat.encode.states import Read, States, StateVar, Write


def guard(states: States, state: StateVar, read: Read) -> None:
    """Keep the effects of other activities out of the instants of ``read``."""
    store = states.store
    for write in state.writes:
        if read.owner is None or write.owner in (None, read.owner):
            continue
        before = store.literal(write.time.shift(1).le(read.lo))
        after = store.literal(read.hi.shift(1).le(write.time))
        store.clause([before, after, ~read.active, ~write.active])


# ------------------ Numeric state variables
# Resources that are borrowed, levels that rise and fall, and reads. Increases and decreases of one
# instant add up, and bounds are looked at after each instant. So a borrowing over [start, end) may
# begin when another one ends, and one of duration 0 takes nothing.


Use = tuple[Write, Write]
"""An amount is taken by one effect (at that instant already), and given back by the other one, of
the same owner: what that adds is what was borrowed."""


def pair_uses(states: States, state: StateVar) -> list[Use] | None:
    """Return the borrowings that ``state`` consists of, or ``None`` if there is anything else."""
    if any(not w.add or w.value.terms for w in state.writes):
        return None
    uses: list[Use] = []
    for writes in grouped(state.writes, attrgetter("owner", "active")).values():
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
            uses.append((take, give))
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
        for take, give in uses:
            low, high = self.states.difference(give.time, take.time)
            if high <= 0 or take.active == FALSE:
                continue
            size = Lin((), low) if low == high else Lin(((store.integer(low, high), 1),))
            intervals.append(store.interval(take.time, size, give.time, take.active))
            demands.append(give.value.const)
        if intervals:
            model.add_cumulative(intervals, demands, capacity)
            self._energy(uses, capacity)

    def _energy(self, uses: list[Use], capacity: int) -> None:
        """State that all borrowing fits into capacity times makespan (implied; a lower bound)."""
        load = []
        for take, give in uses:
            if take.owner is not None:
                activity = self.states.activity(take.owner)
                early = self.states.difference(take.time, activity.start)[0] >= 0
                if early and self.states.difference(activity.end, give.time)[0] >= 0:
                    least = max(0, self.states.difference(give.time, take.time)[0])
                    load.append((take.active, least * give.value.const))
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
                # a negated literal there makes OR-Tools 9.15 take right solutions for wrong ones,
                # and end the process
                [store.raw(store.positive(w.active)) for w in writes],
                low - initial,
                high - initial,
            )

    def _bounds_by_query(self) -> None:
        for write in self.state.writes:
            if write.add:
                level = self.query(write.time.shift(1), write.active)
                self.states.within_bounds(self.state, level, write.active)

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
            var = store.variable(level)
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
            return indicator_sum([(literal, value.const)])
        low, high = store.range(value)
        part = Lin(((store.integer(min(low, 0), max(high, 0)), 1),))
        store.enforce(compare(part.plus(value, -1), "=="), (literal,))
        store.enforce(compare(part, "=="), (~literal,))
        return part


# ------------------ Exact timelines of state variables that are only assigned
# Every active write holds from t + 1 until (before) the next one; a read is supported by exactly
# one write, or by the initial value, whose reign covers it: the supporter-and-no-threat encoding
# of timeline planners (Bit-Monnot, ECAI 2023). Two encodings of the order of the writes:
#
# - *reigns*: one interval [t, until) per write in a NoOverlap;
# - *circuit*: successor arcs between writes, only where the value that one leaves is one that the
#   next one's activity needs (moves of a robot). Most arcs never exist.


Apart = Callable[[frozenset[int]], bool]
"""Whether activities are known never to overlap, any two of them."""


@dataclass
class Timeline:
    """A state variable in the model: ``until[i]`` bounds the reign of write i; index -1 is the
    initial value (last entry). ``circuits``: its order may be stated as one.
    """

    states: States
    state: StateVar
    apart: Apart
    circuits: bool = True
    until: list[Lin] = field(default_factory=list)
    linked: dict[int, Read] = field(default_factory=dict)
    """Write that can only follow some values -> its activity's own read, which allows these."""

    @property
    def store(self) -> ModelStore:
        """The model."""
        return self.states.store

    def build(self) -> None:
        """Add the order of the writes and all reads so far."""
        far = self.states.far.const + 2
        self.until = [Lin(((self.store.integer(0, far), 1),)) for _ in self.state.writes]
        self.until.append(Lin(((self.store.integer(0, far), 1),)))
        self._find_links()
        if self.circuits and self._wants_circuit():
            self._circuit()
        else:
            self.linked = {}
            self._reigns()
        links = {read.owner: i for i, read in self.linked.items()}
        for read in self.state.reads:
            i = links.get(read.owner)
            if i is None or not self._implied(read, i):
                self.add_read(read)

    # -- order of the writes -------------------------------------------------------------------
    def _reigns(self) -> None:
        store, model = self.store, self.store.model
        intervals = []
        for write, until in zip(self.state.writes, self.until, strict=False):
            intervals.append(self._interval(write.time, until, write.active))
        intervals.append(self._interval(constant(-1), self.until[-1], TRUE))
        if len(intervals) > 1:
            model.add_no_overlap(intervals)
        for write in self.state.writes:
            if store.range(write.time)[0] < 0:
                store.enforce(constant(0).le(write.time), (write.active,))

    def _interval(self, start: Lin, until: Lin, active: Literal) -> object:
        size = self.store.integer(1, self.store.range(until)[1] + 2)
        return self.store.interval(start, Lin(((size, 1),)), until, active)

    def _find_links(self) -> None:
        """Find the writes whose activity, which has no other one, reads the variable right before,
        so that the supporter of that read is the previous write.
        """
        numbers = {id(write): i for i, write in enumerate(self.state.writes)}
        own = self.state.by_owner()
        for read in self.state.reads:
            mine = own.get(read.owner, ())
            if read.owner is None or read.allowed is None or len(mine) != 1:
                continue
            (write,) = mine
            if read.active == write.active and self._adjacent(write, read):
                old = self.linked.get(numbers[id(write)])
                if old is None or self._earlier(read, old):
                    self.linked[numbers[id(write)]] = read

    def _adjacent(self, write: Write, read: Read) -> bool:
        """Return whether no other write can lie between ``read`` and its own ``write``."""
        low, high = self.states.difference(write.time, read.hi)
        if low < 0:
            return False
        return high <= 1 or self._alone(write, read)

    def _earlier(self, read: Read, other: Read) -> bool:
        return self.states.difference(other.lo, read.lo)[0] >= 0 and (
            read.allowed or frozenset()
        ) <= (other.allowed or frozenset())

    def _implied(self, read: Read, i: int) -> bool:
        """Return whether ``read`` asks no more than the one that write ``i`` is linked to."""
        link = self.linked[i]
        if read is link:
            return True  # the arcs say it
        return (
            read.value is None
            and read.allowed is not None
            and link.allowed is not None
            and read.active == link.active
            and link.allowed <= read.allowed
            and self.states.difference(read.lo, link.lo)[0] >= 0
            and self.states.difference(self.state.writes[i].time, read.hi)[0] >= 0
        )

    def _alone(self, write: Write, read: Read) -> bool:
        owner = write.owner
        if owner is None or not self.states.surely_during(owner, read.lo, read.lo):
            return False
        return self._never_overlap

    @cached_property
    def _never_overlap(self) -> bool:
        owners = {w.owner for w in self.state.writes}
        if None in owners or not self.apart(frozenset(o for o in owners if o is not None)):
            return False
        during = self.states.surely_during
        return all(during(w.owner or 0, w.time, w.time) for w in self.state.writes)

    def _possible(self, before: int, after: int) -> bool:
        """Return whether write ``after`` may directly follow ``before`` (-1: the initial value)."""
        link = self.linked.get(after)
        if link is None or link.allowed is None:
            return True
        allowed = link.allowed
        if before < 0:
            return self.state.initial is not None and self.state.initial in allowed
        value = self.state.writes[before].value
        low, high = self.store.range(value)
        return any(low <= v <= high for v in allowed) if value.terms else value.const in allowed

    def _wants_circuit(self) -> bool:
        writes = self.state.writes
        if 3 * len(self.linked) < len(writes) or len(writes) < 2:
            return False
        if any(w.owner is None for w in writes):
            return False
        pairs = itertools.product(range(-1, len(writes)), range(len(writes)))
        arcs = sum(self._possible(i, j) for i, j in pairs if i != j)
        return arcs <= 60_000  # beyond that only pairs are ordered

    def _circuit(self) -> None:
        """State the order of the writes as a circuit through a node for the initial value.

        Assumes: each effect but few belongs to an activity that needs a value of the state itself.
        """
        store = self.store
        writes = self.state.writes
        n = len(writes)
        arcs: list[tuple[int, int, object]] = []
        last = [store.boolean() for _ in range(n + 1)]
        for j, write in enumerate(writes):
            check_time()
            arcs.append((j + 1, j + 1, store.raw(~write.active)))
            arcs.append((j + 1, 0, store.raw(last[j])))
            for i in range(-1, n):
                if i != j and self._possible(i, j):
                    literal = store.boolean()
                    arcs.append((i + 1, j + 1, store.raw(literal)))
                    self._follow(i, j, literal)
        arcs.append((0, 0, store.raw(last[n])))
        store.model.add_circuit(arcs)

    def _follow(self, i: int, j: int, literal: Literal) -> None:
        """State what follows when write ``j`` comes right after ``i`` (-1: the initial value)."""
        store, write = self.store, self.state.writes[j]
        store.enforce(self.until[i].le(write.time), (literal,))
        link = self.linked.get(j)
        earliest = write.time if link is None else link.lo
        if i >= 0:
            store.enforce(self.state.writes[i].time.shift(1).le(earliest), (literal,))
        if link is not None:
            value = constant(self.state.initial or 0) if i < 0 else self.state.writes[i].value
            self._supports(value, link, literal)

    def _supports(self, value: Lin, read: Read, literal: Literal) -> None:
        """State that a read finds a ``value``, which may be among those that it allows."""
        if read.value is not None:
            self.store.enforce(compare(read.value.plus(value, -1), "=="), (literal,))
        elif value.terms and read.allowed is not None:
            var = self.store.variable(value)
            some = [self.store.is_value(var, v) for v in sorted(read.allowed)]
            self.store.clause([~literal, *some])

    # -- reads ---------------------------------------------------------------------------------
    def add_read(self, read: Read) -> None:
        """Add a read: supported by one write, or the initial value, that reigns throughout."""
        if read.active == FALSE:
            return
        if read.guard_only:
            guard(self.states, self.state, read)
            return
        check_time()
        store = self.store
        after = read.hi.plus(self._margin(read))
        supporters: list[Literal] = []
        for i, write in enumerate(self.state.writes):
            literal = self._supporter(write, read)
            if literal is None:
                continue
            supporters.append(literal)
            store.enforce(after.le(self.until[i]), (literal,))
        initial = self.state.initial
        if initial is not None and (read.allowed is None or initial in read.allowed):
            literal = store.boolean()
            supporters.append(literal)
            store.enforce(after.le(self.until[-1]), (literal,))
            if read.value is not None:
                store.enforce(compare(read.value.shift(-initial), "=="), (literal,))
        for literal in supporters:
            store.clause([~literal, read.active])
        store.clause([*supporters, ~read.active])
        store.at_most_one(supporters)

    def _supporter(self, write: Write, read: Read) -> Literal | None:
        store = self.store
        if write.active == FALSE or self.states.difference(read.lo, write.time)[1] < 1:
            return None
        if (
            read.allowed is not None
            and not write.value.terms
            and write.value.const not in read.allowed
        ):
            return None
        literal = store.boolean()
        store.clause([~literal, write.active])
        store.enforce(write.time.shift(1).le(read.lo), (literal,))
        self._supports(write.value, read, literal)
        return literal

    def _margin(self, read: Read) -> Lin:
        """Return 1 where the next write must come after ``read.hi``, 0 where it may coincide.

        Only own and base effects may coincide with the last instant of a condition.
        """
        if read.owner is None or read.loose:
            return constant(0)
        margin = constant(1)
        for write in self.state.exempt(read.owner):
            low, high = self.states.difference(write.time, read.hi)
            if low > 0 or high < 0:
                continue
            if low == high == 0 and write.active == read.active:
                return constant(0)
            coincides = self.store.boolean()
            self.store.clause([~coincides, write.active])
            form = compare(write.time.plus(read.hi, -1), "==")
            self.store.enforce(form, (coincides,))
            margin = margin.plus(Lin(((coincides, 1),)), -1)
        return margin
