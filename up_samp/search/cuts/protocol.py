"""What failed motion checks tell, and whether refinements reject a candidate."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from up_samp.model import (
    GroupQuery,
    GroupReport,
    Outcome,
    Placed,
    ScheduledMotion,
    TimedMotion,
)
from up_samp.model.refinement import Refinement, Strength
from up_samp.model.snapshot import Snapshot
from up_samp.refinement import holds, rules, timed
from up_samp.search.facts import Facts, MotionCase, are_apart
from up_samp.search.knowledge import Knowledge
from up_samp.search.motions import Motions
from up_samp.search.world import motion_key, places_between
from up_samp.upio import Itinerary

Alike = Callable[[Facts, ScheduledMotion], list[MotionCase]]
"""Returns the case that a motion is, and all that a cut for it holds for as well."""


@dataclass(frozen=True)
class Alone:
    """The failure of one motion alone: ``motion`` among ``obstacles``, of which those in ``places``
    (by configuration) may be moved; ``cases`` are the motions that are the same and keep clear of
    what this one met.
    """

    motion: ScheduledMotion
    obstacles: tuple[Placed, ...]
    places: Mapping[str, str]
    cases: tuple[MotionCase, ...]
    why: str
    strength: Strength


@dataclass(frozen=True)
class Failure:
    """One group of a candidate, what was asked and answered. ``cut_short``: time was up.

    ``alike`` tells for which motions a cut is to be stated.
    """

    motions: Motions
    knowledge: Knowledge
    alike: Alike
    itinerary: Itinerary
    group: Sequence[ScheduledMotion]
    query: GroupQuery
    report: GroupReport
    cut_short: bool

    @property
    def facts(self) -> Facts:
        """The problem's facts."""
        return self.motions.facts

    @property
    def found(self) -> bool:
        """Whether there are trajectories at all (then some are late)."""
        return self.report.outcome is Outcome.FOUND

    @property
    def strength(self) -> Strength:
        """What the lateness is worth. A search that was cut short proves nothing; nor does one for
        several robots unless all ways to coordinate them were tried.
        """
        alone = len({m.object for m in self.group}) == 1
        searched = self.report.complete and not self.cut_short
        proves = self.found and searched and (alone or self.report.exhaustive)
        return Strength.RELATIVE if proves else Strength.HEURISTIC

    @cached_property
    def scheduled(self) -> dict[str, ScheduledMotion]:
        """The group's motions by the names that reports use."""
        return {motion_key(m): m for m in self.group}

    @cached_property
    def timed(self) -> dict[str, TimedMotion]:
        """What was asked about each motion, by the same names."""
        return {m.name: m for m in self.query.motions}

    @cached_property
    def conflict(self) -> list[ScheduledMotion]:
        """The motions that conflict: as few as the planner could tell, at least the late ones,
        with what else their objects do meanwhile: an object is in the way until it drives on.
        """
        names = {*self.report.conflict, *self.report.late} or set(self.scheduled)
        core = [m for m in self.group if motion_key(m) in names]
        objects = {name for m in core for name in m.moved}
        first, last = min(m.start for m in core), max(m.end for m in core)
        return [
            m
            for m in self.group
            if motion_key(m) in names or (m.moved & objects and m.start <= last and m.end >= first)
        ]

    def pairs_like(
        self, one: ScheduledMotion, other: ScheduledMotion
    ) -> list[tuple[MotionCase, MotionCase]]:
        """Return two of the group's motions and then, where they heed each other, all pairs of two
        objects' motions that are the same to the planner.
        """
        facts = self.facts
        own = facts.case(one), facts.case(other)
        if not are_apart(*own):
            return [own]
        pairs = itertools.product(self.alike(facts, one), self.alike(facts, other))
        return [own, *(pair for pair in pairs if pair != own and are_apart(*pair))]

    def rivals(self, motions: Sequence[ScheduledMotion]) -> list[str]:
        """Return the other motion activities of the same objects: they might clear the way."""
        objects = {name for m in motions for name in m.moved}
        mine = {m.activity for m in motions}
        snapshot = self.facts.snapshot
        drives = {t.activity for name in objects for t in snapshot.by_object.get(name, ())}
        rides = {r.activity for r in snapshot.rides if r.load in objects}
        return sorted((drives | rides) - mine)

    def arrivals(self, motions: Sequence[ScheduledMotion]) -> dict[str, int]:
        """Return the ends that late ones need, in units after the first start of ``motions``."""
        first = min(m.start for m in motions)
        late = self.report.late
        return {
            m.activity: self.facts.units(late[motion_key(m)]) - first
            for m in motions
            if motion_key(m) in late
        }

    def blockers(self, motions: Sequence[ScheduledMotion]) -> dict[str, str]:
        """Return who rests in the way of ``motions`` and might not, with its configuration."""
        start = min(m.start for m in motions)
        snapshot = self.facts.snapshot
        return {
            name: self.itinerary.place_at(snapshot, name, start)
            for name in sorted(self.report.blockers)
            if snapshot.movers.get(name)
        }


# ------------------ See to it that what was learned rejects the candidate schedule


def or_exact(failure: Failure, found: list[Refinement]) -> list[Refinement]:
    """Return ``found``, with the exact cut added if nothing of it rejects the candidate."""
    snapshot, group = failure.facts.snapshot, failure.group
    if rejecting(failure.itinerary, snapshot, found):
        return found
    times = failure.itinerary.schedule.times
    mine = {m.activity for m in group}
    exact = timed.as_timed(
        group,
        failure.arrivals(group),
        {name: times.get(name) for name in snapshot.by_activity if name not in mine},
        {
            c.activity: (c.object, times[c.activity][1] if c.activity in times else None)
            for c in snapshot.changes
            if c.activity not in mine
        },
        failure.report.reason or "the group does not work as it is timed",
        strength=failure.strength,
    )
    # where others rest hangs on their decisions, too
    return [*found, rules.only_given(exact, failure.itinerary.given)]


def rejecting(
    itinerary: Itinerary, snapshot: Snapshot, found: Iterable[Refinement]
) -> list[Refinement]:
    """Return the refinements that forbid the candidate schedule."""

    def places(name: str, first: int, last: int) -> set[str]:
        return places_between(itinerary, snapshot, name, first, last)

    return [r for r in found if not holds(r.statement, itinerary.schedule, places)]
