"""The cuts of the paper: every rival, every other object's place, RCOND, CHCONF and CHTIME as
Tosello et al. (ICAPS 2026) write them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from up_samp.model import PathQuery, Placed, ScheduledMotion, avoids
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.cuts.protocol import Alone, Failure
from up_samp.search.cuts.small import SmallCuts
from up_samp.search.facts import Facts, MotionCase
from up_samp.search.knowledge import Knowledge
from up_samp.search.motions import Motions

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
        self, motions: Motions, knowledge: Knowledge, motion: ScheduledMotion
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
        # what changes in the midst of the group might as well change earlier
        strength = Strength.HEURISTIC if meanwhile else failure.strength
        rivals = sorted({*facts.snapshot.by_activity, *changers - meanwhile})
        cut = rules.paper_temporal(group, rivals, failure.arrivals(group), places)
        return [Refinement(cut, Layer.GROUP, strength, "the group needs more time")]


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
