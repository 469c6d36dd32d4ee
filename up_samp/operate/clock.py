"""What time it is on the floor: the day's, or a simulated one. Seconds since the day's start."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What time it is (s since the day's start), and how it passes."""

    @property
    def waits(self) -> bool:
        """Whether time stands while an answer of the planner is due."""

    def now(self) -> float:
        """Return the time (s)."""

    def sleep(self, seconds: float) -> None:
        """Let time pass."""


class RealClock:
    """Seconds since ``epoch`` (s since 1970, the day's start), by this machine's clock.

    They never go back: where the machine's clock is set back, time stands until it has caught up.
    """

    waits = False
    """Whether time stands while an answer of the planner is due."""

    def __init__(self, epoch: float) -> None:
        self.epoch = epoch
        self._last = 0.0

    def now(self) -> float:
        """Return the time (s)."""
        self._last = max(self._last, time.time() - self.epoch)
        return self._last

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)


class SimulatedClock:
    """Time passes only by ``sleep``; at most ``speed`` times as fast as real time (0: as fast as
    it goes).
    """

    waits = True

    def __init__(self, now: float = 0.0, speed: float = 0.0) -> None:
        self._now, self._speed = now, speed
        self._since = time.monotonic()
        self._begun = now

    def now(self) -> float:
        """Return the time (s)."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self._now = round(self._now + seconds, 6)
        if self._speed:
            ahead = (self._now - self._begun) / self._speed - (time.monotonic() - self._since)
            if ahead > 0.0:
                time.sleep(ahead)
