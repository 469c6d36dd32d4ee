"""Turn a candidate schedule into a plan: keep what is present, give motions the time they need.

The candidate's activities alone make a small mandatory problem; it is scheduled anew with the
ends that the motions turned out to need, until the motions fit (or it has no schedule).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.model import CandidateSchedule, ScheduledMotion
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.check import Check, check_itinerary
from up_samp.search.context import Context, Incumbent
from up_samp.search.cuts.handovers import leaves_for
from up_samp.search.slack import spread
from up_samp.search.world import motion_key
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.restrict import restrict

MAX_STEPS = 25
ENOUGH = 10
"""A place that was left longer before (units) is not what makes a motion late."""
REPAIR_EFFORT = 0.4
"""Deterministic time of CP-SAT for one step: a few seconds at most."""


def repair(context: Context, schedule: CandidateSchedule, check: Check) -> Incumbent | None:
    """Return a plan with the activities of ``schedule``, or None where this way finds none."""
    problem = restrict(context.relaxation, context.snapshot, schedule)
    session = CpsatSession(problem, seed=context.params.seed, workers=1, effort=REPAIR_EFFORT)
    activities = {a.name: a for a in problem.activities}
    current = schedule
    demands = Demands(context, problem, activities)
    itinerary = read_itinerary(context.relaxation, current)
    for _ in range(MAX_STEPS):
        if check.failed or context.deadline.expired():
            return None
        demands.add(itinerary, check.needed)
        report = session.solve(context.deadline, optimal=True, hint=current)
        if report.schedule is None:
            return None
        if context.upper_bound is not None and report.schedule.makespan >= context.upper_bound:
            return None
        current = CandidateSchedule(
            report.schedule.times, {**schedule.parameters, **report.schedule.parameters}
        )
        if context.params.slack:
            current = spread(context, problem, current)
        itinerary = read_itinerary(context.relaxation, current)
        check = check_itinerary(context, itinerary, learn=False)
        if check.passed:
            return Incumbent(current, check.trajectories)
        if not check.needed:
            return None
    return None


def demand(
    problem: SchedulingProblem,
    activities: Mapping[str, Activity],
    current: CandidateSchedule,
    needed: Mapping[str, int],
) -> None:
    """Make motions last as long as they turned out to need."""
    manager = problem.environment.expression_manager
    for key, end in needed.items():
        # a further motion of an activity is named activity#k; an activity may have such a name
        activity = activities[key if key in activities else key.rpartition("#")[0]]
        start, _ = current.times[activity.name]
        longer = manager.LE(manager.Plus(activity.start, end - start), activity.end)
        problem.add_constraint(longer)


@dataclass
class Demands:
    """What motions turned out to need, stated in the problem of the present activities.

    Who is late where another one has just left comes later after that one's departure: only to
    last longer would not help, if both were moved alike. Others last as long as they need.
    """

    context: Context
    problem: SchedulingProblem
    activities: Mapping[str, Activity]
    gaps: dict[tuple[str, str], int] = field(default_factory=dict)

    def add(self, itinerary: Itinerary, needed: Mapping[str, int]) -> None:
        """State what the late motions of a schedule need: ``needed`` are their ends (units)."""
        manager = self.problem.environment.expression_manager
        motions = {motion_key(m): m for m in itinerary.motions}
        for key, end in needed.items():
            late = motions[key]
            mine = self.activities[late.activity]
            if self._after_departure(itinerary, late, mine, end):
                continue
            longer = manager.LE(manager.Plus(mine.start, end - late.start), mine.end)
            self.problem.add_constraint(longer)

    def _after_departure(
        self, itinerary: Itinerary, late: ScheduledMotion, mine: Activity, end: int
    ) -> bool:
        """Tie a late arrival to the last departure from its goal; tell whether that is new."""
        leaving = [m for m in itinerary.motions if leaves_for(self.context, m, late)]
        if not leaving:
            return False
        last = max(leaving, key=lambda m: (m.start, m.activity))
        gap, pair = end - last.start, (last.activity, late.activity)
        if gap <= self.gaps.get(pair, 0) or gap > 2 * (late.end - last.start) + ENOUGH:
            return False
        self.gaps[pair] = gap
        manager = self.problem.environment.expression_manager
        departure = self.activities[last.activity].start
        self.problem.add_constraint(manager.LE(manager.Plus(departure, gap), mine.end))
        return True
