"""What a failed check tells the scheduler: as few motions as really conflict, with the rivals that
matter, or the cuts of the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from up_samp.model import (
    GroupQuery,
    GroupReport,
    Outcome,
    PathQuery,
    Placed,
    ScheduledMotion,
    TimedMotion,
    Violation,
    avoids,
)
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.model.snapshot import Snapshot
from up_samp.refinement import rules
from up_samp.search.facts import Facts, MotionCase
from up_samp.search.knowledge import Knowledge
from up_samp.search.statements import blocked_while, duration_of
from up_samp.search.world import Motions, motion_key, places_between, remaining
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
    """One group of a candidate, what was asked and answered. What it tells is a guess: other ways,
    or other places to wait at, than those that were tried may do.
    """

    motions: Motions
    knowledge: Knowledge
    itinerary: Itinerary
    group: Sequence[ScheduledMotion]
    query: GroupQuery
    report: GroupReport

    @property
    def facts(self) -> Facts:
        """The problem's facts."""
        return self.motions.facts

    @property
    def found(self) -> bool:
        """Whether there are trajectories at all (then some are late)."""
        return self.report.outcome is Outcome.FOUND

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
    exact = rules.as_timed(
        group,
        failure.arrivals(group),
        {name: times.get(name) for name in snapshot.by_activity if name not in mine},
        {
            c.activity: (c.object, times[c.activity][1] if c.activity in times else None)
            for c in snapshot.changes
            if c.activity not in mine
        },
        failure.report.reason or "the group does not work as it is timed",
    )
    # where others rest hangs on their decisions, too
    return [*found, rules.only_given(exact, failure.itinerary.given)]


def rejecting(
    itinerary: Itinerary, snapshot: Snapshot, found: Iterable[Refinement]
) -> list[Refinement]:
    """Return the refinements that forbid the candidate schedule."""

    def places(name: str, first: int, last: int) -> set[str]:
        return places_between(itinerary, snapshot, name, first, last)

    return [r for r in found if not r.statement.holds(itinerary.schedule, places)]


# ------------------ Small cuts: general refinements where there are any, exact ones else
# A failed group's attempts are tried in order; the first that rejects the candidate wins. If none
# does, the group is forbidden just as it was timed.


Attempt = Callable[[Failure, str], list[Refinement]]
"""Returns what may be learned from one late motion (by its name) of a failed group."""


@dataclass(frozen=True)
class SmallCuts:
    """Groups shrunk to what conflicts, with only the rivals that matter; other sets of cuts answer
    the same questions. ``alike``: for which motions a cut is stated; ``first_only``: whether a
    check ends with the first refinement, as in the paper.
    """

    alike: Alike
    attempts: tuple[Attempt, ...] = ()
    first_only: bool = False

    def unobstructed(
        self, motions: Motions, knowledge: Knowledge, cases: Sequence[MotionCase]
    ) -> list[Refinement]:
        """Return what the duration among fixed obstacles of ``cases``, one motion, tells."""
        return duration_of(motions, knowledge, cases, motions.budget.query())

    def no_path(self, motions: Motions, alone: Alone) -> list[Refinement]:
        """Return what it tells that a motion found no path, without a proof: it and all alike must
        not be made while the blockers rest there.
        """
        return blocked(motions.facts, alone)

    def too_slow(self, motions: Motions, alone: Alone, units: int) -> list[Refinement]:
        """Return what it tells that a motion takes ``units`` alone: it and all alike take that long
        while the blockers rest there.
        """
        movers, why, strength = motions.facts.snapshot.movers, alone.why, alone.strength
        places = _that_delay(motions, alone, units)
        found = []
        for case in alone.cases:
            left = remaining(places, case, motions.there)
            cut = (
                rules.slower_while(case.activity, units, left, movers, why, strength=strength)
                if left
                else rules.lasts(case.activity, units, why, layer=Layer.TEMPORAL, strength=strength)
            )
            found.append(rules.only_given(cut, case.given))
        return found

    def group(self, failure: Failure) -> list[Refinement]:
        """Return refinements that reject a group which failed together."""
        if not failure.found:
            return or_exact(failure, [_together_cut(failure)])
        found: list[Refinement] = []
        for name in sorted(failure.report.late, key=lambda n: (failure.timed[n].release, n)):
            tried = (attempt(failure, name) for attempt in self.attempts)
            snapshot = failure.facts.snapshot
            found += next((t for t in tried if rejecting(failure.itinerary, snapshot, t)), [])
            if failure.motions.budget.deadline.expired():
                break
        return or_exact(failure, found or [_timing_cut(failure)])


