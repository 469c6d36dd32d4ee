"""The component: goes from plan to better plan through neighbourhoods, as long as that helps."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from up_samp.model import CandidateSchedule, Deadline, ScheduleReport, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.attempt import try_candidate
from up_samp.search.bounds import Incumbent
from up_samp.search.events import Phase
from up_samp.search.neighbourhoods.adaptive import Roulette
from up_samp.search.neighbourhoods.choices import CHOICES, Choice, Freed
from up_samp.search.neighbourhoods.owners import owners_of
from up_samp.search.neighbourhoods.small_problem import small_problem
from up_samp.search.neighbourhoods.view import View
from up_samp.search.search import Search
from up_samp.search.tuning import NeighbourhoodsTuning


@dataclass
class Descent:
    """Yields better plans than the search has; see the package. It keeps no state but what its
    neighbourhoods brought.
    """

    tuning: NeighbourhoodsTuning = field(default_factory=NeighbourhoodsTuning)
    choices: Sequence[Choice] = CHOICES
    _roulette: Roulette | None = None
    _exhausted: list[Freed] = field(default_factory=list)
    """Neighbourhoods of the present plan that hold no better schedule."""

    def __call__(self, search: Search) -> Iterator[Incumbent]:
        """Yield plans that are better than all before them, for a share of the time."""
        deadline = search.budget.share(self.tuning.share, float("inf"))
        owners = owners_of(search.own_relaxation())
        if len(owners.robots) < 2:
            return
        if self._roulette is None:
            chance = random.Random(search.seed)
            self._roulette = Roulette(self.choices, self.tuning, chance, len(owners.robots))
        view, stale = None, 0
        while stale < self.tuning.stale and not deadline.expired() and not search.bounds.met:
            plan = search.bounds.incumbent
            assert plan is not None
            if view is None or view.plan is not plan:
                view = View(search.own_relaxation(), search.facts.snapshot, owners, plan)
                self._exhausted.clear()
            better = self._step(search, view, self._roulette, deadline)
            stale = stale + 1 if better is None else 0
            if better is not None:
                yield better

    def _step(
        self, search: Search, view: View, roulette: Roulette, deadline: Deadline
    ) -> Incumbent | None:
        """Try one neighbourhood; return a better plan if it brought one."""
        drawn = roulette.draw()
        freed = self.choices[drawn](view, roulette.chance, roulette.robots)
        if any(freed.within(other) for other in self._exhausted):
            roulette.searched(wholly=True)
            return None
        search.tell.stage(Phase.NEIGHBOURHOOD, self.choices[drawn].__name__, len(freed.robots))
        report = self._schedule(search, view, freed, deadline)
        if report.schedule is None or not search.bounds.improves(report.schedule):
            wholly = report.status in (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE)
            if wholly:
                self._exhausted.append(freed)
            roulette.searched(wholly=wholly)
            roulette.learn(drawn, 0.0)
            return None
        tried = try_candidate(search, report)
        roulette.learn(drawn, 1.0 if tried.better is not None else self.tuning.nearly)
        return tried.better

    def _schedule(
        self, search: Search, view: View, freed: Freed, deadline: Deadline
    ) -> ScheduleReport:
        """Return a schedule of the problem that is left; no bound of it is one of the whole."""
        small = small_problem(view, freed)
        session = CpsatSession(
            small.problem,
            seed=search.seed,
            workers=1,
            effort=self.tuning.effort,
            tuning=search.cpsat,
        )
        schedule = view.plan.schedule
        report = session.solve(deadline, optimal=True, hint=schedule)
        search.budget.seconds_scheduler += report.seconds
        if report.schedule is None:
            return report
        kept = {n: v for n, v in schedule.parameters.items() if n.rpartition(".")[0] in small.kept}
        found = CandidateSchedule(report.schedule.times, {**kept, **report.schedule.parameters})
        return ScheduleReport(report.status, found, seconds=report.seconds)
