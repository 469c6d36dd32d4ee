"""The scheduling problem that is left where some robots of a plan are freed, and its solution."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import dataclass

from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import CandidateSchedule, Deadline, ScheduleReport
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.tuning import CpsatTuning
from up_samp.search.neighbourhoods.choices import Freed
from up_samp.search.neighbourhoods.view import View
from up_samp.upio.restrict import restrict


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


@dataclass(frozen=True)
class Settings:
    """How a small problem is solved, with one thread: with the same settings always alike."""

    seed: int
    effort: float
    tuning: CpsatTuning


def solve_small(
    problem: SchedulingProblem, settings: Settings, guess: CandidateSchedule, deadline: Deadline
) -> ScheduleReport:
    """Return the best schedule of a small problem that is found with so much effort; ``guess`` is
    the whole plan.
    """
    session = CpsatSession(
        problem,
        seed=settings.seed,
        workers=1,
        effort=settings.effort,
        tuning=settings.tuning,
    )
    return session.solve(deadline, optimal=True, hint=guess)


def solve_sent(
    problem: bytes, settings: Settings, guess: CandidateSchedule, seconds: float
) -> ScheduleReport:
    """Return the same for a problem that was sent to a worker. It has come with an environment of
    its own: workers on threads do not share expressions.
    """
    return solve_small(pickle.loads(problem), settings, guess, Deadline.after(seconds))
