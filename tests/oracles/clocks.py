"""Clocks of machines that others use as well."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

_STATES = Path("/proc/self/schedstat")


class JumpingClock:
    """A clock that some looks at it find a while later than it was: one look in ``every``.

    :param jumps: by so many seconds (one of these).
    :param base: the clock that it is otherwise; it stands still if there is none.
    """

    def __init__(
        self,
        rng: Random,
        every: int,
        jumps: Sequence[float],
        base: Callable[[], float] = lambda: 1000.0,
    ) -> None:
        self.rng, self.every, self.jumps, self.base = rng, every, jumps, base
        self.ahead = 0.0

    def monotonic(self) -> float:
        """Return seconds, as ``time.monotonic`` does."""
        if self.rng.random() < 1.0 / self.every:
            self.ahead += self.rng.choice(self.jumps)
        return self.base() + self.ahead


class Watch:
    """How long something takes, and how much of that the machine was busy with others; started when
    it is made.
    """

    def __init__(self) -> None:
        self._began, self._before = time.monotonic(), _waited()
        self._worked = time.process_time()

    @property
    def seconds(self) -> float:
        """Seconds of the clock since the start."""
        return time.monotonic() - self._began

    @property
    def waited(self) -> float:
        """Seconds in which the main thread could have run, but no processor was free (Linux)."""
        return _waited() - self._before

    @property
    def own(self) -> float:
        """Seconds that it would have taken had the main thread never waited for a processor."""
        return self.seconds - self.waited

    def late(self, limit: float) -> float:
        """Return by how many seconds of this process's work a limit was missed, at least."""
        return min(self.own - limit, time.process_time() - self._worked)


def _waited() -> float:
    try:
        return int(_STATES.read_text().split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0
