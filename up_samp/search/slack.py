"""Spread the slack of a schedule: motions may take longer where that costs nothing.

A scheduler has no reason to give a motion more time than it needs alone. Where the makespan allows
it, more time lets motions that are not critical give way to those that are.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from unified_planning.model.metrics import Oversubscription
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.search import Search
from up_samp.search.tuning import SlackTuning
from up_samp.upio.restrict import restrict


@dataclass(frozen=True)
class Slack:
    """The component that gives a candidate's motions what time its makespan leaves."""

    tuning: SlackTuning = field(default_factory=SlackTuning)

    def __call__(self, search: Search, schedule: CandidateSchedule) -> CandidateSchedule:
        """Return a candidate with the same activities and makespan, its motions with more time."""
        relaxation = search.knowledge.relaxation
        if any(not m.is_minimize_makespan() for m in relaxation.problem.quality_metrics):
            return schedule
        return self.spread(search, restrict(relaxation, search.facts.snapshot, schedule), schedule)

    def spread(
        self, search: Search, problem: SchedulingProblem, schedule: CandidateSchedule
    ) -> CandidateSchedule:
        """Return a schedule of ``problem`` (see ``restrict``) that ends no later than
        ``schedule`` and whose motions have as much slack as can be; ``schedule`` itself, if there
        is none to be had in little time.
        """
        loose = problem.clone()
        manager = loose.environment.expression_manager
        moving = {t.activity for t in search.facts.snapshot.tasks}
        goals = {}
        for activity in loose.activities:
            loose.add_constraint(manager.LE(activity.end, schedule.makespan))
            if activity.name in moving:
                start, end = schedule.times[activity.name]
                for more in self.tuning.units:
                    longer = manager.Plus(activity.start, end - start + more)
                    goals[manager.LE(longer, activity.end)] = 1
        loose.clear_quality_metrics()
        loose.add_quality_metric(Oversubscription(goals, loose.environment))
        session = CpsatSession(
            loose, seed=search.seed, workers=1, effort=self.tuning.effort, tuning=search.cpsat
        )
        report = session.solve(search.budget.deadline, optimal=True, hint=schedule)
        if report.schedule is None:
            return schedule
        return CandidateSchedule(
            report.schedule.times, {**schedule.parameters, **report.schedule.parameters}
        )
