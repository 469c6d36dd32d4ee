"""How a model is solved: stages in a fixed order, as data.

Each stage is named, says when it applies, and adds to what is known; the solve ends as soon as
nothing is left to be known, or no time. The first ones build on a schedule in hand and on routes,
the last ones are CP-SAT's own search.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import RoutedWork, find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import (
    Step,
    decode,
    improve,
    steps_of,
    times_of,
)
from up_samp.scheduling.cpsat.routing.route import Route
from up_samp.scheduling.cpsat.routing.sequences import Sequences
from up_samp.scheduling.cpsat.routing.workload import bound_by_work
from up_samp.scheduling.cpsat.solve.attempts import Attempts, hint_values

_SHARE = 0.35
"""Of the time that is left: for tours, and for bounds without search where the optimum is not asked
for."""
_BOUNDING = 0.7
"""For bounds without search, where it is: most of what is proven of routed problems they prove."""
_LABELS_AGAIN = 180_000
"""Beginnings of sequences that proofs may look at if bounds were sought before."""
_LABELS_ASIDE = 60_000
"""The same where the optimum is not asked for."""
_BEAM = 750
"""Beginnings of each length among which sequences are sought that end before the schedule in hand:
a fifth of them where the optimum is not asked for."""
_AGAIN, _LONGER, _TIMES = 0.5, 5, 30
"""Of annealing for better schedules: share of the time, how much longer it takes, how often."""
_FEW_TASKS = 8
"""Up to so many, a greedy tour will do: the proof finds the best one."""
_CONTENT = 1.0
"""CP-SAT's deterministic time for the whole problem, where the optimum is not asked for."""


@dataclass
class Solve:
    """One solve: the attempts at the whole model, and what was recognised in it.

    ``guess`` is a schedule to start from (it may break what was
    added since), ``expected`` the makespan to expect (0: not known). ``again``: bounds were sought
    before with all effort, when less was stated; ``bounded``: they were here.
    """

    whole: Attempts
    guess: CandidateSchedule | None = None
    routes: list[Route] | None = None
    work: RoutedWork | None = None
    sequences: Sequences | None = None
    """All of the tasks, with those that the lower bound was met by."""
    expected: int = 0
    again: bool = False
    bounded: bool = False
    soon: bool = False
    """Whoever asks would look at a schedule better than the guess before more is proven ..."""
    better: bool = False
    """... and there is one."""
    done: list[str] = field(default_factory=list)
    """The stages that were run."""

    @property
    def optimal(self) -> bool:
        """Whether the proven optimum is asked for."""
        return self.whole.orders.optimal

    def share(self, share: float = _SHARE) -> Deadline:
        """Return the deadline of a stage that may take no more than a share of what is left."""
        deadline = self.whole.deadline
        return deadline.within(share * deadline.remaining())


@dataclass(frozen=True)
class Stage:
    """One stage of a solve: ``run`` it where it ``applies``."""

    name: str
    applies: Callable[[Solve], bool]
    run: Callable[[Solve], None]


def solve(search: Solve) -> None:
    """Run the stages in order until one of them ends the solve."""
    if search.guess is not None:
        search.whole.known.update(hint_values(search.whole.model, search.guess))
        search.expected = search.guess.makespan
    for stage in STAGES:
        if stage.applies(search):
            search.done.append(stage.name)
            stage.run(search)
        if search.whole.over() or (search.soon and search.better):
            return


def _is_given(search: Solve) -> bool:
    return search.guess is not None and bool(search.guess.times)


def _has_guess(search: Solve) -> bool:
    return _is_given(search) and search.whole.minimizes_makespan


def _is_near(search: Solve) -> bool:
    """Whether there may be a quick proof from the schedule that was given: it ends within a tenth
    of the bound, as far as that is known. With more between them CP-SAT proves nothing soon.
    """
    return _has_guess(search) and search.whole.value <= 1.1 * (search.whole.bound or sys.maxsize)


