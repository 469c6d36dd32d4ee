"""The budget of a search: one deadline, what its parts may take of it, and what they took."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from up_samp.model import Deadline
from up_samp.search.tuning import BudgetTuning


@dataclass
class Budget:
    """``query_seconds``: limit (s) of one motion query now (the paper's t_p).

    ``seconds_motion`` and ``seconds_scheduler`` are what was spent so far.
    """

    deadline: Deadline
    query_seconds: float
    tuning: BudgetTuning = field(default_factory=BudgetTuning)
    seconds_motion: float = 0.0
    seconds_scheduler: float = 0.0
    _asking: bool = False

    def share(self, share: float, most: float) -> Deadline:
        """Return the deadline of a part: a share of what is left, at most so many seconds."""
        return self.deadline.within(min(most, share * self.deadline.remaining()))

    def query(self) -> Deadline:
        """Return the deadline of one motion query."""
        return self.deadline.within(self.query_seconds)

    def group(self, count: int) -> Deadline:
        """Return the deadline of one query for ``count`` motions together.

        No query may use up what is left: a late answer can still be repaired.
        """
        limit = self.query_seconds * max(1, count) ** 0.5
        return self.deadline.within(min(limit, self.tuning.group_share * self.deadline.remaining()))

    def double_queries(self) -> None:
        """Allow motion queries twice the time (line 19)."""
        self.query_seconds = min(2 * self.query_seconds, self.tuning.longest_query)

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
        started, self._asking = time.monotonic(), True
        try:
            yield
        finally:
            self.seconds_motion += time.monotonic() - started
            self._asking = False
