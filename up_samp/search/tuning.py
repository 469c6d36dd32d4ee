"""The tunables of the search: of problems that are solved in parts (``search/fleet``)."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model.tunable import Tunables, share_of, tunable


@dataclass(frozen=True)
class SearchTuning(Tunables):
    """Large problems (``search/fleet/solve.py``): from which size on, and how hard who does what
    and whole tours are sought.
    """

    large: int = tunable(
        240, "optional activities", "from which on jobs are dealt out first", least=1
    )
    deals: int = tunable(8, "shares of the jobs", "at most, until there is a plan", least=1)
    exchanges: int = tunable(2000, "changes a job", "of annealing over who does what", least=0)
    cold: float = share_of(0.0003, "of all cost, by which a change may be worse in the end")
    rounds: int = tunable(
        16, "rounds", "in which all tours are decided in the order of time", least=0
    )
    stale: int = tunable(1_000, "changes", "of tours in a row that may bring nothing", least=1)