def _is_still_to_prove(search: Solve) -> bool:
    """The same, once bounds were sought; where none are, it is tried anyhow."""
    near = _is_near(search) or (_has_guess(search) and search.work is None)
    return near and QUICKLY not in search.done


def _realize_guess(search: Solve) -> None:
    """The same activities again, if they still fit, are mostly near the optimum."""
    assert search.guess is not None
    search.whole.realize(search.guess)


def _find_routes(search: Solve) -> None:
    model = search.whole.model
    wanted = search.whole.minimizes_makespan and not model.plain
    search.routes = find_routes(model) if wanted else []
    search.work = find_work(search.whole.model, search.routes) if search.routes else None


def _bound_by_work(search: Solve) -> None:
    whole = search.whole
    deadline = search.share(_BOUNDING if search.optimal else _SHARE)
    tuning = whole.orders.tuning
    most = tuning.labels if search.optimal else _LABELS_ASIDE
    labels = min(_LABELS_AGAIN if search.again else tuning.labels, most)
    tuning = replace(tuning, labels=labels)
    found = bound_by_work(_work(search), whole.bound, deadline, value=whole.value, tuning=tuning)
    whole.bound, some = found.value, found.sequences
    search.sequences = some
    if search.optimal and some is not None:
        search.bounded = bool(some.found) or some.is_spent


def _met_by(search: Solve) -> bool:
    """Whether the bound was met by sequences."""
    return search.sequences is not None and bool(search.sequences.found)


def _follow_the_bound(search: Solve) -> None:
    """What a bound was met by is a schedule mostly, or near one."""
    assert search.sequences is not None
    if not _realize_one(search, search.sequences):
        tour = decode(_work(search), _steps(search))
        if tour is not None and tour.schedule.makespan < search.whole.value:
            search.whole.realize(tour.schedule, _work(search).others)


def _realize_one(search: Solve, sequences: Sequences) -> bool:
    """Make the first one of the sequences that were found, and that can be, a better schedule."""
    whole = search.whole
    for found in sequences.found:
        guess = times_of(whole.model, _work(search), sequences, found)
        if whole.over() or guess.makespan >= whole.value:
            break
        if whole.realize(guess, _work(search).others):
            return True
    return False


def _seek_sequences(search: Solve) -> None:
    """Seek sequences that end before the schedule in hand, among a few promising beginnings, as
    long as they lead to better ones.
    """
    whole = search.whole
    assert search.sequences is not None
    deadline = search.share()
    width = _BEAM if search.optimal else _BEAM // 5
    sequences = Sequences(search.sequences.rules, sys.maxsize)
    while not whole.over() and sequences.sought(whole.value - 1, width, deadline):
        if not _realize_one(search, sequences):
            return


def _work(search: Solve) -> RoutedWork:
    assert search.work is not None
    return search.work


def _steps(search: Solve) -> list[Step]:
    """Return who does which task in the sequence that the bound was met by (none: it was not)."""
    if search.sequences is None or not search.sequences.found:
        return []
    return steps_of(_work(search), search.sequences, search.sequences.found[0])


def _anneal_tours(search: Solve) -> None:
    work, tuning = _work(search), search.whole.orders.tuning
    few = search.optimal and len(work.tasks) <= _FEW_TASKS
    rounds = 0 if few else tuning.tour_rounds * len(work.tasks)
    deadline = search.share()
    seed, bound = search.whole.orders.seed, search.whole.bound
    tour = improve(work, rounds, seed, deadline, start=_steps(search), enough=bound)
    if tour is not None:
        search.whole.realize(tour.schedule, work.others)
        # a tour that is no schedule tells how long one is, not how short one may be
        value = search.whole.value or 4 * tour.schedule.makespan // 3
        search.expected = max(search.expected, value)


def _may_anneal_again(whole: Attempts) -> bool:
    """Whether there is a schedule to make better, and no limit of effort: annealing counts none."""
    return whole.best is not None and whole.left is None


def _anneal_again(search: Solve) -> None:
    """Anneal tours from other random numbers, each longer, for schedules better than the one in
    hand.
    """
    whole, work = search.whole, _work(search)
    _anneal_on(search, [work], _LONGER, whole.orders.seed + whole.value)