def _that_delay(motions: Motions, alone: Alone, units: int) -> dict[str, str]:
    """Return the blockers (with their places) that let the motion take ``units``, none too many: a
    cut that names fewer of them holds more often, and proves more.
    """
    body = motions.facts.body(alone.motion)
    kept, places = alone.obstacles, dict(alone.places)
    for name in sorted(alone.places):
        if alone.strength is Strength.HEURISTIC or motions.budget.deadline.expired():
            break
        fewer = tuple(o for o in kept if o.name != name)
        query = PathQuery(body, alone.motion.poses, fewer)
        report, strength = motions.fastest(query, motions.budget.query())
        found = report.trajectory
        if found is None or strength is Strength.HEURISTIC:
            continue
        if motions.facts.units(found.duration) >= units:
            kept = fewer
            del places[name]
    return places


def blocked(facts: Facts, alone: Alone) -> list[Refinement]:
    """State that the motion and all alike must not be made while the blockers rest there."""
    return blocked_while(facts, alone.cases, alone.places, alone.why, alone.strength)


def _together_cut(failure: Failure) -> Refinement:
    """State that motions do not go together: as they are timed at first; what fails at other
    offsets, too, is kept apart whatever the offsets.
    """
    names = failure.report.conflict or set(failure.scheduled)
    motions = [m for name, m in failure.scheduled.items() if name in names]
    why = failure.report.reason or "no trajectories found in time"
    together = frozenset(m.activity for m in motions)
    known = failure.knowledge.failed_together
    rule = rules.not_together if together in known else rules.group_fails
    known.add(together)
    return rule(motions, failure.blockers(motions), failure.facts.snapshot.movers, why)


def _timing_cut(failure: Failure) -> Refinement:
    motions = failure.conflict
    arrivals = failure.arrivals(motions)
    why = f"{', '.join(sorted(arrivals))} cannot arrive in time among the others"
    return rules.group_timing(
        motions,
        arrivals,
        failure.blockers(motions),
        failure.facts.snapshot.movers,
        why,
        rivals=failure.rivals(motions),
    )


# ------------------ What the validator has against a plan that the search took for valid
# The search and the validator mean the same, but the search does not look at everything before: it
# may learn from the verdict that something is set onto an object that rests (*proven*: the two
# overlap whatever the motions), or that some activities do not go together as they are timed
# (*heuristic*: a different motion might have done).


def cuts_from(
    facts: Facts, itinerary: Itinerary, refusals: Sequence[Violation]
) -> list[Refinement]:
    """Return refinements that forbid the itinerary's schedule, one for each refusal."""
    found: dict[object, Refinement] = {}
    for refusal in refusals:
        cut = _set_onto(facts, itinerary, refusal) or _as_timed(facts, itinerary, refusal)
        found[cut.statement] = cut
    return list(found.values())


def _set_onto(facts: Facts, itinerary: Itinerary, refusal: Violation) -> Refinement | None:
    """State that an object must not be set to where another one rests, if that is it."""
    if refusal.kind != "collision" or len(refusal.activities) != 1 or len(refusal.objects) != 2:
        return None
    (activity,), (thing, other) = refusal.activities, refusal.objects
    changes = {(c.activity, c.object): c for c in itinerary.changes}
    change = changes.get((activity, thing))
    if change is None:
        return None
    sets = {c.activity for c in facts.snapshot.changes if c.object == other}
    moves = set(facts.snapshot.movers[other]) - sets
    times = itinerary.schedule.times
    before = [(times[a][1], a) for a in moves | sets if a in times and times[a][1] <= change.time]
    setter = max(before)[1] if before else None
    cut = rules.set_onto(
        activity,
        setter,
        {m: times.get(m) for m in sorted(moves)},
        {s: times.get(s) for s in sorted(sets)},
        refusal.what,
    )
    return rules.only_given(cut, itinerary.given)


def _as_timed(facts: Facts, itinerary: Itinerary, refusal: Violation) -> Refinement:
    """State that the activities of a refusal, with what moved its objects last, do not go
    together as they are timed; all that are present where it names none.
    """
    times = itinerary.schedule.times
    names = {a for a in refusal.activities if a in times}
    if names:
        last = max(times[a][1] for a in names)
        for thing in refusal.objects:
            movers = facts.snapshot.movers.get(thing, frozenset()) - names
            names |= {m for m in movers if m in times and times[m][0] <= last}
    cut = rules.exactly_as_timed({n: times[n] for n in sorted(names or times)}, refusal.what)
    return rules.only_given(cut, itinerary.given)


# ------------------ The cuts of the paper, as Tosello et al. (ICAPS 2026) write them
# Every rival, every other object's place: RCOND, CHCONF and CHTIME.


_EXPLORE_SHARE = 0.2
"""Of a query's time, for which the paper's tree grows on to tell what it reaches."""


