"""The tunables of the search's components."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, effort_of, share_of, tunable
from up_samp.search.fleet.tuning import (
    DealsTuning,
    InOrderTuning,
    LargeTuning,
    ToursTuning,
)


@dataclass(frozen=True)
class ProofTuning(Tunables):
    """How long reasons are sought (``search/proof.py``)."""

    explain_seconds: float = tunable(5.0, "s", "at most, for a shorter reason", least=0)


@dataclass(frozen=True)
class RepairTuning(Tunables):
    """Plans made of candidates whose motions do not fit (``search/resolve.py``)."""

    steps: int = tunable(25, "steps", "of scheduling anew and driving", least=0)
    effort: float = effort_of(0.4, "for one step: a few seconds at most")


@dataclass(frozen=True)
class NeighbourhoodsTuning(Tunables):
    """Parts of a plan decided anew (``search/neighbourhoods/``)."""

    share: float = share_of(0.5, "of the remaining time, for neighbourhoods in a row")
    first_share: float = share_of(
        0.9, "of the remaining time, where they come before the first attempt at a proof"
    )
    effort: float = effort_of(0.5, "for one neighbourhood: a few seconds at most")
    activities: int = tunable(
        300,
        "optional activities",
        "from which on neighbourhoods come before the first attempt at a proof",
        least=0,
    )
    together: int = tunable(
        4, "neighbourhoods", "that are drawn at a time: workers search them at once", least=1
    )
    robots: int = tunable(3, "robots", "that are freed at first", least=1)
    growth: float = tunable(
        0.2,
        "robots",
        "more that are freed after a neighbourhood was searched wholly and brought nothing; twice "
        "as many less after one whose search was cut short",
        least=0,
    )
    stale: int = tunable(60, "neighbourhoods", "in a row that may bring no better plan", least=1)
    reaction: float = share_of(0.2, "of a neighbourhood's weight, that its last try decides")
    least_weight: float = share_of(0.1, "of the weight at first, that every neighbourhood keeps")
    nearly: float = share_of(
        0.3, "of a better plan's worth, of a better schedule whose motions did not fit"
    )


@dataclass(frozen=True)
class SearchTuning(Tunables):
    """All tunables of the search."""

    proof: ProofTuning = field(default_factory=ProofTuning)
    repair: RepairTuning = field(default_factory=RepairTuning)
    in_order: InOrderTuning = field(default_factory=InOrderTuning)
    tours: ToursTuning = field(default_factory=ToursTuning)
    deals: DealsTuning = field(default_factory=DealsTuning)
    large: LargeTuning = field(default_factory=LargeTuning)
    neighbourhoods: NeighbourhoodsTuning = field(default_factory=NeighbourhoodsTuning)
