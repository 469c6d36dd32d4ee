"""Check a candidate schedule's motions, layer by layer (Algorithm 1, lines 8 to 15).

Layer 1 asks for each motion alone whether there is a path and how long it takes; layer 2 whether
the motions of a parallel group can be made as scheduled. Everything that a layer learns from one
candidate is collected, unless the preset stops at the first refinement as the paper does.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from up_samp.model import GroupQuery, GroupReport, Outcome, PathQuery, ScheduledMotion, Trajectory
from up_samp.model.refinement import Refinement, Strength
from up_samp.refinement import rules, timed
from up_samp.search.cases import MotionCase
from up_samp.search.context import Context
from up_samp.search.cuts import groups as group_rules
from up_samp.search.cuts import paper
from up_samp.search.cuts.exact import rejects
from up_samp.search.cuts.failure import Failure
from up_samp.search.params import GROUP_PLANNERS
from up_samp.search.prepare import duration_refinements, fastest_path
from up_samp.search.world import group_query, groups_of, instant_obstacles, motion_key
from up_samp.upio import Itinerary


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


def check_itinerary(
    context: Context, itinerary: Itinerary, *, learn: bool = True, first_only: bool = False
) -> Check:
    """Check all motions of an itinerary; ``learn=False`` asks for trajectories alone."""
    check = Check()
    started = time.monotonic()
    before = context.history.seconds_motion
    check.refinements += check_static(itinerary)
    for group in groups_of(itinerary.motions):
        _check_group(context, itinerary, group, check, learn=learn, first_only=first_only)
        if context.deadline.expired():
            check.failed |= {motion_key(m) for m in group}
        if context.deadline.expired() or (first_only and not check.passed):
            break
    context.history.seconds_motion = before + time.monotonic() - started
    return check


def check_static(itinerary: Itinerary) -> list[Refinement]:
    """Return which static obstacles would have to stay put (none, if the relaxation holds them)."""
    found = []
    for motion in itinerary.motions:
        for change in itinerary.changes:
            if change.object in motion.static and motion.start < change.time < motion.end:
                found.append(rules.stays_put(motion.activity, change.activity, change.object))
        for drive in itinerary.motions:
            if drive.start < motion.end and motion.start < drive.end:
                found += [
                    rules.not_while_driving(motion.activity, drive.activity, name)
                    for name in sorted(drive.moved & motion.static)
                ]
    return found


def _check_group(
    context: Context,
    itinerary: Itinerary,
    group: Sequence[ScheduledMotion],
    check: Check,
    *,
    learn: bool,
    first_only: bool,
) -> None:
    params = context.params
    found: list[Refinement] = []
    if params.single_geometric:
        for motion in group:
            found += check_path(context, itinerary, motion, check)
            if found and first_only:
                break
    if params.single_temporal and not found:
        for motion in group:
            found += check_duration(context, itinerary, motion, check)
            if found and first_only:
                break
    check.refinements += found
    if found and not params.incumbents:
        return
    if any(motion_key(m) in check.failed for m in group):
        return
    query = group_query(context, itinerary, group)
    report, cut_short = coordinate(context, query)
    check.trajectories.update(report.trajectories)
    if report.outcome is not Outcome.FOUND:
        check.failed |= report.conflict or {motion_key(m) for m in group}
    for name, arrival in report.late.items():
        check.needed[name] = context.units(arrival)
    if learn and not found and (report.outcome is not Outcome.FOUND or report.late):
        failure = Failure(context, itinerary, group, query, report, cut_short)
        check.refinements += group_rules.learn(failure)


def coordinate(context: Context, query: GroupQuery) -> tuple[GroupReport, bool]:
    """Ask the motion service for a group; return also whether its time was up."""
    if len(query.motions) > 1:
        context.report("group", f"{len(query.motions)} motions together")
    deadline = context.deadline.within(context.group_seconds(len(query.motions)))
    method = GROUP_PLANNERS[context.params.group_planner.lower()]
    seed = context.params.seed + context.history.restarts
    report = context.service.coordinate(query, deadline, method=method, seed=seed)
    return report, deadline.expired()


def check_path(
    context: Context, itinerary: Itinerary, motion: ScheduledMotion, check: Check
) -> list[Refinement]:
    """Layer 1, geometric: is there a path among what rests all through the motion's time?"""
    body = context.body(motion)
    obstacles = instant_obstacles(context, itinerary, motion)
    report = context.service.plan(
        PathQuery(body, motion.poses, obstacles),
        context.deadline.within(context.query_seconds),
    )
    if report.outcome is Outcome.FOUND:
        return []
    check.failed.add(motion_key(motion))
    proven = report.outcome is Outcome.IMPOSSIBLE
    strength = Strength.PROVEN if proven else Strength.HEURISTIC
    names = report.blockers if proven else frozenset(o.name for o in obstacles)
    snapshot = context.snapshot
    movable = {n: itinerary.place_at(snapshot, n, motion.start) for n in names if context.movers[n]}
    why = report.reason or f"no path for {motion.activity} found"
    same = _equivalent(context, motion, names)
    if not movable:
        never = ((rules.impossible(c.activity, why), c.given) for c in same)
        return [replace(rules.only_given(r, g), strength=strength) for r, g in never]
    if context.params.small_cuts or proven:
        found = [
            rules.only_given(
                rules.blocked_while(c.activity, movable, context.movers, why, strength=strength),
                c.given,
            )
            for c in same
        ]
    else:
        found = paper.no_path(context, motion, obstacles, movable, why)
    if not any(rejects(context, itinerary, r) for r in found):
        exact = _blocked_as_timed(context, itinerary, motion, movable, why, strength)
        found.append(exact)
    return found