@dataclass(frozen=True)
class PaperCuts(SmallCuts):
    """Refinements as they were published, instead.

    ``widened``: a cut for no path is stated for all motions of equal bodies from where the tree
    was to where it did not come. ``seed`` is for the tree.
    """

    first_only: bool = True
    widened: bool = True
    seed: int = 0

    def unobstructed(
        self, motions: Motions, knowledge: Knowledge, cases: Sequence[MotionCase]
    ) -> list[Refinement]:
        """Return nothing: a motion is only planned among what rests when it is scheduled."""
        return []

    def no_path(self, motions: Motions, alone: Alone) -> list[Refinement]:
        """State that a motion has no path while blocking obstacles rest: RCOND -> CHCONF.

        An RRT tells the blockers (an extension ran into them) and the unreachable configurations.
        """
        facts, motion = motions.facts, alone.motion
        cases, blockers = self._explored(motions, motion, alone.obstacles)
        places = {n: c for n, c in alone.places.items() if n in blockers} or alone.places
        return [
            Refinement(
                rules.paper_geometric((_under(motion, case),), _movers(facts, places), places),
                Layer.GEOMETRIC,
                Strength.HEURISTIC,
                alone.why,
            )
            for case in dict.fromkeys((facts.case(motion), *cases))
        ]

    def _explored(
        self, motions: Motions, motion: ScheduledMotion, obstacles: tuple[Placed, ...]
    ) -> tuple[list[MotionCase], frozenset[str]]:
        """Return the motions that an RRT tells impossible with this one, and what blocked it."""
        facts, budget = motions.facts, motions.budget
        body = facts.body(motion)
        able = body.mobility
        if not (able.steers or able.sideways) or len(motion.poses) != 2:
            return [], frozenset()
        from up_samp.motion.planners.ompl import explore  # not everywhere is OMPL

        same = [s for s in facts.by_signature if s[0] == body and len(s[1]) == 2]
        targets = {str(pose): pose for s in same for pose in s[1]}
        deadline = budget.deadline.within(_EXPLORE_SHARE * budget.query_seconds)
        query = PathQuery(body, motion.poses, obstacles)
        scene = motions.service.scene
        arrived, found, blockers = explore(scene, query, targets, deadline, seed=self.seed)
        if arrived or not self.widened:
            return [], blockers
        reached = {*found, str(motion.poses[0])}
        cases = [
            case
            for signature in same
            if str(signature[1][0]) in reached and str(signature[1][1]) not in reached
            for case in facts.by_signature[signature]
            if avoids(case.task.avoid, *blockers)
        ]
        return sorted(cases, key=lambda c: (c.activity, c.given)), blockers

    def too_slow(self, motions: Motions, alone: Alone, units: int) -> list[Refinement]:
        """State that the motion and all alike last ``units`` while others rest at their places:
        RCOND -> CHTIME.
        """
        return [
            Refinement(
                rules.paper_temporal(
                    (_under(alone.motion, case),),
                    _movers(motions.facts, alone.places),
                    {case.activity: units},
                    alone.places,
                ),
                Layer.TEMPORAL,
                alone.strength,
                alone.why,
            )
            for case in alone.cases
        ]

    def group(self, failure: Failure) -> list[Refinement]:
        """Return the group refinement: geometric if no trajectories were found, else temporal."""
        facts, group = failure.facts, failure.group
        start = min(m.start for m in group)
        moving = {name for m in group for name in m.moved}
        places = {
            name: failure.itinerary.place_at(facts.snapshot, name, start)
            for name in sorted(facts.snapshot.moved())
            if name not in moving
        }
        if not failure.found:
            why = failure.report.reason or "no trajectories for the group"
            cut = rules.paper_geometric(group, facts.snapshot.by_activity, places)
            return [Refinement(cut, Layer.GROUP, Strength.HEURISTIC, why)]
        changers = {c.activity for c in facts.snapshot.changes if c.object in places}
        meanwhile = {c for c in changers if _overlaps(failure, c)}
        rivals = sorted({*facts.snapshot.by_activity, *changers - meanwhile})
        cut = rules.paper_temporal(group, rivals, failure.arrivals(group), places)
        return [Refinement(cut, Layer.GROUP, Strength.HEURISTIC, "the group needs more time")]


def _under(motion: ScheduledMotion, case: MotionCase) -> ScheduledMotion:
    """Return the same motion as an equivalent case (a cut for one activity)."""
    if case.activity == motion.activity:
        return replace(motion, given=case.given)
    return replace(motion, activity=case.activity, constraint=0, given=case.given)


def _overlaps(failure: Failure, activity: str) -> bool:
    """Return whether an activity of the candidate is neither before nor after the whole group."""
    times = failure.itinerary.schedule.times.get(activity)
    if times is None:
        return False
    first, last = min(m.start for m in failure.group), max(m.end for m in failure.group)
    return times[0] <= last and times[1] >= first


def _movers(facts: Facts, places: Mapping[str, str]) -> list[str]:
    """Return the rivals of a motion that was checked alone: who moves what it was checked with.

    With all rivals in RCOND the cut would not reject a candidate in which any other robot drives
    meanwhile, although nobody of them was looked at.
    """
    return sorted({a for name in places for a in facts.snapshot.movers[name]})
