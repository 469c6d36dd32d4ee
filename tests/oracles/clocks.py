"""Clocks of machines that others use as well."""

from collections.abc import Callable, Sequence
from random import Random


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
