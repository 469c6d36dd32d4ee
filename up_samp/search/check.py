"""Check a candidate schedule's motions, layer by layer (Algorithm 1, lines 8 to 15).

Layer 1 asks for each motion alone whether there is a path and how long it takes; layer 2 whether
the motions of a parallel group can be made as scheduled. Everything that a layer learns from one
candidate is collected, unless the cuts stop at the first refinement as the paper does.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

from up_samp.model import (
    GroupQuery,
    GroupReport,
    Outcome,
    PathQuery,
    ScheduledMotion,
    Trajectory,
    avoids,
)
from up_samp.model.refinement import Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.cuts import Alone, Failure, SmallCuts, blocked, rejecting
from up_samp.search.events import Phase, Telling
from up_samp.search.facts import Facts, MotionCase
from up_samp.search.knowledge import Knowledge
from up_samp.search.world import (
    Motions,
    group_query,
    groups_of,
    instant_obstacles,
    motion_key,
    touching,
)
from up_samp.upio import Itinerary

MOST_NAMED = 3
"""So many motions, and things at rest, are named where some were not found."""


@dataclass
class Check:
    """What came of a candidate: trajectories for all motions, or refinements.

    ``needed`` are ends (units) that motions need beyond what was scheduled, for repairs.
    ``failed`` are motions that found no trajectory at all.
    """

    trajectories: dict[str, Trajectory] = field(default_factory=dict)
    refinements: list[Refinement] = field(default_factory=list)
    needed: dict[str, int] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)

    @property
    def passed(self) -> bool:
        """Whether every motion can be made as scheduled."""
        return not self.refinements and not self.needed and not self.failed


CheckAlone = Callable[["Checker", Itinerary, ScheduledMotion, Check], list[Refinement]]
"""One layer that checks a motion alone and returns what it tells."""


@dataclass(frozen=True)
class Checker:
    """Checks candidates. ``layers`` look at each motion alone, in order, until one finds something;
    ``thorough``: groups are driven also where a motion alone does
    not fit (repairs need that).
    """

    motions: Motions
    knowledge: Knowledge
    cuts: SmallCuts
    layers: tuple[CheckAlone, ...]
    tell: Telling
    thorough: bool = True
    seed: int = 0

    def check(self, itinerary: Itinerary, *, learn: bool = True) -> Check:
        """Check all motions of a candidate (lines 8 to 15); without ``learn`` groups are asked for
        trajectories alone, and teach nothing.
        """
        check, first_only = Check(), learn and self.cuts.first_only
        deadline = self.motions.budget.deadline
        with self.motions.budget.motion_time():
            for group in groups_of(itinerary.motions):
                self._check_group(itinerary, group, check, learn=learn)
                over = deadline.expired()  # asked once: what is left then has failed
                if over:
                    check.failed |= {motion_key(m) for m in group}
                if over or (first_only and not check.passed):
                    break
        return check

    def _check_group(
        self,
        itinerary: Itinerary,
        group: Sequence[ScheduledMotion],
        check: Check,
        *,
        learn: bool,
    ) -> None:
        names = {motion_key(m) for m in group}
        first_only = learn and self.cuts.first_only
        found = self._check_alone(itinerary, group, check, first_only=first_only)
        check.refinements += found
        if (found and not self.thorough) or names & check.failed:
            return
        query = group_query(self.motions.facts, itinerary, group)
        report = self._coordinate(query)
        check.trajectories.update(report.trajectories)
        if report.outcome is not Outcome.FOUND:
            check.failed |= report.conflict or names
        for name, arrival in report.late.items():
            check.needed[name] = self.motions.facts.units(arrival)
        if report.outcome is Outcome.FOUND and not report.late:
            return
        wrong = report.conflict or report.late.keys() or names
        missed = [m for m in group if motion_key(m) in wrong]
        self.note(missed, report.blockers, itinerary, report.reason)
        if learn and not found:
            asked = itinerary, group, query, report
            failure = Failure(self.motions, self.knowledge, *asked)
            check.refinements += self.cuts.group(failure)

    def note(
        self,
        motions: Sequence[ScheduledMotion],
        among: Iterable[str],
        itinerary: Itinerary,
        reason: str = "",
    ) -> None:
        """Note for people which motions were not found, among what that rests in their way, and
        that they begin or end in touch with something, if the ``reason`` is that.
        """
        facts, start = self.motions.facts, min(m.start for m in motions)
        told = " with ".join(str(facts.case(m)) for m in motions[:MOST_NAMED])
        for name in sorted(facts.snapshot.movers.keys() & set(among))[:MOST_NAMED]:
            told += f", {name} being at {itinerary.place_at(facts.snapshot, name, start)}"
        self.knowledge.history.missed.append(told + touching(reason))

    def _check_alone(
        self,
        itinerary: Itinerary,
        group: Sequence[ScheduledMotion],
        check: Check,
        *,
        first_only: bool,
    ) -> list[Refinement]:
        """Return what the first layer tells that finds something."""
        for layer in self.layers:
            told = (layer(self, itinerary, motion, check) for motion in group)
            some = next(filter(None, told), []) if first_only else itertools.chain(*told)
            if found := list(some):
                return found
        return []

    def _coordinate(self, query: GroupQuery) -> GroupReport:
        """Ask the motion service for a group."""
        if len(query.motions) > 1:
            self.tell.stage(Phase.GROUP, count=len(query.motions))
        deadline = self.motions.budget.group(len(query.motions))
        seed = self.seed + self.knowledge.history.restarts
        return self.motions.service.coordinate(query, deadline, seed=seed)


def check_path(
    checker: Checker, itinerary: Itinerary, motion: ScheduledMotion, check: Check
) -> list[Refinement]:
    """Layer 1, geometric: is there a path among what rests all through the motion's time?"""
    motions, facts = checker.motions, checker.motions.facts
    body = facts.body(motion)
    obstacles = instant_obstacles(facts, itinerary, motion)
    report = motions.path(PathQuery(body, motion.poses, obstacles))
    if report.outcome is Outcome.FOUND:
        return []
    check.failed.add(motion_key(motion))
    among = report.blockers or {o.name for o in obstacles}
    checker.note([motion], among, itinerary, report.reason)
    proven = report.outcome is Outcome.IMPOSSIBLE
    why = facts.case(motion).why_not(report) or f"no path for {motion.activity} found"
    strength = Strength.PROVEN if proven else Strength.HEURISTIC
    names = report.blockers if proven else frozenset(o.name for o in obstacles)
    concerned = _concerned(checker, itinerary, motion, names)
    alone = Alone(motion, obstacles, *concerned, why, strength)
    if not alone.places:
        never = ((rules.impossible(c.activity, alone.why), c.given) for c in alone.cases)
        return [replace(rules.only_given(r, g), strength=alone.strength) for r, g in never]
    found = blocked(facts, alone) if proven else checker.cuts.no_path(motions, alone)
    if not rejecting(itinerary, facts.snapshot, found):
        found.append(_blocked_as_timed(facts, itinerary, alone))
    return found


