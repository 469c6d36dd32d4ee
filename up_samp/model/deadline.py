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


def clock() -> float:
    """Return the time (s) that deadlines go by: monotonic, and still while kernels are compiled."""
    return time.monotonic() - _not_counted[0]


def do_not_count(seconds: float) -> None:
    """Let all deadlines end so much later: this process has waited for its compiler, which it does
    once on a machine.
    """
    _not_counted[0] += seconds


@dataclass(frozen=True)
class Deadline:
    """A point in time (see :func:`clock`) that all parts of one solve share.

    ``Deadline.after(5.0)`` ends in five seconds, ``Deadline.never()`` does not end.
    """

    at: float = math.inf
    started: float = field(default_factory=clock)

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
    def never() -> Deadline:
        """Return a deadline that never ends."""
        return Deadline.after(None)

    @property
    def moment(self) -> float:
        """When it ends on the clock of the whole machine, ``time.monotonic``, as things stand."""
        return self.at + _not_counted[0]

    def remaining(self) -> float:
        """Return the seconds left (``inf`` without a limit, never below 0)."""
        return max(0.0, self.at - clock())

    def elapsed(self) -> float:
        """Return the seconds since the deadline was set."""
        return clock() - self.started

    def expired(self) -> bool:
        """Return whether no time is left."""
        return clock() >= self.at

    def within(self, seconds: float | None) -> Deadline:
        """Return the earlier of this deadline and ``seconds`` from now."""
        now = clock()
        return self if seconds is None else Deadline(min(self.at, now + seconds), now)


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


def check_time() -> None:
    """Raise :class:`~up_samp.model.OutOfTimeError` if the deadline in force is over."""
    deadline = _in_force.get()
    if deadline is not None and deadline.expired():
        raise OutOfTimeError("no time is left")
