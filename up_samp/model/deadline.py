"""One deadline for everything that takes time."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

from up_samp.model.errors import ProblemError, short


@dataclass(frozen=True)
class Deadline:
    """A point in (monotonic) time that all parts of one solve share.

    ``Deadline.after(5.0)`` ends in five seconds, ``Deadline.never()`` does not end.
    """

    at: float = math.inf
    started: float = field(default_factory=time.monotonic)

    @staticmethod
    def after(seconds: float | None) -> Deadline:
        """Return the deadline ``seconds`` from now (``None``: never)."""
        now = time.monotonic()
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

    def remaining(self) -> float:
        """Return the seconds left (``inf`` without a limit, never below 0)."""
        return max(0.0, self.at - time.monotonic())

    def elapsed(self) -> float:
        """Return the seconds since the deadline was set."""
        return time.monotonic() - self.started

    def expired(self) -> bool:
        """Return whether no time is left."""
        return time.monotonic() >= self.at

    def within(self, seconds: float | None) -> Deadline:
        """Return the earlier of this deadline and ``seconds`` from now."""
        now = time.monotonic()
        return self if seconds is None else Deadline(min(self.at, now + seconds), now)
