"""What travellers have, carry and need beside the places where they are: what comes with what, and
states of their own (forks, levels).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Literal,
    difference_told,
    parts_of,
)
from up_samp.scheduling.cpsat.encode.states import StateVar
from up_samp.scheduling.cpsat.encode.terms import INFINITE
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.route import Route

Way = tuple[int, int]
"""(task, number of its way)."""


# ------------------ What ways to do tasks ask of each other


@dataclass
class WayNeeds:
    """What one way to do a task asks besides its place: ``along``: the ways of others that come
    with it; ``first``: (way that comes before it, time from its start). Both are as stated.
    """

    along: list[Way] = field(default_factory=list)
    first: list[tuple[Way, int]] = field(default_factory=list)

    @property
    def ended(self) -> dict[Way, int]:
        """What comes with it and before it, and how long before (from start to start)."""
        return {way: gap for way, gap in self.first if way in self.along}


def ways_with(model: ScheduleModel, names: Mapping[str, Way]) -> dict[Literal, list[Way]]:
    """Return which ways to do tasks come with a literal (of a presence, say): by clauses of two.
    ``names`` are those of the stops.
    """
    own: dict[Literal, list[Way]] = {}
    for name, way in names.items():
        own.setdefault(model.world.activities[name].present, []).append(way)
    found = {literal: [*some] for literal, some in own.items()}
    for form in model.stated:
        parts = parts_of("|", form)
        if [part.__class__ for part in parts] == [int, int]:
            for one, other in (parts, parts[::-1]):
                found.setdefault(~one, []).extend(own.get(other, ()))
    return found


def find_needs(
    model: ScheduleModel, names: Mapping[str, Way], coming: Mapping[Literal, list[Way]]
) -> dict[Way, WayNeeds]:
    """Return what the ways to do tasks ask of each other; ``names`` are those of the stops, and
    ``coming`` with each literal.
    """
    activities = model.world.activities
    present = {way: activities[name].present for name, way in names.items()}
    needs = {w: WayNeeds([o for o in coming[p] if o != w]) for w, p in present.items()}
    starting: dict[int, list[Way]] = {}
    for name, way in names.items():
        starting.setdefault(activities[name].start.terms[0][0], []).append(way)
    for asked, gaps in gaps_told(model).items():
        for first in gaps.keys() & starting.keys():
            for last, gap in (later_than(gaps, first) if asked else gaps[first]).items():
                pairs = itertools.product(starting[first], starting.get(last, ()))
                for before, then in pairs:
                    if gap >= 0 and asked <= {present[before], present[then]}:
                        needs[then].first.append((before, gap))
    return needs


Gaps = dict[int, dict[int, int]]
"""(time, time) -> how much later than the first the other is, at least."""


def gaps_told(model: ScheduleModel) -> dict[frozenset[int], Gaps]:
    """Return the gaps between times that are stated, by the presences that they hang on."""
    found: dict[frozenset[int], Gaps] = {}
    for activity in model.world.activities.values():
        start, end = activity.start, activity.end
        if start.terms != end.terms:
            lasts = activity.least + start.const - end.const
            gaps = found.setdefault(frozenset({activity.present} - {TRUE}), {})
            gaps.setdefault(start.terms[0][0], {})[end.terms[0][0]] = lasts
    for form in model.stated:
        parts = parts_of("|", form)
        stated = [part for part in parts if part.__class__ is not int]
        told = difference_told(stated[0]) if len(stated) == 1 else None
        if told is not None:
            first, last, gap = told
            asked = {~part for part in parts if part.__class__ is int} | {*stated[0].needs}
            then = found.setdefault(frozenset(asked), {}).setdefault(first, {})
            then[last] = max(gap, then.get(last, gap))
    return found


def later_than(gaps: Gaps, first: int) -> dict[int, int]:
    """Return how much later other times are than one, by all gaps between some."""
    later, changed = {first: 0}, {first}
    for _ in gaps:
        since, changed = changed, set()
        for one in since:
            for other, gap in gaps.get(one, {}).items():
                if later[one] + gap > later.get(other, -INFINITE):
                    later[other] = later[one] + gap
                    changed.add(other)
    del later[first]
    return later


# ------------------ States that one traveller alone changes
# By its stops: a fork that is taken, a level that is filled up. (A battery, from which moves take,
# is none.)


@dataclass(frozen=True)
class OwnState:
    """A state that the traveller of one ``route`` (its number) alone changes, within ``least`` and
    ``most``: each stop between its start and the next thing that it does, to a value (``settings``)
    or by it (``gains``). ``reads``: the values that ways to do tasks ask for as they begin.
    """

    route: int
    initial: int
    least: int
    most: int
    gains: dict[Way, int]
    settings: dict[Way, int]
    reads: dict[Way, frozenset[int]]

    def after(self, value: int, way: Way) -> int | None:
        """Return its value after a task is done in one way; ``None`` if it cannot be done."""
        new = self.settings.get(way, value + self.gains.get(way, 0))
        fits = value in self.reads.get(way, (value,)) and self.least <= new <= self.most
        return new if fits else None


def find_own_states(
    model: ScheduleModel, routes: list[Route], names: Mapping[str, Way]
) -> list[OwnState]:
    """Return the states that one traveller alone changes, and who sets and asks for what.

    Assumes: what a stop sets is seen before its traveller does anything else, who
    asks for a state excludes that it is set at that time.
    """
    found = (
        _own_state(model, number, route, state, names)
        for number, route in enumerate(routes)
        for state in model.states.vars.values()
    )
    return [own for own in found if own is not None]


def _own_state(
    model: ScheduleModel, number: int, route: Route, state: StateVar, names: Mapping[str, Way]
) -> OwnState | None:
    mine = {name: names[name] for name, _ in route.stops}
    gains, settings = dict[Way, int](), dict[Way, int]()
    for change in model.states.sure_changes(state):
        value, late, way = change.value, change.late[1], mine.get(change.owner.name)
        # what is taken is not taken at the instant at which the next one gives something back
        soon = late < route.gap if change.adds and value < 0 else late <= route.gap
        early = change.since[0] < 0
        if (
            way is None
            or early
            or not soon
            or way in settings
            or (way in gains and not change.adds)
        ):
            return None
        if change.adds:
            gains[way] = gains.get(way, 0) + value
        else:
            settings[way] = value
    if state.initial is None or not (gains or settings):
        return None
    least, most = state.bounds
    # what is given back and taken at one instant may be more meanwhile
    most -= sum(min(0, gain) for gain in gains.values())
    reads = _asked(model, state, mine)
    return OwnState(number, state.initial, least, most, gains, settings, reads)


def _asked(
    model: ScheduleModel, state: StateVar, mine: Mapping[str, Way]
) -> dict[Way, frozenset[int]]:
    """Return the values of which each stop, whenever it is there, finds a state to have one."""
    found: dict[Way, frozenset[int]] = {}
    for read in state.reads:
        owner = None if read.owner is None else model.states.activity(read.owner)
        if owner is None or owner.name not in mine or read.allowed is None:
            continue
        since = model.states.difference(read.lo, owner.start)[0]
        lasts = model.states.difference(read.hi, read.lo)[0]
        own = state.by_owner().get(read.owner, ())
        before = all(model.states.difference(w.time, read.lo)[0] >= 0 for w in own)
        # at its last instant a loose one does not exclude that others set it
        if read.active == owner.present and since >= 0 and lasts >= read.loose and before:
            way = mine[owner.name]
            found[way] = found.get(way, read.allowed) & read.allowed
    return found
