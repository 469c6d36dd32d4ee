"""A lower bound from all the work there is: the least time that travellers need for their tasks."""

from __future__ import annotations

import itertools
import math
from dataclasses import astuple, dataclass

from ortools.sat.python import cp_model

from up_samp.model import Deadline
from up_samp.scheduling.cpsat.encode.terms import INFINITE
from up_samp.scheduling.cpsat.routing.dispatch import RoutedWork
from up_samp.scheduling.cpsat.routing.route import way_back
from up_samp.scheduling.cpsat.routing.rules import (
    Programme,
    SequenceRules,
    cost,
    tails_of_wanted,
)
from up_samp.scheduling.cpsat.routing.sequences import Sequences, raised
from up_samp.scheduling.cpsat.solve.runner import run
from up_samp.tuning import Tuning

_STATES = 2_000_000
"""States of the dynamic programme over sets of tasks; with more it is only asked who does what."""


# ------------------ A lower bound for large fleets: who does which tasks, with times left out
# Each traveller does its tasks in some order; before each of them it comes from another one, or
# from its start, which only the first one can. So they take at least what each task needs from the
# nearest other one (one of them: from the start), and the way back of one. The least time by which
# everybody ends, however tasks are dealt out (generalised assignment, by CP-SAT), is a bound.


@dataclass(frozen=True)
class TaskShare:
    """What one task costs one traveller, with its own length: ``first`` if it comes from its start,
    ``later`` if not, and the way ``back`` if it is the last one.
    """

    first: int
    later: int
    back: int

    def least_of(self, other: TaskShare) -> TaskShare:
        """Return what is less of this and of another way to do the task."""
        return TaskShare(*map(min, astuple(self), astuple(other)))

    @property
    def base(self) -> int:
        """What it costs if it is not the first one (or, where it has to be that, as the first)."""
        return self.later if self.later < INFINITE else self.first

    @property
    def start(self) -> int:
        """What it costs beside that if it is the first one; mostly less than nothing."""
        return self.first - self.base if self.first < INFINITE else 0

    @property
    def least(self) -> int:
        """What it costs alone."""
        return self.first + self.back if self.first < INFINITE else self.later + self.back

    @property
    def most(self) -> int:
        """The greatest time that is possible."""
        return max(c for c in (self.first, self.later) if c < INFINITE) + self.back


def shares(work: RoutedWork) -> list[dict[int, TaskShare]]:
    """Return, for each wanted task, what it costs each traveller that can do it, in whichever way
    that is least.
    """
    wanted = [task for task in work.tasks if task.wanted]
    spots: dict[int, list[tuple[int, int]]] = {}
    for number, task in enumerate(wanted):
        for axis, stop, places in task.ways:
            if stop not in work.routes[axis].rests:  # from there on it comes from where it was
                spots.setdefault(axis, []).extend((number, place) for place in places)
    found = []
    for number, task in enumerate(wanted):
        mine: dict[int, TaskShare] = {}
        for axis, stop, places in task.ways:
            route = work.routes[axis]
            others = {place for other, place in spots.get(axis, ()) if other != number}
            first = min(cost(route, route.initial, p, stop, first=True) for p in places)
            pairs = itertools.product(others, places)
            costs = (cost(route, here, p, stop, first=False) for here, p in pairs)
            later, back = min(costs, default=INFINITE), way_back(route, places, route.final)
            if min(first, later) < INFINITE:
                first, later = (min(INFINITE, c + task.length) for c in (first, later))
                share = TaskShare(first, later, back)
                mine[axis] = share.least_of(mine.get(axis, share))
        found.append(mine)
    return found


def bound_by_assignment(work: RoutedWork, known: int, deadline: Deadline = Deadline.never()) -> int:
    """Return a lower bound on the makespan, at least ``known``: by when the travellers can share
    all tasks, as far as that is proven with a limited effort.

    Assumes: a traveller comes to each task from its start or from another task that is done.
    """
    costs = shares(work)
    if not costs or any(not mine for mine in costs):
        return known
    most = sum(max(share.most for share in mine.values()) for mine in costs)
    low = max(known, max(min(s.least for s in mine.values()) for mine in costs))
    model = cp_model.CpModel()
    end = model.new_int_var(low, max(low, most), "")
    does: list[list[cp_model.IntVar]] = [[] for _ in costs]
    for axis in sorted({axis for mine in costs for axis in mine}):
        at_all, total = model.new_bool_var(""), []
        firsts, lasts = [], []
        for task, share in ((task, mine[axis]) for task, mine in enumerate(costs) if axis in mine):
            this, first, last = (model.new_bool_var("") for _ in range(3))
            model.add_implication(this, at_all)
            model.add_implication(first, this)
            model.add_implication(last, this)
            total.append(share.base * this + share.start * first + share.back * last)
            firsts.append(first)
            lasts.append(last)
            does[task].append(this)
        model.add(sum(firsts) == at_all)
        model.add(sum(lasts) == at_all)
        model.add(sum(total) <= end)
    for travellers in does:
        model.add_bool_or(travellers)  # more than one may do it, if a plan has it done twice
    model.minimize(end)
    options = {"num_workers": 1, "linearization_level": 2, "max_deterministic_time": 2.0}
    answer = run(model, deadline, lambda *_: None, options=options)
    return max(low, math.ceil(answer.bound - 1e-6)) if math.isfinite(answer.bound) else low


# ------------------ A lower bound from all the work there is
# The least time that travellers need for their tasks. Tasks are done in some order, by their
# starts; whoever does the next one comes from where it did its last one. The least total over all
# orders that the precedences allow is found by dynamic programming over (tasks done, where
# everybody is), after Held and Karp (1962). Everybody's share ends by the makespan, so the total
# by the number of travellers is a bound. Sequences of tasks then prove more (``sequences``).


def bound_by_releases(work: RoutedWork) -> int:
    """Return a lower bound on the makespan by when tasks are released, and what comes after them:
    of those that are wanted.
    """
    pairs = zip(work.tasks, tails_of_wanted(work), strict=True)
    return max((task.release + tail for task, tail in pairs if task.wanted), default=0)


@dataclass(frozen=True)
class WorkBound:
    """A lower bound on the makespan, and the sequences of tasks that it was found among (``None``:
    they are too many); what the proof of a greater bound failed at is ``found`` there.
    """

    value: int
    sequences: Sequences | None = None


def bound_by_work(
    work: RoutedWork,
    known: int = 0,
    deadline: Deadline = Deadline.never(),
    *,
    value: int = 0,
    tuning: Tuning = Tuning(),
) -> WorkBound:
    """Return a lower bound on the makespan; of large fleets, by who does what alone.

    Assumes: every wanted task is done by one of its ways, and a traveller is at one place at a
    time.

    :param known: a lower bound.
    :param deadline: when to give up with what is known (None: never).
    :param value: the makespan of a schedule (0: there is none); no more is asked for.
    """
    known = max(known, bound_by_releases(work))
    programme = Programme.of(work, _STATES) or Programme.of(work, _STATES, doors=False)
    if programme is None:
        return WorkBound(bound_by_assignment(work, known, deadline))
    tables = programme.tables(deadline)
    if tables is None or programme.start(tables) >= INFINITE:
        return WorkBound(known)
    total = programme.start(tables)
    known = max(known, -(-total // len(work.routes)))
    rules = SequenceRules.of(work, programme, tables)
    if rules is None:
        return WorkBound(known)
    sequences = Sequences(rules, tuning.labels)
    if tuning.labels:
        known = raised(sequences.plain(), known, deadline, value)
        known = raised(sequences, known, deadline, value)
    return WorkBound(known, sequences)
