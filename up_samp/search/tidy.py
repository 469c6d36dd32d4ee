"""Leave needless motions out: of the best plan, as the last pass of a search, and of candidates of
engines that make schedules full of them, before their motions are checked.

A makespan says nothing of moves that end before it: an idle robot may drive out, back and out
again. Among the plans with some of the same motions, no later end, the same decisions and all else
that is present, the one with the fewest motions is sought, then with the least driving. Its motions
are checked and the plan is validated like any other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from unified_planning.model.metrics import Oversubscription
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.bounds import Incumbent
from up_samp.search.events import Phase
from up_samp.search.repair import demand
from up_samp.search.search import Search
from up_samp.search.tuning import TidyTuning
from up_samp.upio import Relaxation, read_itinerary
from up_samp.upio.restrict import restrict


@dataclass(frozen=True)
class Tidying:
    """The component: see ``tidied``."""

    tuning: TidyTuning = field(default_factory=TidyTuning)

    def __call__(self, search: Search, plan: Incumbent) -> Incumbent | None:
        """Return a valid plan with fewer motions that ends no later, if one is found."""
        return tidied(search, plan, self.tuning)


def tidied(search: Search, plan: Incumbent, tuning: TidyTuning) -> Incumbent | None:
    """Return a valid plan with fewer motions than ``plan`` that ends no later, if one is found."""
    search.tell.stage(Phase.TIDY)
    relaxation, deadline = search.knowledge.relaxation, search.budget.deadline
    weights = _weights(relaxation, plan.schedule)
    if not weights or not _only_makespan(relaxation):
        return None
    problem = _loose(relaxation, plan.schedule, weights, plan.schedule.makespan)
    activities = {a.name: a for a in problem.activities}
    manager = problem.environment.expression_manager
    current = plan.schedule
    session = CpsatSession(
        problem, seed=search.seed, workers=1, effort=tuning.effort, tuning=search.cpsat
    )
    for _ in range(tuning.steps):
        if deadline.expired():
            return None
        report = session.solve(deadline, optimal=True, hint=current)
        if report.schedule is None:
            return None
        gone = sorted(weights.keys() - report.schedule.times.keys())
        if not gone:
            return None
        values = {**plan.schedule.parameters, **report.schedule.parameters}
        current = CandidateSchedule(report.schedule.times, values)
        itinerary = read_itinerary(relaxation, current)
        check = search.checker.drive(itinerary)
        if check.passed:
            better = search.plan_of(current, check.trajectories)
            return None if search.judged(better.plan) else better
        if check.failed or not check.needed:
            problem.add_constraint(manager.Or(activities[n].present for n in gone))
        else:
            demand(problem, activities, itinerary, check.needed)
    return None


@dataclass(frozen=True)
class Lean:
    """The component: leaves needless motions out of another engine's candidates."""

    tuning: TidyTuning = field(default_factory=TidyTuning)

    def __call__(self, search: Search, schedule: CandidateSchedule) -> CandidateSchedule:
        """Return a candidate with some of the same activities, few of them motions, that ends as
        soon as these can; ``schedule`` itself, if there is none to be had in little time.

        What the engine was not told may need more time: twice as much as it scheduled at most.
        """
        own, told = search.own_relaxation(), search.knowledge.relaxation
        for relaxation, factor in ((own, 2), (told, 1)):
            weights = _weights(relaxation, schedule)
            if not weights or not _only_makespan(relaxation):
                return schedule
            until = factor * schedule.makespan
            few = self._solved(search, _loose(relaxation, schedule, weights, until), schedule)
            if few is not None:
                restricted = restrict(relaxation, relaxation.snapshot, few)
                return self._solved(search, restricted, few) or few
        return schedule

    def _solved(
        self, search: Search, problem: SchedulingProblem, near: CandidateSchedule
    ) -> CandidateSchedule | None:
        session = CpsatSession(
            problem, seed=search.seed, workers=1, effort=self.tuning.lean, tuning=search.cpsat
        )
        report = session.solve(search.budget.deadline, optimal=True, hint=near)
        search.budget.seconds_scheduler += report.seconds
        if report.schedule is None:
            return None
        values = {**near.parameters, **report.schedule.parameters}
        return CandidateSchedule(report.schedule.times, values)


def _only_makespan(relaxation: Relaxation) -> bool:
    """Return whether nothing but the makespan is to be made smaller."""
    return all(m.is_minimize_makespan() for m in relaxation.problem.quality_metrics)


def _weights(relaxation: Relaxation, schedule: CandidateSchedule) -> dict[str, int]:
    """Return what leaving out each present optional motion is worth: one motion more than all
    driving, one unit of driving more than all changes without motions.
    """
    present = schedule.times
    optional = {a.name for a in relaxation.problem.activities if a.optional} & set(present)
    drives = {t.activity for t in relaxation.snapshot.tasks} & optional
    changes = {c.activity for c in relaxation.snapshot.changes} & optional - drives
    unit = len(changes) + 1
    lengths = {n: (present[n][1] - present[n][0]) * unit for n in drives}
    most = sum(lengths.values()) + unit
    return {n: most + lengths[n] for n in drives} | dict.fromkeys(changes, 1)


def _loose(
    relaxation: Relaxation, schedule: CandidateSchedule, weights: Mapping[str, int], until: int
) -> SchedulingProblem:
    """Return the problem of a schedule's activities, with the weighted ones optional; all of it
    ends by ``until``.
    """
    twins = {twin.name for twin in relaxation.elsewhere.values()}
    free = frozenset(weights) | (twins & set(schedule.times))
    problem = restrict(relaxation, relaxation.snapshot, schedule, free=free)
    manager = problem.environment.expression_manager
    goals = {}
    for activity in problem.activities:
        problem.add_constraint(manager.LE(activity.end, until))
        if activity.name in weights:
            goals[manager.Not(activity.present)] = weights[activity.name]
    problem.clear_quality_metrics()
    problem.add_quality_metric(Oversubscription(goals, problem.environment))
    return problem
