"""How much a search may work: counted, so that it ends the same on every machine."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model import Deadline


@dataclass
class WorkBudget:
    """Counted work, and a deadline that only aborts.

    ``effort``: the work after which to give up (None: no such limit). ``used``: the work done.
    ``cut``: whether one of both has ended a search that was not finished.
    """

    deadline: Deadline
    effort: int | None = None
    used: int = 0
    cut: bool = False

    def spent(self) -> bool:
        """Return whether to stop; call it only where there is still something to do."""
        over = self.effort is not None and self.used >= self.effort
        self.cut = self.cut or over or self.deadline.expired()
        return self.cut
