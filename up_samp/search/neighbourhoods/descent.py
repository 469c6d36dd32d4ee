"""The component: goes from plan to better plan through neighbourhoods, as long as that helps.

Several neighbourhoods are drawn at a time, and looked at in this order until one of them has a
better schedule. So it makes no difference to what is found whether they are solved one after the
other or by workers, all at once.
"""

from __future__ import annotations

import itertools
import logging
import pickle
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from unified_planning.model.scheduling import SchedulingProblem

from up_samp.extensions import parts
from up_samp.model import CandidateSchedule, Deadline, ScheduleReport, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.attempt import try_candidate
from up_samp.search.events import Phase
from up_samp.search.history import IMPROVING
from up_samp.search.knowledge import Incumbent
from up_samp.search.neighbourhoods.choices import CHOICES, Choice, Freed, View, owners_of
from up_samp.search.search import Search
from up_samp.system.workers import WorkItem
from up_samp.upio.restrict import restrict


@dataclass(frozen=True)
class DescentSettings:
    """How hard better plans are sought in neighbourhoods: for ``share`` of the remaining time
    (``first_share`` where they come before the first attempt at a proof, from so many optional
    ``activities`` on), each with so much ``effort`` (CP-SAT's deterministic time), so many drawn
    ``together``, until so many in a row brought no better plan (``stale``).

    ``robots`` are freed at first; ``growth`` more after a neighbourhood was searched wholly and
    brought nothing, twice as many less after one whose search was cut short. Its last try decides a
    share of a neighbourhood's weight (``reaction``: Ropke and Pisinger 2006, doubled, for there are
    fewer tries here), which keeps a ``least_weight``; a better schedule whose motions did not fit
    is ``nearly`` worth a plan.
    """

    share: float = 0.5
    first_share: float = 0.9
    effort: float = 0.5
    activities: int = 300
    together: int = 4
    robots: int = 3
    growth: float = 0.2
    stale: int = 60
    reaction: float = 0.2
    least_weight: float = 0.1
    nearly: float = 0.3


@dataclass
class Roulette:
    """Draws neighbourhoods by their weights (Ropke and Pisinger 2006), which follow their gains.

    ``size``: how many robots are freed next. It grows where nothing better was left to be found
    among so few, and shrinks where there was no end to the search.
    """

    choices: Sequence[Choice]
    tuning: DescentSettings
    chance: random.Random
    most: int
    weights: list[float] = field(default_factory=list)
    size: float = 0.0

    def __post_init__(self) -> None:
        self.weights = [1.0] * len(self.choices)
        self.size = float(min(self.tuning.robots, self.most))

    def draw(self) -> int:
        """Return the number of the next neighbourhood."""
        return self.chance.choices(range(len(self.choices)), self.weights)[0]

    def learn(self, drawn: int, gain: float) -> None:
        """Note what a neighbourhood brought: 1 for a better plan, less for less."""
        keep = 1.0 - self.tuning.reaction
        weight = keep * self.weights[drawn] + self.tuning.reaction * gain
        self.weights[drawn] = max(self.tuning.least_weight, weight)

    def searched(self, *, wholly: bool) -> None:
        """Note that a neighbourhood brought nothing, and whether it was searched wholly."""
        step = self.tuning.growth if wholly else -2 * self.tuning.growth
        self.size = min(float(self.most), max(1.0, self.size + step))

    @property
    def robots(self) -> int:
        """How many robots to free now."""
        return round(self.size)


# ------------------ The scheduling problem that is left where some robots of a plan are freed
# The scheduling problem that is left where some robots of a plan are freed, and its solution.


@dataclass(frozen=True)
class SmallProblem:
    """``problem``: what is ``kept`` of a plan is present, in its order; what is ``open`` is decided
    anew; everything else is absent. Each of its schedules is one of the whole problem.
    """

    problem: SchedulingProblem
    kept: frozenset[str]
    open: frozenset[str]


def small_problem(view: View, freed: Freed) -> SmallProblem:
    """Return the problem that is left where ``freed`` is decided anew."""
    times, owners = view.times, view.owners.of
    loose = {
        name
        for name, (start, end) in times.items()
        if (not owners.get(name) or owners[name] & freed.robots)
        and start <= freed.until
        and freed.since <= end
    }
    kept = frozenset(times.keys() - loose)
    more = view.owners.open_to(freed.robots, kept)
    whole = {name: times.get(name, (0, 0)) for name in (*times, *sorted(more - times.keys()))}
    values = {
        name: value
        for name, value in view.plan.schedule.parameters.items()
        if name.rpartition(".")[0] in kept
    }
    everything = frozenset(loose | more)
    problem = restrict(
        view.relaxation, view.snapshot, CandidateSchedule(whole, values), free=everything
    )
    _keep_order(view, problem, kept)
    return SmallProblem(problem, kept, everything)


def _keep_order(view: View, problem: SchedulingProblem, kept: frozenset[str]) -> None:
    """Keep what each robot does of ``kept`` in the plan's order."""
    manager = problem.environment.expression_manager
    activities = {a.name: a for a in problem.activities}
    for robot in view.robots:
        own = [n for n in kept if robot in view.owners.of.get(n, ())]
        own.sort(key=lambda n: (view.times[n], n))
        for one, two in itertools.pairwise(own):
            after = view.times[one][1] <= view.times[two][0]
            first = activities[one].end if after else activities[one].start
            problem.add_constraint(manager.LE(first, activities[two].start))


Settings = Mapping[str, Any]
"""How a small problem is solved (``seed``, ``effort``, ``tuning``), with one thread: with the same
settings always alike."""


def solve_small(
    problem: SchedulingProblem,
    settings: Settings,
    guess: CandidateSchedule,
    deadline: Deadline,
) -> ScheduleReport:
    """Return the best schedule of a small problem that is found with so much effort; ``guess`` is
    the whole plan.
    """
    session = CpsatSession(problem, workers=1, **settings)
    return session.solve(deadline, optimal=True, hint=guess)


def solve_sent(
    problem: bytes, settings: Settings, guess: CandidateSchedule, seconds: float
) -> ScheduleReport:
    """Return the same for a problem that was sent to a worker. It has come with an environment of
    its own: workers on threads do not share expressions.
    """
    return solve_small(pickle.loads(problem), settings, guess, Deadline.after(seconds))


log = logging.getLogger(__name__)


@dataclass
class DescentState:
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

    tuning: DescentSettings = field(default_factory=DescentSettings)
    choices: Sequence[Choice] = field(
        default_factory=lambda: (*CHOICES, *parts("neighbourhoods").values())
    )

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
            state = DescentState(self, roulette)
            search.remembered[id(self)] = state
        assert isinstance(state, DescentState)
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

    def _step(self, search: Search, state: DescentState, deadline: Deadline) -> Incumbent | None:
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
        effort = self.tuning.effort
        settings = {"seed": search.seed, "effort": effort, "tuning": search.cpsat}
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