def _blocked_as_timed(
    context: Context,
    itinerary: Itinerary,
    motion: ScheduledMotion,
    blockers: Iterable[str],
    why: str,
    strength: Strength,
) -> Refinement:
    """Return the cut for the blockers' changes as they are ordered."""
    set_by: dict[str, str | None] = {}
    changes: dict[str, dict[str, int]] = {}
    given = dict(motion.given)
    for name in blockers:
        times = itinerary.schedule.times
        movers = sorted(context.movers[name])
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
    cut = timed.blocked_as_timed(motion, set_by, changes, why, strength=strength)
    return rules.only_given(cut, tuple(sorted(given.items())))


def check_duration(
    context: Context, itinerary: Itinerary, motion: ScheduledMotion, check: Check
) -> list[Refinement]:
    """Layer 1, temporal: does the motion alone fit its scheduled time?"""
    body = context.body(motion)
    found = []
    if context.params.small_cuts:
        found = duration_refinements(context, context.like(motion), context.query_seconds)
        found = [r for r in found if rejects(context, itinerary, r)]
        if found:
            return found
    obstacles = instant_obstacles(context, itinerary, motion)
    query = PathQuery(body, motion.poses, obstacles)
    report, strength = fastest_path(context, query, context.query_seconds)
    if report.trajectory is None:
        return []
    units = context.units(report.trajectory.duration)
    if units <= motion.end - motion.start:
        return []
    places = {
        o.name: itinerary.place_at(context.snapshot, o.name, motion.start)
        for o in obstacles
        if context.movers[o.name]
    }
    why = f"the fastest motion found takes {report.trajectory.duration:.2f} s"
    for case in _equivalent(context, motion, frozenset(o.name for o in obstacles)):
        if context.params.small_cuts:
            cut = rules.slower_while(
                case.activity, units, places, context.movers, why, strength=strength
            )
            found.append(rules.only_given(cut, case.given))
        else:
            found.append(paper.takes_longer(context, motion, case, units, places, why, strength))
    if not any(rejects(context, itinerary, r) for r in found):
        exact = _blocked_as_timed(context, itinerary, motion, places, why, strength)
        found.append(rules.unless_longer(exact, motion.activity, units))
    return found


def _equivalent(
    context: Context, motion: ScheduledMotion, blockers: frozenset[str]
) -> list[MotionCase]:
    """Return the motion's case and, if asked for, those that are the same motion with equal bodies
    and heed the ``blockers`` too.
    """
    mine, *others = context.like(motion)
    if not context.params.equivalents:
        return [mine]
    heeding = [c for c in others if c.task.avoid is None or blockers <= c.task.avoid]
    return sorted([mine, *heeding], key=lambda c: (c.activity, c.given))