def check_duration(
    checker: Checker, itinerary: Itinerary, motion: ScheduledMotion, check: Check
) -> list[Refinement]:
    """Layer 1, temporal: does the motion alone fit its scheduled time?"""
    motions, facts = checker.motions, checker.motions.facts
    body = facts.body(motion)
    told = checker.cuts.unobstructed(motions, checker.knowledge, facts.like(motion))
    found = rejecting(itinerary, facts.snapshot, told)
    if found:
        return found
    obstacles = instant_obstacles(facts, itinerary, motion)
    query = PathQuery(body, motion.poses, obstacles)
    report, strength = motions.fastest(query, motions.budget.query())
    if report.trajectory is None:
        return []
    units = facts.units(report.trajectory.duration)
    if units <= motion.end - motion.start:
        return []
    why = f"the fastest motion found takes {report.trajectory.duration:.2f} s"
    names = frozenset(o.name for o in obstacles)
    concerned = _concerned(checker, itinerary, motion, names)
    alone = Alone(motion, obstacles, *concerned, why, strength)
    found = checker.cuts.too_slow(motions, alone, units)
    if not rejecting(itinerary, facts.snapshot, found):
        exact = _blocked_as_timed(facts, itinerary, alone)
        found.append(rules.unless_longer(exact, motion.activity, units))
    return found


def _concerned(
    checker: Checker, itinerary: Itinerary, motion: ScheduledMotion, names: frozenset[str]
) -> tuple[dict[str, str], tuple[MotionCase, ...]]:
    """Return where those of the objects ``names`` that may move rest when a motion starts, and the
    motion's case with those that are the same motion with equal bodies and heed all of them too,
    as far as the cuts are stated for them.
    """
    snapshot = checker.motions.facts.snapshot
    moved = [n for n in names if snapshot.movers[n]]
    places = {n: itinerary.place_at(snapshot, n, motion.start) for n in moved}
    mine, *others = checker.cuts.alike(checker.motions.facts, motion)
    heeding = [c for c in others if avoids(c.task.avoid, *names)]
    return places, tuple(sorted([mine, *heeding], key=lambda c: (c.activity, c.given)))


def _blocked_as_timed(facts: Facts, itinerary: Itinerary, alone: Alone) -> Refinement:
    """Return the cut for the blockers' changes as they are ordered."""
    motion = alone.motion
    set_by: dict[str, str | None] = {}
    changes: dict[str, dict[str, int]] = {}
    given = dict(motion.given)
    for name in alone.places:
        times = itinerary.schedule.times
        movers = sorted(facts.snapshot.movers[name])
        ends = {a: times[a][1] if a in times else -1 for a in movers}
        before = [(time, a) for a, time in ends.items() if 0 <= time <= motion.start]
        set_by[name] = max(before)[1] if before else None
        changes[name] = ends
        for change in itinerary.changes:
            if (change.object, change.activity) == (name, set_by[name]):
                given |= dict(change.given)
        for drive in itinerary.motions:
            if name in drive.moved and drive.activity == set_by[name]:
                given |= dict(drive.given)
    rides = {ride.activity for ride in facts.snapshot.rides if ride.load in set_by}
    cut = rules.blocked_as_timed(
        motion, set_by, changes, alone.why, rides=rides, strength=alone.strength
    )
    return rules.only_given(cut, tuple(sorted(given.items())))
