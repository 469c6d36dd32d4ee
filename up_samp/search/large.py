"""Large problems: plans of thinned problems first, in which it is decided who does what.

A fleet of dozens has tens of thousands of optional activities, of which a plan has hundreds. A
scheduler's model of all of them takes longer to build than a plan takes to be found. So it is first
guessed who does which job (:mod:`up_samp.search.jobs`); the problem without everything that this
leaves out is solved by the usual search, its motions decided one after the other
(:mod:`up_samp.search.in_order`), and what comes of it is a plan of the whole problem. It is judged
as that.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import Deadline
from up_samp.model.snapshot import Snapshot
from up_samp.search.attempt import build, keep_if_better
from up_samp.search.bounds import Incumbent
from up_samp.search.conclusion import SearchResult, conclude
from up_samp.search.events import Phase
from up_samp.search.jobs import Deal, Jobs, deal, decided, find_jobs, state_order
from up_samp.search.jobs_bound import bound_by_jobs
from up_samp.search.loop import get_schedule, solve, state_what_is_known
from up_samp.search.search import Search
from up_samp.search.stages import BUILDING, STATING
from up_samp.search.tuning import LargeTuning
from up_samp.upio import read_itinerary
from up_samp.upio.thin import thinned

OpenThin = Callable[[SchedulingMotionProblem, Deadline], Search]
"""Opens a search on a thinned problem that asks the same motion service."""


@dataclass(frozen=True)
class Large:
    """A problem that is looked at in parts: see the module."""

    problem: SchedulingMotionProblem
    snapshot: Snapshot
    jobs: Jobs
    open_thin: OpenThin
    tuning: LargeTuning


def large_of(
    problem: SchedulingMotionProblem, snapshot: Snapshot, open_thin: OpenThin, tuning: LargeTuning
) -> Large | None:
    """Return a problem as a large one, or None where it is none, or has no jobs to deal out."""
    if sum(a.optional for a in problem.activities) < tuning.activities:
        return None
    jobs = find_jobs(problem, snapshot)
    return None if jobs is None else Large(problem, snapshot, jobs, open_thin, tuning)


def solve_large(
    search: Search, large: Large, *, optimal: bool
) -> Generator[Incumbent, None, SearchResult]:
    """Solve a large problem: a first plan by dealing out jobs, then the search as for any other
    problem, from that plan on.
    """
    search.tell.stage(Phase.PREPARE, "who does which job", len(large.jobs.options))
    with search.history.stages.of(BUILDING):
        found = plan_of_deal(search, large, deal(large.jobs, large.snapshot))
    better = None if found is None else keep_if_better(search, found)
    with search.history.stages.of(STATING):
        proven = bound_by_jobs(large.problem, search.facts, search.motions.service, large.jobs)
    search.bounds.lower = max(search.bounds.lower, proven)
    if better is not None:
        yield better
        if not optimal:
            return conclude(search)
    for better in deal_again(search, large):
        yield better
        if not optimal:
            return conclude(search)
    if search.bounds.met or search.budget.deadline.expired():
        return conclude(search)
    return (yield from solve(search, optimal=optimal))


def deal_again(search: Search, large: Large) -> Iterator[Incumbent]:
    """Yield better plans of other shares of the jobs, until the time is over that there is for it.

    Each share is drawn with other guesses of what drives take, more and more different.
    """
    deadline = search.budget.share(large.tuning.again, float("inf"))
    stale = 0
    for number in itertools.count(1):
        if deadline.expired() or search.bounds.met or stale >= large.tuning.stale:
            return
        noise = large.tuning.noise * min(number, 5)
        dealt = deal(large.jobs, large.snapshot, seed=search.seed + number, noise=noise)
        with search.history.stages.of(BUILDING):
            found = plan_of_deal(search, large, dealt)
        better = None if found is None else keep_if_better(search, found)
        stale = stale + 1 if better is None else 0
        if better is not None:
            yield better


def plan_of_deal(search: Search, large: Large, dealt: Deal) -> Incumbent | None:
    """Return a valid plan of the whole problem in which everybody does what was dealt out."""
    names = [a.name for a in large.problem.activities]
    problem = thinned(large.problem, decided(dealt, names))
    state_order(problem, dealt)
    deadline = search.budget.share(large.tuning.share, float("inf"))
    inner = large.open_thin(problem, deadline)
    try:
        state_what_is_known(inner)
        report = get_schedule(inner, optimal=False)
        if report.schedule is None:
            return None
        # another share of the jobs is tried sooner than this one is mended
        found = build(inner, read_itinerary(inner.knowledge.relaxation, report.schedule))
    finally:
        inner.history.take_times(inner.budget)
        inner.scheduler.close()
    if found is None:
        return None
    whole = search.plan_of(found.schedule, found.trajectories)
    return None if search.judged(whole.plan) else whole
