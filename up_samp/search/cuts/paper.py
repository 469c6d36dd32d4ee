"""The cuts of the paper (``small_cuts`` off): every rival, every other object's place, RCOND,
CHCONF and CHTIME as Tosello et al. (ICAPS 2026) write them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from up_samp.model import MotionModel, PathQuery, Placed, ScheduledMotion
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.cases import MotionCase, case_of
from up_samp.search.context import Context
from up_samp.search.cuts.failure import Failure

EXPLORE_SHARE = 0.2
"""Share of a query's time that the tree may grow on to tell what it reaches, after no path."""


def no_path(
    context: Context,
    motion: ScheduledMotion,
    obstacles: tuple[Placed, ...],
    movable: Mapping[str, str],
    why: str,
) -> list[Refinement]:
    """Return that a motion has no path while blocking obstacles rest: RCOND -> CHCONF.

    An RRT tells the blockers (an extension ran into them) and the unreachable configurations.
    The cut is stated for all motions of equal bodies from where the tree was to where it did not
    come. ``movable`` are the configurations of those ``obstacles`` that something moves.
    """
    cases, blockers = _explored(context, motion, obstacles)
    places = {n: c for n, c in movable.items() if n in blockers} or movable
    return [
        rules.paper_geometric(
            (_under(motion, case),),
            _movers(context, places),
            places,
            why,
            layer=Layer.GEOMETRIC,
            strength=Strength.HEURISTIC,
        )
        for case in dict.fromkeys((case_of(context.snapshot, motion), *cases))
    ]


def _explored(
    context: Context, motion: ScheduledMotion, obstacles: tuple[Placed, ...]
) -> tuple[list[MotionCase], frozenset[str]]:
    """Return the motions that an RRT tells impossible with this one, and what blocked it."""
    body = context.body(motion)
    planar = body.kinematics.model in (MotionModel.REEDSSHEPP, MotionModel.SE2)
    if not planar or len(motion.poses) != 2:
        return [], frozenset()
    from up_samp.motion.planners.ompl import explore  # not everywhere is OMPL

    same = [s for s in context.by_signature if s[0] == body and len(s[1]) == 2]
    targets = {str(pose): pose for s in same for pose in s[1]}
    deadline = context.deadline.within(EXPLORE_SHARE * context.query_seconds)
    query = PathQuery(body, motion.poses, obstacles)
    found = explore(context.service.scene, query, targets, deadline, seed=context.params.seed)
    if found.goal or not context.params.equivalents:
        return [], found.blockers
    reached = {*found.reached, str(motion.poses[0])}
    cases = [
        case
        for signature in same
        if str(signature[1][0]) in reached and str(signature[1][1]) not in reached
        for case in context.by_signature[signature]
        if case.task.avoid is None or found.blockers <= case.task.avoid
    ]
    return sorted(cases, key=lambda c: (c.activity, c.given)), found.blockers


def takes_longer(
    context: Context,
    motion: ScheduledMotion,
    case: MotionCase,
    units: int,
    places: Mapping[str, str],
    why: str,
    strength: Strength,
) -> Refinement:
    """Return that a ``case``, equivalent to ``motion``, lasts ``units`` while others rest at
    ``places``: RCOND -> CHTIME.
    """
    return rules.paper_temporal(
        (_under(motion, case),),
        _movers(context, places),
        {case.activity: units},
        places,
        why,
        layer=Layer.TEMPORAL,
        strength=strength,
    )


def _under(motion: ScheduledMotion, case: MotionCase) -> ScheduledMotion:
    """Return the same motion as an equivalent case (a cut for one activity)."""
    if case.activity == motion.activity:
        return replace(motion, given=case.given)
    return replace(motion, activity=case.activity, constraint=0, given=case.given)


def group_cut(failure: Failure) -> Refinement:
    """Return the group refinement: geometric if no trajectories were found, else temporal."""
    context, group = failure.context, failure.group
    start = min(m.start for m in group)
    moving = {name for m in group for name in m.moved}
    places = {
        name: failure.itinerary.place_at(context.snapshot, name, start)
        for name in sorted(context.snapshot.moved())
        if name not in moving
    }
    if not failure.found:
        return rules.paper_geometric(
            group,
            _rivals(context),
            places,
            failure.report.reason or "no trajectories for the group",
            layer=Layer.GROUP,
            strength=Strength.HEURISTIC,
        )
    changers = _changers(context, places)
    meanwhile = {c for c in changers if _overlaps(failure, c)}
    return rules.paper_temporal(
        group,
        sorted({*_rivals(context), *changers - meanwhile}),
        failure.arrivals(group),
        places,
        "the group needs more time",
        layer=Layer.GROUP,
        # what changes in the midst of the group might as well change earlier
        strength=Strength.HEURISTIC if meanwhile else failure.strength,
    )


def _changers(context: Context, places: Mapping[str, str]) -> set[str]:
    """Return the activities that change the configurations of ``places`` in an instant."""
    return {c.activity for c in context.snapshot.changes if c.object in places}


def _overlaps(failure: Failure, activity: str) -> bool:
    """Return whether an activity of the candidate is neither before nor after the whole group."""
    times = failure.itinerary.schedule.times.get(activity)
    if times is None:
        return False
    first, last = min(m.start for m in failure.group), max(m.end for m in failure.group)
    return times[0] <= last and times[1] >= first


def _movers(context: Context, places: Mapping[str, str]) -> list[str]:
    """Return the rivals of a motion that was checked alone: who moves what it was checked with.

    With all rivals in RCOND the cut would not reject a candidate in which any other robot drives
    meanwhile, although nobody of them was looked at.
    """
    return sorted({a for name in places for a in context.movers[name]})


def _rivals(context: Context) -> list[str]:
    return sorted({t.activity for t in context.snapshot.tasks})
