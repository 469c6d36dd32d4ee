"""How long the scheduler may take for its next answer, and what it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from up_samp.model import Deadline
from up_samp.search.budget import Budget
from up_samp.search.tuning import PaceTuning


class Pace(Protocol):
    """When the scheduler has to answer. ``planned``: there is a plan already."""

    @property
    def staged(self) -> bool:
        """Whether a first plan is sought before any proof."""
        ...

    def deadline(self, budget: Budget, *, planned: bool, proving: bool) -> Deadline:
        """Return by when it has to answer."""
        ...

    def more(self, *, planned: bool) -> bool:
        """Give the scheduler more time after an answer that came too late; return whether it gets
        any.
        """
        ...


@dataclass(frozen=True)
class AtOnce:
    """All of the time for each answer: another's scheduler would begin anew after a limit."""

    staged: bool = False

    def deadline(self, budget: Budget, *, planned: bool, proving: bool) -> Deadline:
        """Return the search's deadline."""
        return budget.deadline

    def more(self, *, planned: bool) -> bool:
        """Say that there is no more time to be had."""
        return False


@dataclass
class Staged:
    """A first plan before any proof, then proofs with more and more time: for a scheduler that goes
    on from what it knows.
    """

    proof_seconds: float = PaceTuning.first_proof
    """Limit (s) of the next attempt at a proof."""
    share: float = PaceTuning.schedule_share
    """Share for the next schedule; all of the time once a share was not enough for any."""
    staged: bool = True

    def deadline(self, budget: Budget, *, planned: bool, proving: bool) -> Deadline:
        """Return by when the scheduler has to answer."""
        if proving:
            return budget.deadline.within(self.proof_seconds)
        if not planned:
            return budget.deadline.within(self.share * budget.deadline.remaining())
        return budget.deadline

    def more(self, *, planned: bool) -> bool:
        """Double the time for proofs, or give all of it for the first schedule."""
        if not planned and self.share >= 1:
            return False
        if planned:
            self.proof_seconds *= 2
        else:
            self.share = 1.0
        return True
