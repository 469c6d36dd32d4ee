"""What the last move to a stop needs, in the routing relaxation: doors that hold still, places.

Alternatives have the same times, so they share one leg and one stay. Travellers who meet come each
in their own time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.forms import TRUE, Form, Lin, Literal, constant, disjunction
from up_samp.scheduling.cpsat.encode.states import Key, StateVar
from up_samp.scheduling.cpsat.encode.store import ModelStore
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.routing.dispatch import UnitPlace
from up_samp.scheduling.cpsat.routing.levels import RouteLevel
from up_samp.scheduling.cpsat.routing.route import Entrance, Route, Still


@dataclass(frozen=True)
class Arc:
    """One way to come to a stop: from stop ``i`` (0: from the start, at ``since``) in ``distance``
    or more, where ``lead`` is the rest between the activity before and the first move.

    ``hop`` is the move's (from, to) on a direct way. ``last`` is the least duration of the last
    move (0: there is none), ``rest`` the time from its end to the stop. ``around`` are (distance,
    last) of ways round about whose last move is quicker. ``stays``: nobody need have moved.
    """

    i: int
    literal: Literal
    since: Lin
    lead: int
    distance: int
    last: int
    rest: int
    hop: tuple[int, int] | None = None
    around: tuple[int, int] | None = None
    stays: bool = False


@dataclass
class LegTimes:
    """The last move to a stop: it starts at ``begin`` and ends at ``end``, or lasts longer."""

    begin: Lin
    end: Lin
    still: Still
    travels: list[Literal] = field(default_factory=list)
    opened: set[Key] = field(default_factory=set)
    """State variables that have changed before it starts."""


class LegVariables:
    """All legs of a routing relaxation, and who holds which unary place."""

    def __init__(
        self, store: ModelStore, limit: int, units: list[UnitPlace], routes: list[Route]
    ) -> None:
        self.store = store
        counts = Counter(name for route in routes for name, _ in route.stops)
        self._meetings = {name for name, count in counts.items() if count > 1}
        self.limit = limit
        self.units = units
        self.legs: dict[
            tuple[int, frozenset[tuple[Key, tuple[int, int]]], Key | None], LegTimes
        ] = {}
        self._since: dict[
            tuple[UnitPlace, int, int, Key | None], tuple[Lin, Lin, list[Literal]]
        ] = {}

    def when(self, form: Form, *literals: Literal) -> None:
        """Demand a comparison whatever it needs: ``literals`` say that those are present."""
        bare = form._replace(needs=()) if form.__class__ is not int else form
        self.store.enforce(bare, literals)

    def add(self, route: Route, stop: ActivityVars, arcs: list[Arc]) -> LegTimes | None:
        """State when the last move to a stop happens."""
        if not route.still or not any(arc.last for arc in arcs):
            return None
        store = self.store
        key = (stop.start.terms[0][0], frozenset(route.still.items()), self._who(route, stop))
        leg = self.legs.get(key)
        if leg is None:
            begin, end = (Lin(((store.integer(0, self.limit), 1),)) for _ in range(2))
            leg = self.legs[key] = LegTimes(begin, end, route.still)
        detour = store.boolean()
        for arc in arcs:
            if arc.last:
                leg.travels.append(arc.literal)
                self.when(arc.since.shift(arc.lead).le(leg.begin), arc.literal)
                self.when(leg.end.shift(arc.rest).le(stop.start), arc.literal)
                if arc.around is None:
                    self.when(leg.begin.shift(arc.last).le(leg.end), arc.literal)
                    continue
                distance, last = arc.around
                soonest = arc.since.shift(arc.lead + distance - route.step + arc.rest)
                self.when(leg.begin.shift(arc.last).le(leg.end), arc.literal, ~detour)
                self.when(leg.begin.shift(last).le(leg.end), arc.literal)
                self.when(soonest.le(stop.start), arc.literal, detour)
        return leg

    def _who(self, route: Route, stop: ActivityVars) -> Key | None:
        """Return who comes to a stop, if it is not just one of its alternative travellers."""
        return route.key if stop.name in self._meetings else None

    def open_before(self, leg: LegTimes, arcs: list[Arc], entry: Entrance, time: Lin) -> None:
        """State that what a move needs changed, at ``time``, before it: not in its midst."""
        if entry.state in leg.still:
            leg.opened.add(entry.state)
            for arc in arcs:
                if arc.last:
                    self.when(time.le(leg.begin.shift(leg.still[entry.state][0])), arc.literal)

    def keep_still(self, states: dict[Key, StateVar]) -> None:
        """Let nothing that moves keep as it is change strictly inside a leg."""
        store = self.store
        for key in sorted({k for leg in self.legs.values() for k in leg.still}, key=str):
            state = states.get(key)
            if state is None or state.numeric:
                continue
            events: dict[Lin, list[Literal]] = {}
            for write in state.writes:
                events.setdefault(write.time._replace(needs=()), []).append(write.active)
            for time, active in events.items():
                happens = store.any_of(active)
                for (start, _, _), leg in self.legs.items():
                    own = any(v == start for v, _ in time.terms)
                    done = key in leg.opened and len(events) == 1
                    if key in leg.still and not own and not done:
                        self._apart(leg, key, time, happens)

    def _apart(self, leg: LegTimes, key: Key, time: Lin, happens: Literal) -> None:
        store = self.store
        before, after = store.boolean(), store.boolean()
        first, last = leg.still[key]
        self.when(time.le(leg.begin.shift(first)), before)
        self.when(leg.end.shift(last).le(time), after)
        store.clause([before, after, ~store.any_of(leg.travels), ~happens])

    # -- unary places ------------------------------------------------------------------------
    def stay(
        self, route: Route, stop: ActivityVars, places: frozenset[int], arcs: list[Arc]
    ) -> None:
        """State that a traveller holds a unary place from its arrival to its departure."""
        store = self.store
        for unit in self.units:
            if not places <= unit.places_of(route.key):
                continue
            key = (unit, stop.start.terms[0][0], route.gap, self._who(route, stop))
            if key not in self._since:
                begin = Lin(((store.integer(0, self.limit), 1),))
                self._since[key] = (begin, stop.end.shift(route.gap)._replace(needs=()), [])
            since, _, present = self._since[key]
            present.append(stop.present)
            for arc in arcs:
                if arc.distance:
                    self.when(since.shift(arc.rest).le(stop.start), arc.literal)
                elif arc.stays:
                    before = arc.since.shift(arc.lead) if arc.i else constant(0)
                    self.when(since.le(before), arc.literal)

    def hold(self, surely: Callable[[Iterable[Literal]], bool]) -> None:
        """State that stays at a unary place do not overlap; ``surely`` tells of some presences
        whether one of them is true.
        """
        store = self.store
        intervals: dict[UnitPlace, list[object]] = {}
        for (unit, *_), (since, until, present) in self._since.items():
            size = store.integer(0, self.limit)
            there = TRUE if surely(present) else store.any_of(present)
            interval = store.interval(since, Lin(((size, 1),)), until, there)
            intervals.setdefault(unit, []).append(interval)
        for some in intervals.values():
            if len(some) > 1:
                store.model.add_no_overlap(some)


def entry_form(stop: ActivityVars, time: Lin, lead: int) -> Form:
    """State that ``time`` comes ``lead`` or more before ``stop``, if that is present."""
    return disjunction([~stop.present, time.shift(lead).le(stop.start)])


# ------------------ What travellers have left on their way, in the routing relaxation
# As a traveller does one thing at a time, the level at a stop follows from the one at the stop
# before, less what the way takes at least. So a schedule of the relaxation charges about where one
# of the problem has to.


class Course:
    """A level along a route: what is left at most when its traveller comes to each stop."""

    def __init__(
        self,
        store: ModelStore,
        level: RouteLevel,
        stops: Sequence[tuple[ActivityVars, frozenset[int]]],
    ) -> None:
        self._store = store
        self._level = level
        self._stops = stops
        low, high = level.low, level.high
        self._left = [Lin(((store.integer(low, high), 1),)) for _ in range(len(stops) + 1)]
        store.enforce(self._left[0].le(constant(level.initial)))

    def come(self, j: int, arcs: Iterable[Arc]) -> None:
        """State that who comes to stop ``j`` (from 1 on) has no more than was left before, less
        what the way takes.
        """
        for arc in arcs:
            change = -self._level.taken(self._places(arc.i), self._places(j))
            before = self._left[arc.i].shift(self._gain(arc.i) + change)
            self._store.enforce(self._left[j].le(before), (arc.literal,))

    def leave(self, j: int, literal: Literal, final: frozenset[int] | None) -> None:
        """State that what is left after the last stop ``j`` is enough for the way to ``final``."""
        back = 0 if final is None else self._level.taken(self._places(j), final)
        least = constant(self._level.low + back - self._gain(j))
        self._store.enforce(least.le(self._left[j]), (literal,))

    def _places(self, j: int) -> frozenset[int]:
        return self._stops[j - 1][1] if j else frozenset((self._level.start,))

    def _gain(self, j: int) -> int:
        return self._level.gains.get(self._stops[j - 1][0].name, 0) if j else 0
