"""How a model is solved: stages in a fixed order, as data.

Each stage is named, says when it applies, and adds to what is known; the solve ends as soon as
nothing is left to be known, or no time. The first ones build on a schedule in hand and on routes,
the last ones are CP-SAT's own search.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import RoutedWork, find_work
from up_samp.scheduling.cpsat.routing.route import Route, changes_by_name, expand
from up_samp.scheduling.cpsat.routing.rules import NEVER
from up_samp.scheduling.cpsat.routing.sequences import Sequences
from up_samp.scheduling.cpsat.routing.workload import bound_by_work, quick_sequences
from up_samp.scheduling.cpsat.solve.attempts import Attempts, hint_values

_SHARE = 0.35
"""Of the time that is left: for sequences, and for bounds without search where the optimum is not
asked for."""
_BOUNDING = 0.7
"""For bounds without search, where it is: most of what is proven of routed problems they prove."""
_LABELS_AGAIN = 180_000
"""Beginnings of sequences that proofs may look at if bounds were sought before."""
_LABELS_ASIDE = 60_000
"""The same where the optimum is not asked for."""
_BEAMS = (150, 600, 2_400, 9_600)
"""Beginnings of each length among which sequences are sought, one beam after the other: not the
last one where the optimum is not asked for."""
_LOOSER = (1.0, 1.05, 1.15, 1.4, 2.0, 4.0)
"""By when a first sequence may end, over the bound, one after the other."""
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
    """What a bound was met by is a schedule mostly."""
    assert search.sequences is not None
    _realize(search, _work(search), search.sequences)


def _realize(search: Solve, work: RoutedWork, sequences: Sequences) -> bool:
    """Make better and better schedules of the sequences that were found; return whether one was."""
    whole, before, tried = search.whole, search.whole.best, set[frozenset[str]]()
    for found in sequences.found:
        stops = CandidateSchedule(sequences.rules.times_of(found))
        guess = expand(work.routes, stops, changes_by_name(whole.model))
        names = frozenset(guess.times)
        if whole.over():
            break
        longer = whole.minimizes_makespan and whole.best and guess.makespan >= whole.value
        if names not in tried and not longer:
            whole.realize(guess, work.others)
        tried.add(names)
    return whole.best is not before


def _ends(whole: Attempts) -> Iterator[int]:
    """Yield by when sequences are sought to end: later and later until there is a schedule, then
    before the one in hand.
    """
    for share in _LOOSER:
        if whole.best is None:
            yield int(share * whole.bound) + 1
    while whole.best is not None:
        yield whole.value - 1


def _seek_sequences(search: Solve) -> None:
    """Seek sequences among a few promising beginnings, with whatever opens doors, as long as they
    lead to better and better schedules.
    """
    whole, work, deadline = search.whole, _work(search), search.share()
    sequences = quick_sequences(work, deadline)
    if sequences is None:
        return
    for width in _BEAMS[: 4 if search.optimal else 3]:
        for end in _ends(whole):
            found = sequences.sought(end, width, deadline) and _realize(search, work, sequences)
            if whole.over() or deadline.expired():
                return
            if whole.best is not None and not found:
                break


def _work(search: Solve) -> RoutedWork:
    assert search.work is not None
    return search.work


def _is_paid_by_activity(search: Solve) -> bool:
    """Whether there is a schedule to make better, and it costs what its activities cost."""
    whole = search.whole
    return whole.best is not None and not whole.model.plain and bool(whole.prices)


def _seek_cheaper(search: Solve) -> None:
    """Seek sequences that cost less than the schedule in hand, with prices for times."""
    whole, deadline = search.whole, search.share()
    whole.without_presolve(whole.cap)  # tiny ones are solved at once
    work = find_work(whole.model, find_routes(whole.model))
    sequences = quick_sequences(work.priced(whole.prices), deadline, thrifty=True)
    for width in _BEAMS:
        if sequences is None or whole.over() or not sequences.sought(NEVER - 1, width, deadline):
            return
        search.better |= _realize(search, work, sequences)


def _goes_on(search: Solve) -> bool:
    """Whether the whole problem is searched for schedules better than the one in hand: without a
    proof to make, there is none soon where sequences have none.
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
    Stage("prove it after all", _is_still_to_prove, lambda s: s.whole.prove_quickly()),
    Stage("follow the bound", _met_by, _follow_the_bound),
    Stage(
        "seek sequences",
        lambda s: s.work is not None and s.whole.orders.tuning.labels > 0,
        _seek_sequences,
    ),
    Stage("seek cheaper sequences", _is_paid_by_activity, _seek_cheaper),
    Stage("climb: a small problem", lambda s: not s.routes, lambda s: s.whole.climb()),
    Stage(
        FIRST,
        lambda s: s.whole.best is None,
        lambda s: s.whole.first(s.expected),
    ),
    Stage("prove the schedule quickly", _goes_on, lambda s: s.whole.prove_quickly()),
    Stage("search until proven, or good enough", _goes_on, _finish),
)
