"""One deadline for everything that takes time."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field

from up_samp.model.errors import OutOfTimeError, ProblemError, short

_not_counted = [0.0]
"""Seconds of this process that no deadline counts."""
_computing = [False]
"""Whether deadlines go by what this process computes."""
_BUSY = 20.0
"""How many seconds may pass on the machine's clock for one that this process computes."""


def clock() -> float:
    """Return the time (s) that deadlines go by: that of ``time.monotonic`` (within
    :func:`computing_time`: this process's computing) without what was taken
    out of it (:func:`do_not_count`). It goes back by so much when that is told.
    """
    now = time.process_time if _computing[0] else time.monotonic
    return now() - _not_counted[0]


@contextlib.contextmanager
def computing_time() -> Iterator[None]:
    """Let deadlines count the seconds for which this process computes, until the block is left:
    whatever runs beside it on the machine takes nothing away from them.
    """
    before, _computing[0] = _computing[0], True
    try:
        yield
    finally:
        _computing[0] = before


def do_not_count(seconds: float) -> None:
    """Let all deadlines end so much later: this process has waited for its compiler, which it does
    once on a machine.
    """
    _not_counted[0] += seconds


TICK = 1e-3
"""Seconds of work that one look at a counted deadline stands for."""

LEAST_LEFT = 0.1
"""Share of a counted deadline's whole time that is left to plan with, however much is done: when it
ends is for the clock alone to say.
"""


@dataclass
class CountedWork:
    """What was done, counted as seconds, for deadlines that do not go by the clock.

    ``total``: the seconds there are; ``until`` (of :func:`clock`): when all is over nevertheless.
    """

    total: float
    until: float
    spent: float = 0.0

    def over(self) -> bool:
        """Return whether the time on the clock is over."""
        return clock() >= self.until


@dataclass(frozen=True)
class Deadline:
    """A point in time (see :func:`clock`) that all parts of one solve share.

    ``Deadline.after(5.0)`` ends in five seconds, ``Deadline.never()`` does not end. With ``work``
    its parts (:meth:`within`) end after so much work, the same on every machine, and ``at`` counts
    in seconds of work; only the whole ends by the clock.
    """

    at: float = math.inf
    started: float = field(default_factory=clock)
    work: CountedWork | None = field(default=None, compare=False)

    @staticmethod
    def after(seconds: float | None) -> Deadline:
        """Return the deadline ``seconds`` from now (``None``: never)."""
        now = clock()
        if seconds is None:
            return Deadline(math.inf, now)
        number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
        if not number or not seconds >= 0:  # NaN is not
            raise ProblemError(
                f"a time limit must be a non-negative number of seconds, not {short(seconds)}"
            )
        return Deadline(now + seconds, now)

    @staticmethod
    def counted(seconds: float | None) -> Deadline:
        """Return the same for a solve whose parts end by the work that they did: every look at such
        a deadline counts as ``TICK`` s of it.
        """
        whole = Deadline.after(seconds)
        total = math.inf if seconds is None else float(seconds)
        return Deadline(math.inf, whole.started, CountedWork(total, whole.at))

    @staticmethod
    def never() -> Deadline:
        """Return a deadline that never ends."""
        return Deadline.after(None)

    @property
    def _last(self) -> float:
        """When all is over by the clock."""
        return self.at if self.work is None else self.work.until

    @property
    def moment(self) -> float:
        """When it ends on the clock of the whole machine, ``time.monotonic``, as things stand; at
        the latest, where it counts computing.
        """
        left = self._last - clock()
        return time.monotonic() + left * (_BUSY if _computing[0] else 1.0)

    def remaining(self) -> float:
        """Return the seconds left (``inf`` without a limit, never below 0)."""
        work = self.work
        if work is None:
            return max(0.0, self.at - clock())
        if work.over():
            return 0.0
        if math.isinf(self.at):
            return max(work.total - work.spent, LEAST_LEFT * work.total)
        return max(0.0, self.at - work.spent)

    def elapsed(self) -> float:
        """Return the seconds since the deadline was set."""
        return clock() - self.started

    def used(self) -> float:
        """Return the seconds since it was set, in what it counts: work, where it counts that."""
        return self.elapsed() if self.work is None else self.work.spent

    def expired(self) -> bool:
        """Return whether no time is left."""
        if self.work is None:
            return clock() >= self.at
        self.work.spent += TICK
        return self.work.over() or self.work.spent >= self.at

    def spend(self, seconds: float) -> None:
        """Count work that was done without a look at the deadline."""
        if self.work is not None:
            self.work.spent += seconds

    def lengthen(self) -> bool:
        """Count on twice as much work where all is done that was counted on, and the clock says
        that there is time left; return whether that is so.
        """
        if self.work is None:
            return False
        self.work.total *= 2
        return not self.work.over()

    def over(self, grace: float = 0.0) -> bool:
        """Return whether the clock says that all was over ``grace`` s ago, which is no work."""
        return clock() >= self._last + grace

    def within(self, seconds: float | None) -> Deadline:
        """Return the earlier of this deadline and ``seconds`` from now."""
        now = clock()
        if seconds is None:
            return self
        begin = now if self.work is None else self.work.spent
        return Deadline(min(self.at, begin + seconds), now, self.work)

    def share(self, share: float, most: float = math.inf) -> Deadline:
        """Return the deadline of a part: a share of what is left, at most so many seconds."""
        return self.within(min(most, share * self.remaining()))


_in_force: ContextVar[Deadline | None] = ContextVar("deadline in force", default=None)


@contextlib.contextmanager
def in_force(deadline: Deadline) -> Iterator[None]:
    """Let :func:`check_time` look at a deadline, in this thread, until the block is left.

    For stages that are asked for in many places and take long on large inputs only (fields of
    distances, models): they need not be told, and are given up whole.
    """
    token = _in_force.set(deadline)
    try:
        yield
    finally:
        _in_force.reset(token)


def check_time(grace: float = 0.0) -> None:
    """Raise :class:`~up_samp.model.OutOfTimeError` if the deadline in force was over ``grace`` s
    ago: what only has to be written down and judged is worth a moment more.
    """
    deadline = _in_force.get()
    if deadline is not None and deadline.over(grace):
        raise OutOfTimeError("no time is left")
