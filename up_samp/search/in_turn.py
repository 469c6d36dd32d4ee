"""Some plan, where the motions of a candidate do not fit: its motions one after another.

Robots that drive at the same time may find no way past each other, or not in time. Who drives alone
only has to get around what rests. So the candidate's activities are scheduled anew, first with the
motions of the groups that failed in turn, then with all of them; what is learned about each motion
among what rests (who has to be gone before) goes to the scheduler, and counts for later candidates,
too. The plan may be long: what comes after makes it shorter.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from dataclasses import dataclass, field

from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.bounds import Incumbent
from up_samp.search.check import Check
from up_samp.search.events import Phase
from up_samp.search.search import Search
from up_samp.search.tuning import TurnsTuning
from up_samp.search.world import groups_of, motion_key
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.restrict import restrict


@dataclass(frozen=True)
class InTurn:
    """The component: see the module. It is asked only as long as there is no plan."""

    tuning: TurnsTuning = field(default_factory=TurnsTuning)

    def __call__(
        self, search: Search, schedule: CandidateSchedule, check: Check
    ) -> Incumbent | None:
        """Return a plan with the activities of ``schedule``, or None where none is found."""
        if search.bounds.incumbent is not None:
            return None
        search.tell.stage(Phase.REPAIR)
        itinerary = read_itinerary(search.knowledge.relaxation, schedule)
        alone = _of_failed_groups(itinerary, check)
        everybody = {m.activity for m in itinerary.motions}
        for some in (alone, everybody) if alone != everybody else (everybody,):
            found = _in_turn(search, schedule, some, self.tuning)
            if found is not None:
                return found
        return None


def _of_failed_groups(itinerary: Itinerary, check: Check) -> set[str]:
    """Return the motion activities of the groups in which a motion failed or came late."""
    names = {*check.failed, *check.needed}
    wrong = {m.activity for m in itinerary.motions if motion_key(m) in names}
    found = set()
    for group in groups_of(itinerary.motions):
        names = {m.activity for m in group}
        if names & wrong:
            found |= names
    return found


def _in_turn(
    search: Search, schedule: CandidateSchedule, some: Collection[str], tuning: TurnsTuning
) -> Incumbent | None:
    """Return a plan in which the motions of ``some`` activities happen one at a time."""
    deadline = search.budget.share(tuning.share, math.inf)
    relaxation, snapshot = search.knowledge.relaxation, search.facts.snapshot
    current = schedule
    for _ in range(tuning.steps):
        if deadline.expired():
            return None
        problem = restrict(search.own_relaxation(), snapshot, schedule)
        _take_turns(problem, some)
        session = CpsatSession(
            problem, seed=search.seed, workers=1, effort=tuning.effort, tuning=search.cpsat
        )
        report = session.solve(deadline, optimal=False, hint=current)
        search.budget.seconds_scheduler += report.seconds
        if report.schedule is None:
            return None
        values = {**schedule.parameters, **report.schedule.parameters}
        current = CandidateSchedule(report.schedule.times, values)
        check = search.checker.check(read_itinerary(relaxation, current))
        if check.passed:
            return search.plan_of(current, check.trajectories)
        if not search.learn(check.refinements):
            return None
    return None


def _take_turns(problem: SchedulingProblem, some: Collection[str]) -> None:
    """Let the activities of ``some`` happen one at a time, with a rest in between: who arrives
    when another one leaves may still meet it.
    """
    manager = problem.environment.expression_manager
    turns = [a for a in problem.activities if a.name in some]
    for a, b in itertools.combinations(turns, 2):
        problem.add_constraint(manager.Or(manager.LT(a.end, b.start), manager.LT(b.end, a.start)))
