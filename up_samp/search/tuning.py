"""The tunables of the search's components."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, effort_of, tunable
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
class SearchTuning(Tunables):
    """All tunables of the search."""

    proof: ProofTuning = field(default_factory=ProofTuning)
    repair: RepairTuning = field(default_factory=RepairTuning)
    in_order: InOrderTuning = field(default_factory=InOrderTuning)
    tours: ToursTuning = field(default_factory=ToursTuning)
    deals: DealsTuning = field(default_factory=DealsTuning)
    large: LargeTuning = field(default_factory=LargeTuning)
