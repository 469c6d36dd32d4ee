"""The budget of a search: one deadline, what its parts may take of it, and what they took."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from up_samp.model import Deadline
from up_samp.model.deadline import clock
from up_samp.model.refinement import Refinement
from up_samp.search.knowledge import History

PARTS = {
    "proof": (0.3, 20.0),
    "doubt": (0.2, 2.0),
    "bound by proven facts": (0.3, 10.0),
    "why there is no schedule": (0.2, 15.0),
    "unobstructed motions": (0.2, 30.0),
    "orders that cannot change": (0.2, 10.0),
    "plans by an easier objective": (0.4, math.inf),
    "motions one at a time": (0.25, math.inf),
    "bounds of large problems": (0.1, math.inf),
    "a group of motions": (0.2, math.inf),
    "a schedule": (0.4, math.inf),
    "a proof while patience lasts": (0.75, math.inf),
    "candidates of many motions": (0.6, math.inf),
    "tours of a large problem": (0.6, math.inf),
    "one assignment": (0.6, math.inf),
    "who does which job": (0.3, math.inf),
    "patience": (0.25, 15.0),
}
"""What one part of a search may take of the time that is left: a share, and s at most.

*Motions*: a late answer for a group can still be repaired. *Schedules*: they get better with time,
but their motions have to be checked, too; :class:`SchedulerPace` tells how that goes on. *Large
problems*: tours get so much for a first plan, then the usual search has its turn, and again for
better ones; of the first, one assignment gets so much, and who does which job in it. *Patience*
lasts as much of the whole time limit at least: that is there to be used, and what finds the best
plans of small fleets begins late.
"""
_LONGEST_QUERY = 3600.0
"""s: limit of one motion query, however often it was doubled."""
_PATIENCE = 1.0
"""s: to go on at least without a better plan, where patience ends a search."""
_UNTIMED_RESTARTS = 3
"""Where there is no time limit."""
_STALE_RESTARTS = 8
"""In a row, that may bring nothing but guesses made before, from other random numbers."""


@dataclass
class Budget:
    """``query_seconds``: limit (s) of one motion query now (the paper's t_p).

    What was spent is told in the ``history``. ``patience``: how long
    to go on without a better plan, as a share of what it took to find the best one.
    """

    deadline: Deadline
    query_seconds: float
    patience: float = math.inf
    history: History = field(default_factory=History)
    _asking: bool = False
    _whole: Deadline | None = None
    """The deadline, while patience ends the search before it."""

    def planned(self) -> None:
        """Let patience begin anew: there is a better plan."""
        if math.isinf(self.patience):
            return
        whole = self.whole
        used, left = whole.used(), whole.remaining()
        share, most = PARTS["patience"]
        least = min(share * (used + left), most) if math.isfinite(left) else 0.0
        more = max(_PATIENCE, self.patience * max(used, least))
        self.deadline, self._whole = replace(whole, at=whole.within(more).at), whole

    @property
    def whole(self) -> Deadline:
        """Return the deadline of the whole, whatever patience says."""
        return self._whole or self.deadline

    @property
    def hurried(self) -> bool:
        """Whether patience may end the search before the time does."""
        return self._whole is not None

    @property
    def impatient(self) -> bool:
        """Whether it did."""
        return self.hurried and self.deadline.expired() and not self.whole.expired()

    def end(self) -> None:
        """Give back the time that patience left: for what is done in the end."""
        self.deadline, self._whole = self.whole, None

    def part(self, name: str) -> Deadline:
        """Return the deadline of one of the ``PARTS``."""
        return self.deadline.share(*PARTS[name])

    def query(self) -> Deadline:
        """Return the deadline of one motion query."""
        return self.deadline.within(self.query_seconds)

    def group(self, count: int) -> Deadline:
        """Return the deadline of one query for ``count`` motions together."""
        return self.part("a group of motions").within(self.query_seconds * max(1, count) ** 0.5)

    def double_queries(self) -> None:
        """Allow motion queries twice the time (line 19)."""
        self.query_seconds = min(2 * self.query_seconds, _LONGEST_QUERY)

    @property
    def unlimited(self) -> bool:
        """Whether there is no deadline."""
        return math.isinf(self.deadline.remaining())

    @contextmanager
    def motion_time(self) -> Iterator[None]:
        """Count what is done meanwhile as time for motions (nested calls count once)."""
        if self._asking:
            yield
            return
        started, self._asking = clock(), True
        try:
            yield
        finally:
            self.history.seconds_motion += clock() - started
            self._asking = False


# ------------------ How long the scheduler may take for its next answer, and what it is asked for


@dataclass
class SchedulerPace:
    """When the scheduler has to answer. ``staged``: a first plan before any proof, then proofs with
    more and more time, for a scheduler that goes on from what it knows. Else all of the time for
    each answer: another's would begin anew after a limit.
    """

    staged: bool
    proof_seconds: float = 15.0
    """Limit (s) of the next attempt at a proof."""
    share: tuple[float, float] = PARTS["a schedule"]
    """For the next schedule: all of the time once a part of it was not enough for any."""

    def deadline(self, budget: Budget, *, planned: bool, proving: bool) -> Deadline:
        """Return by when the scheduler has to answer; ``planned``: there is a plan already."""
        if not self.staged or (planned and not proving):
            return budget.deadline
        if proving:  # where patience may end it, the rest is for the motions of what it finds
            name = "a proof while patience lasts"
            whole = budget.part(name) if budget.hurried else budget.deadline
            return whole.within(self.proof_seconds)
        return budget.deadline.share(*self.share)

    def more(self, *, planned: bool) -> bool:
        """Give the scheduler more time after an answer that came too late: twice as much for
        proofs, all of it for the first schedule. Return whether it gets any.
        """
        if not self.staged:
            return False
        if planned:
            self.proof_seconds *= 2
            return True
        before, self.share = self.share, (1.0, math.inf)
        return before != self.share


# ------------------ Restarts without what was only guessed
# From other random numbers (lines 17 to 20).


@dataclass
class Restarts:
    """``limit``: so many at most (None: without a plan as long as there is time, with one as long
    as they bring anything new).

    ``stale``: how many in a row guessed nothing new.
    """

    limit: int | None = None
    done: int = 0
    stale: int = 0
    _before: set[frozenset[object]] = field(default_factory=set)

    def may_begin(self, budget: Budget, *, planned: bool) -> bool:
        """Return whether another attempt is worth it. Without a plan it is while there is time: the
        next random numbers may be the lucky ones.
        """
        if self.limit is not None:
            return self.done < self.limit
        if budget.unlimited:
            return self.done < _UNTIMED_RESTARTS
        return not planned or self.stale < _STALE_RESTARTS

    def begin(self, guesses: Sequence[Refinement]) -> None:
        """Count a restart that drops these guesses."""
        known = frozenset(r.statement for r in guesses)
        self.done += 1
        self.stale = self.stale + 1 if known in self._before else 0
        self._before.add(known)