def _anneal_on(search: Solve, works: list[RoutedWork], longer: int, seed: int) -> None:
    """Anneal tours as long as a share of the time lasts; ``works`` say by turns what they cost."""
    whole = search.whole
    rounds = longer * whole.orders.tuning.tour_rounds * len(works[0].tasks)
    deadline = search.share(_AGAIN)
    by_makespan = whole.minimizes_makespan
    enough, fixed = (whole.bound, 0) if by_makespan else (0, whole.model.objective.const)
    for number in range(_TIMES):
        if whole.over() or deadline.expired() or not works:
            return
        work, before = works[number % len(works)], whole.value
        known = len(work.tours)
        tour = improve(work, rounds, seed + number, deadline, enough=enough)
        if tour is not None and work.worth(tour.schedule) + fixed < before:
            whole.realize(tour.schedule, work.others)
            search.better |= whole.value < before
        if len(work.tours) == known:
            # no sequence came by that was not known: hardly any other will
            works = [other for other in works if other is not work]


def _is_paid_by_activity(search: Solve) -> bool:
    """Whether there is a schedule to make better, and it costs what its activities cost."""
    whole = search.whole
    return _may_anneal_again(whole) and not whole.model.plain and bool(whole.prices)


def _anneal_costs(search: Solve) -> None:
    """Anneal tours by what their activities cost, for schedules that cost less than the one in
    hand; by turns those that end later, too: a limit of what else they cost may ask for the first.
    """
    whole, prices = search.whole, search.whole.prices
    assert whole.best is not None
    last, much = whole.best.makespan, sum(map(abs, prices.values()))

    def worth(schedule: CandidateSchedule, most: float) -> float:
        cost = sum(prices.get(name, 0) for name in schedule.times)
        return cost + much * max(0.0, schedule.makespan - most)

    whole.without_presolve(whole.cap)  # tiny ones are solved at once
    work = find_work(whole.model, find_routes(whole.model))
    by_turns = [replace(work, worth=partial(worth, most=most)) for most in (last, math.inf)]
    _anneal_on(search, by_turns, 1, whole.orders.seed)


def _goes_on(search: Solve) -> bool:
    """Whether the whole problem is searched for schedules better than the one in hand: without a
    proof to make, there is none soon where tours have none.
    """
    return search.optimal or not search.routes or FIRST in search.done


def _finish(search: Solve) -> None:
    search.whole.finish(None if search.optimal else _CONTENT)


FIRST, QUICKLY = "find a first schedule", "prove it quickly"
STAGES = (
    Stage("make the given schedule fit", _is_given, _realize_guess),
    Stage(QUICKLY, _is_near, lambda s: s.whole.prove_quickly()),
    Stage("look for routes", lambda s: True, _find_routes),
    Stage("bound by work", lambda s: s.work is not None, _bound_by_work),
    Stage(
        "anneal tours again",
        lambda s: s.optimal and s.work is not None and _may_anneal_again(s.whole),
        _anneal_again,
    ),
    Stage("prove it after all", _is_still_to_prove, lambda s: s.whole.prove_quickly()),
    Stage(
        "follow the bound",
        lambda s: _met_by(s) and s.whole.best is not None,
        _follow_the_bound,
    ),
    Stage("anneal tours", lambda s: s.work is not None and s.whole.best is None, _anneal_tours),
    Stage(
        "seek sequences",
        lambda s: s.sequences is not None and s.whole.best is not None,
        _seek_sequences,
    ),
    Stage(
        "anneal tours by their costs",
        _is_paid_by_activity,
        _anneal_costs,
    ),
    Stage("climb: a small problem", lambda s: not s.routes, lambda s: s.whole.climb()),
    Stage(
        FIRST,
        lambda s: s.whole.best is None,
        lambda s: s.whole.first(s.expected),
    ),
    Stage("prove the schedule quickly", _goes_on, lambda s: s.whole.prove_quickly()),
    Stage("search until proven, or good enough", _goes_on, _finish),
)
