"""Turn a candidate schedule into a plan: keep what is present, give motions the time they need.

The candidate's activities alone make a small mandatory problem; it is scheduled anew with the
ends that the motions turned out to need, until the motions fit (or it has no schedule).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.model import CandidateSchedule, ScheduledMotion
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.bounds import Incumbent
from up_samp.search.check import Check
from up_samp.search.cuts.handovers import leaves_for
from up_samp.search.events import Phase
from up_samp.search.motions import Motions
from up_samp.search.search import Search
from up_samp.search.tuning import RepairTuning
from up_samp.search.world import motion_key
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.restrict import restrict

Spread = Callable[[Search, SchedulingProblem, CandidateSchedule], CandidateSchedule]


@dataclass(frozen=True)
class Repairing:
    """The component: see ``repair``. ``spread`` (see ``slack``) gives motions what time is left."""

    spread: Spread | None = None
    tuning: RepairTuning = field(default_factory=RepairTuning)

    def __call__(
        self, search: Search, schedule: CandidateSchedule, check: Check
    ) -> Incumbent | None:
        """Return a plan with the activities of ``schedule``, or None where none is found, or some
        motion found no trajectory at all.
        """
        if check.failed:
            return None
        search.tell.stage(Phase.REPAIR)
        return repair(search, schedule, check, self)


def repair(
    search: Search, schedule: CandidateSchedule, check: Check, made: Repairing
) -> Incumbent | None:
    """Return a plan with the activities of ``schedule``, or None where this way finds none."""
    relaxation, facts, tuning = search.knowledge.relaxation, search.facts, made.tuning
    deadline = search.budget.deadline
    problem = restrict(search.own_relaxation(), facts.snapshot, schedule)
    session = CpsatSession(
        problem, seed=search.seed, workers=1, effort=tuning.effort, tuning=search.cpsat
    )
    activities = {a.name: a for a in problem.activities}
    current = schedule
    demands = Demands(search.motions, problem, activities, tuning.enough)
    itinerary = read_itinerary(relaxation, current)
    for _ in range(tuning.steps):
        if check.failed or deadline.expired():
            return None
        demands.add(itinerary, check.needed)
        report = session.solve(deadline, optimal=True, hint=current)
        if report.schedule is None or not search.bounds.improves(report.schedule):
            return None
        current = CandidateSchedule(
            report.schedule.times, {**schedule.parameters, **report.schedule.parameters}
        )
        if made.spread is not None:
            current = made.spread(search, problem, current)
        itinerary = read_itinerary(relaxation, current)
        check = search.checker.drive(itinerary)
        if check.passed:
            return search.plan_of(current, check.trajectories)
        if not check.needed:
            return None
    return None


def demand(
    problem: SchedulingProblem,
    activities: Mapping[str, Activity],
    itinerary: Itinerary,
    needed: Mapping[str, int],
) -> None:
    """Make motions of a schedule last as long as they turned out to need."""
    manager = problem.environment.expression_manager
    motions = {motion_key(m): m for m in itinerary.motions}
    for key, end in needed.items():
        activity = activities[motions[key].activity]
        start, _ = itinerary.schedule.times[activity.name]
        longer = manager.LE(manager.Plus(activity.start, end - start), activity.end)
        problem.add_constraint(longer)


@dataclass
class Demands:
    """What motions turned out to need, stated in the problem of the present activities.

    Who is late where another one has just left comes later after that one's departure: only to
    last longer would not help, if both were moved alike. Others last as long as they need.
    """

    motions: Motions
    problem: SchedulingProblem
    activities: Mapping[str, Activity]
    enough: int
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
        leaving = [m for m in itinerary.motions if leaves_for(self.motions, m, late)]
        if not leaving:
            return False
        last = max(leaving, key=lambda m: (m.start, m.activity))
        gap, pair = end - last.start, (last.activity, late.activity)
        if gap <= self.gaps.get(pair, 0) or gap > 2 * (late.end - last.start) + self.enough:
            return False
        self.gaps[pair] = gap
        manager = self.problem.environment.expression_manager
        departure = self.activities[last.activity].start
        self.problem.add_constraint(manager.LE(manager.Plus(departure, gap), mine.end))
        return True
