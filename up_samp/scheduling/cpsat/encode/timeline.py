"""Exact timelines of state variables that are only assigned.

Every active write holds from t + 1 until (before) the next one; a read is supported by exactly
one write, or by the initial value, whose reign covers it: the supporter-and-no-threat encoding of
timeline planners (Bit-Monnot, ECAI 2023). Two encodings of the order of the writes:

- *reigns*: one interval [t, until) per write in a NoOverlap;
- *circuit*: successor arcs between writes, only where the value that one leaves is one that the
  next one's activity needs (moves of a robot). Most arcs never exist.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from up_samp.model import check_time
from up_samp.scheduling.cpsat.encode.forms import FALSE, TRUE, Lin, Literal, compare, constant
from up_samp.scheduling.cpsat.encode.guards import guard
from up_samp.scheduling.cpsat.encode.limits import LIMITS
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.statevars import Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.store import Store

Apart = Callable[[frozenset[int]], bool]
"""Whether activities are known never to overlap, any two of them."""


@dataclass
class Link:
    """A write that can only follow some values: ``allowed`` by its activity's own ``read``."""

    write: Write
    read: Read


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
    arcs: dict[tuple[int, int], Literal] = field(default_factory=dict)
    linked: dict[int, Link] = field(default_factory=dict)
    chained: dict[int, int] = field(default_factory=dict)
    """Write -> the one of the same activity right before it."""
    _separate: bool | None = None

    @property
    def store(self) -> Store:
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
            self.chained = {}
            self._reigns()
        links = {link.read.owner: link for link in self.linked.values()}
        for read in self.state.reads:
            link = links.get(read.owner)
            if link is None or not self._implied(read, link):
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
        store = self.store
        size = store.integer(1, store.range(until)[1] + 2)
        if active == TRUE:
            return store.model.new_interval_var(
                store.affine(start), store.var(size), store.expression(until), ""
            )
        return store.model.new_optional_interval_var(
            store.affine(start), store.var(size), store.expression(until), store.raw(active), ""
        )

    def _find_links(self) -> None:
        """Find the writes whose activity reads the variable right before, so that the supporter
        of that read is the previous write; and those that follow another one of their own
        activity, so that nothing of others comes between.
        """
        by_owner: dict[int, list[int]] = {}
        for i, write in enumerate(self.state.writes):
            if write.owner is not None:
                by_owner.setdefault(write.owner, []).append(i)
        reads: dict[int, list[Read]] = {}
        for read in self.state.reads:
            if read.owner is not None and read.allowed is not None:
                reads.setdefault(read.owner, []).append(read)
        for owner, numbers in by_owner.items():
            order = self._one_by_one(numbers)
            if order is None:
                continue
            self.chained.update((then, first) for first, then in itertools.pairwise(order))
            i, write = order[0], self.state.writes[order[0]]
            for read in reads.get(owner, ()):
                if read.active == write.active and self._adjacent(write, read):
                    old = self.linked.get(i)
                    if old is None or self._earlier(read, old.read):
                        self.linked[i] = Link(write, read)

    def _one_by_one(self, numbers: list[int]) -> list[int] | None:
        """Return the order of an activity's writes, if nothing of others comes between them."""
        if len(numbers) == 1:
            return numbers
        writes = self.state.writes
        if len({writes[i].active for i in numbers}) > 1 or not self._never_overlap():
            return None
        order = sorted(
            numbers,
            key=lambda i: sum(
                self.states.difference(writes[i].time, writes[j].time)[0] > 0 for j in numbers
            ),
        )
        times = [writes[i].time for i in order]
        if any(self.states.difference(b, a)[0] < 1 for a, b in itertools.pairwise(times)):
            return None
        return order

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

    def _implied(self, read: Read, link: Link) -> bool:
        """Return whether ``read`` asks no more than the read of ``link`` does."""
        if read is link.read:
            return True  # the arcs say it
        return (
            read.value is None
            and read.allowed is not None
            and link.read.allowed is not None
            and read.active == link.read.active
            and link.read.allowed <= read.allowed
            and self.states.difference(read.lo, link.read.lo)[0] >= 0
            and self.states.difference(link.write.time, read.hi)[0] >= 0
        )

    def _alone(self, write: Write, read: Read) -> bool:
        owner = write.owner
        if owner is None or not self._within(owner, read.lo):
            return False
        return self._never_overlap()

    def _never_overlap(self) -> bool:
        if self._separate is None:
            self._separate = self._writers_never_overlap()
        return self._separate

    def _writers_never_overlap(self) -> bool:
        owners = {w.owner for w in self.state.writes}
        if None in owners or not self.apart(frozenset(o for o in owners if o is not None)):
            return False
        return all(self._within(w.owner or 0, w.time) for w in self.state.writes)

    def _within(self, owner: int, time: Lin) -> bool:
        activity = self.states.activity(owner)
        after = self.states.difference(time, activity.start)[0] >= 0
        return after and self.states.difference(activity.end, time)[0] >= 0

    def _allowed(self, i: int) -> frozenset[int] | None:
        link = self.linked.get(i)
        return None if link is None else link.read.allowed

    def _possible(self, before: int, after: int) -> bool:
        """Return whether write ``after`` may directly follow ``before`` (-1: the initial value)."""
        if after in self.chained or before in self._followed:
            return self.chained.get(after, -1) == before >= 0
        allowed = self._allowed(after)
        if allowed is None:
            return True
        if before < 0:
            return self.state.initial is not None and self.state.initial in allowed
        value = self.state.writes[before].value
        low, high = self.store.range(value)
        return any(low <= v <= high for v in allowed) if value.terms else value.const in allowed

    def _wants_circuit(self) -> bool:
        writes = self.state.writes
        if 3 * len(self.linked) < len(writes) - len(self.chained) or len(writes) < 2:
            return False
        if any(w.owner is None for w in writes):
            return False
        arcs = sum(
            self._possible(i, j)
            for j in range(len(writes))
            for i in range(-1, len(writes))
            if i != j
        )
        return arcs <= LIMITS.circuit_arcs

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
                if i != j and self._possible(i, j) and self._orderable(i, j):
                    literal = self.arcs[i, j] = store.boolean()
                    arcs.append((i + 1, j + 1, store.raw(literal)))
                    self._follow(i, j, literal)
        arcs.append((0, 0, store.raw(last[n])))
        store.model.add_circuit(arcs)
        self.last = last

    @cached_property
    def _followed(self) -> frozenset[int]:
        """Writes that are followed by another one of the same activity."""
        return frozenset(self.chained.values())

    def _orderable(self, i: int, j: int) -> bool:
        if i < 0:
            return True
        a, b = self.state.writes[i], self.state.writes[j]
        return a.owner != b.owner or self.states.difference(b.time, a.time)[1] > 0

    def _follow(self, i: int, j: int, literal: Literal) -> None:
        """State what follows when write ``j`` comes right after ``i`` (-1: the initial value)."""
        store, write = self.store, self.state.writes[j]
        store.enforce(self.until[i].le(write.time), (literal,))
        link = self.linked.get(j)
        earliest = write.time if link is None else link.read.lo
        if i >= 0:
            store.enforce(self.state.writes[i].time.shift(1).le(earliest), (literal,))
        if link is not None:
            value = constant(self.state.initial or 0) if i < 0 else self.state.writes[i].value
            self._supports(value, link.read, literal)

    def _supports(self, value: Lin, read: Read, literal: Literal) -> None:
        """State that a read finds a ``value``, which may be among those that it allows."""
        if read.value is not None:
            self.store.enforce(compare(read.value.plus(value, -1), "=="), (literal,))
        elif value.terms and read.allowed is not None:
            var = self.states._plain(value)
            some = [self.store.is_value(var, v) for v in sorted(read.allowed)]
            self.store.clause([~literal, *some])

    # -- reads ---------------------------------------------------------------------------------
    def add_read(self, read: Read) -> None:
        """Add a read: supported by one write, or the initial value, that reigns throughout."""
        if read.active == FALSE:
            return
        if read.guard_only:
            self._guard(read)
            return
        check_time()
        store = self.store
        after = read.hi.plus(self._margin(read))
        supporters: list[Literal] = []
        for i, write in enumerate(self.state.writes):
            literal = self._supporter(i, write, read)
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

    def _supporter(self, i: int, write: Write, read: Read) -> Literal | None:
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

    def _guard(self, read: Read) -> None:
        guard(self.states, self.state, read)
