"""The component: goes from plan to better plan through neighbourhoods, as long as that helps.

Several neighbourhoods are drawn at a time, and looked at in this order until one of them has a
better schedule. So it makes no difference to what is found whether they are solved one after the
other or by workers, all at once.
"""

from __future__ import annotations

import logging
import pickle
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

from up_samp.model import CandidateSchedule, Deadline, ScheduleReport, ScheduleStatus
from up_samp.search.attempt import try_candidate
from up_samp.search.bounds import Incumbent
from up_samp.search.events import Phase
from up_samp.search.neighbourhoods.adaptive import Roulette
from up_samp.search.neighbourhoods.choices import CHOICES, Choice, Freed
from up_samp.search.neighbourhoods.owners import owners_of
from up_samp.search.neighbourhoods.small_problem import (
    Settings,
    SmallProblem,
    small_problem,
    solve_sent,
    solve_small,
)
from up_samp.search.neighbourhoods.view import View
from up_samp.search.search import Search
from up_samp.search.stages import IMPROVING
from up_samp.search.tuning import NeighbourhoodsTuning
from up_samp.system.workers import WorkItem

log = logging.getLogger(__name__)


@dataclass
class State:
    """Where the descent of one search is: what its neighbourhoods brought, and those of the present
    plan that hold no better schedule. ``whose`` it is lives as long: no other gets its ``id``.
    """

    whose: Descent
    roulette: Roulette
    view: View | None = None
    exhausted: list[Freed] = field(default_factory=list)

    def seen(self, freed: Freed) -> bool:
        """Return whether it was searched already, alone or as a part of more."""
        return any(freed.within(other) for other in self.exhausted)


@dataclass
class Descent:
    """Yields better plans than the search has; see the package. Where it is with one search, that
    search remembers: the component may outlive it.
    """

    tuning: NeighbourhoodsTuning = field(default_factory=NeighbourhoodsTuning)
    choices: Sequence[Choice] = CHOICES

    def __call__(self, search: Search, stuck: bool) -> Iterator[Incumbent]:
        """Yield plans that are better than all before them, for a share of the time: where the
        scheduler is ``stuck``, and once before it is asked for more than it can do.
        """
        state = search.remembered.get(id(self))
        if not stuck and (state is not None or not self._hopeless(search)):
            return
        share = self.tuning.share if stuck else self.tuning.first_share
        deadline = search.budget.share(share, float("inf"))
        owners = owners_of(search.own_relaxation())
        if len(owners.robots) < 2:
            return
        if state is None:
            chance = random.Random(search.seed)
            roulette = Roulette(self.choices, self.tuning, chance, len(owners.robots))
            state = State(self, roulette)
            search.remembered[id(self)] = state
        assert isinstance(state, State)
        stale = 0
        while stale < self.tuning.stale and not self._over(search, deadline):
            plan, relaxation = search.bounds.incumbent, search.own_relaxation()
            assert plan is not None
            view = state.view
            if view is None or view.plan is not plan or view.relaxation is not relaxation:
                state.view = View(relaxation, search.facts.snapshot, owners, plan)
                state.exhausted.clear()
            better = self._step(search, state, deadline)
            stale = stale + self.tuning.together if better is None else 0
            if better is not None:
                yield better

    def _over(self, search: Search, deadline: Deadline) -> bool:
        return search.stopped or deadline.expired() or search.bounds.met

    def _hopeless(self, search: Search) -> bool:
        """Return whether a first attempt at a proof, or at a better schedule of the whole, would
        most likely bring nothing.
        """
        activities = search.knowledge.relaxation.problem.activities
        return sum(a.optional for a in activities) >= self.tuning.activities

    def _step(self, search: Search, state: State, deadline: Deadline) -> Incumbent | None:
        """Look at some neighbourhoods until one has a better schedule; return the better plan if
        one comes of it.
        """
        roulette, view = state.roulette, state.view
        assert view is not None
        drawn = [roulette.draw() for _ in range(self.tuning.together)]
        some = [self.choices[k](view, roulette.chance, roulette.robots) for k in drawn]
        new = [not state.seen(freed) for freed in some]
        found = self._schedules(
            search, view, [f for f, n in zip(some, new, strict=True) if n], deadline
        )
        for k, freed, unseen in zip(drawn, some, new, strict=True):
            if not unseen:
                roulette.searched(wholly=True)
                continue
            search.tell.stage(Phase.NEIGHBOURHOOD, self.choices[k].__name__, len(freed.robots))
            with search.history.stages.of(IMPROVING):
                report = next(found, None)
            if report is None:
                return None
            if report.schedule is not None and search.bounds.improves(report.schedule):
                tried = try_candidate(search, report)
                roulette.learn(k, self.tuning.nearly if tried.better is None else 1.0)
                return tried.better
            wholly = report.status in (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE)
            if wholly:
                state.exhausted.append(freed)
            roulette.searched(wholly=wholly)
            roulette.learn(k, 0.0)
        return None

    def _schedules(
        self, search: Search, view: View, some: Sequence[Freed], deadline: Deadline
    ) -> Iterator[ScheduleReport]:
        """Yield the best schedule found in each neighbourhood, as long as there is time. No bound
        on one is a bound on the whole.
        """
        settings = Settings(search.seed, self.tuning.effort, search.cpsat)
        guess = view.plan.schedule
        if search.workers is None:
            for freed in some:
                if deadline.expired():
                    return
                small = small_problem(view, freed)
                report = solve_small(small.problem, settings, guess, deadline)
                search.budget.seconds_scheduler += report.seconds
                yield _whole(report, small, guess)
            return
        parts = [small_problem(view, freed) for freed in some]
        try:
            sent = [pickle.dumps(small.problem) for small in parts]
        except Exception as error:  # a problem brings its environment, with all that is in there
            log.warning("problems cannot be sent to workers, and are solved here: %s", error)
            search.workers = None
            yield from self._schedules(search, view, some, deadline)
            return
        tasks = [
            WorkItem(
                solve_sent,
                (data, settings, guess),
                partial(_solve_here, small, settings, guess),
                deadline.remaining,
            )
            for small, data in zip(parts, sent, strict=True)
        ]
        answers = search.workers.answers(tasks, deadline.remaining)
        for answer, small in zip(answers, parts, strict=True):
            if answer is None:
                return
            search.budget.seconds_scheduler += answer.seconds
            yield _whole(answer, small, guess)


def _solve_here(
    small: SmallProblem, settings: Settings, guess: CandidateSchedule, seconds: float
) -> ScheduleReport:
    return solve_small(small.problem, settings, guess, Deadline.after(seconds))


def _whole(report: ScheduleReport, small: SmallProblem, plan: CandidateSchedule) -> ScheduleReport:
    """Return what was found as a schedule of the whole problem, without its bound."""
    if report.schedule is None:
        return ScheduleReport(report.status, seconds=report.seconds)
    kept = {n: v for n, v in plan.parameters.items() if n.rpartition(".")[0] in small.kept}
    values = {**kept, **report.schedule.parameters}
    found = CandidateSchedule(report.schedule.times, values)
    return ScheduleReport(report.status, found, seconds=report.seconds)
