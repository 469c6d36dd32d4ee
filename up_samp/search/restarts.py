"""Restarts without what was only guessed, from other random numbers (lines 17 to 20)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from up_samp.model.refinement import Refinement
from up_samp.search.budget import Budget
from up_samp.search.tuning import RestartTuning


@dataclass
class Restarts:
    """``limit``: so many at most (None: without a plan as long as there is time, with one as long
    as they bring anything new).

    ``stale``: how many in a row guessed nothing new.
    """

    limit: int | None = None
    tuning: RestartTuning = field(default_factory=RestartTuning)
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
            return self.done < self.tuning.untimed
        return not planned or self.stale < self.tuning.stale

    def begin(self, guesses: Sequence[Refinement]) -> None:
        """Count a restart that drops these guesses."""
        known = frozenset(r.statement for r in guesses)
        self.done += 1
        self.stale = self.stale + 1 if known in self._before else 0
        self._before.add(known)
