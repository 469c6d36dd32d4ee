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

ROPKE = "Ropke and Pisinger (2006), doubled: there are fewer tries here"


@dataclass(frozen=True)
class ProofTuning(Tunables):
    """How long reasons are sought (``search/proof.py``)."""

    explain_seconds: float = tunable(5.0, "s", "at most, for a shorter reason", least=0)


@dataclass(frozen=True)
class RepairTuning(Tunables):
    """Plans made of candidates whose motions do not fit (``search/resolve.py``)."""

    steps: int = tunable(25, "steps", "of scheduling anew and driving", least=0)
    enough: int = tunable(
        10, "units", "a place that was left longer before is not what makes a motion late", least=0
    )
    effort: float = effort_of(0.4, "for one step: a few seconds at most")


@dataclass(frozen=True)
class TurnsTuning(Tunables):
    """Motions one after another where there is no plan yet (``search/resolve.py``)."""

    steps: int = tunable(12, "steps", "of scheduling anew and driving", least=0)
    effort: float = effort_of(0.3, "for one step: a few seconds at most")
    share: float = share_of(0.25, "of the remaining time, for one candidate")


@dataclass(frozen=True)
class SlackTuning(Tunables):
    """More time for motions than they need alone (``search/resolve.py``)."""

    units: tuple[int, ...] = tunable(
        (1, 3, 6),
        "units",
        "more than scheduled that are worth having; each counts once for each motion",
        least=1,
    )
    effort: float = effort_of(0.06, "well below a second")


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
    reaction: float = share_of(
        0.2, "of a neighbourhood's weight, that its last try decides", source=ROPKE
    )
    least_weight: float = share_of(0.1, "of the weight at first, that every neighbourhood keeps")
    nearly: float = share_of(
        0.3, "of a better plan's worth, of a better schedule whose motions did not fit"
    )


@dataclass(frozen=True)
class TidyTuning(Tunables):
    """Needless motions left out in the end (``search/resolve.py``)."""

    steps: int = tunable(8, "steps", "of leaving out and driving", least=0)
    effort: float = effort_of(0.2, "for one step: a few seconds at most")
    lean: float = effort_of(
        2.0, "for another engine's candidate: some seconds; checking it takes longer"
    )


@dataclass(frozen=True)
class StartTuning(Tunables):
    """A search that begins from a plan (``search/resolve.py``)."""

    effort: float = effort_of(0.1, "for one schedule: about a second at most")
    rounds: int = tunable(
        5, "schedules", "that are tried, each with what was learned from those before", least=0
    )


@dataclass(frozen=True)
class SearchTuning(Tunables):
    """All tunables of the search."""

    proof: ProofTuning = field(default_factory=ProofTuning)
    repair: RepairTuning = field(default_factory=RepairTuning)
    turns: TurnsTuning = field(default_factory=TurnsTuning)
    in_order: InOrderTuning = field(default_factory=InOrderTuning)
    tours: ToursTuning = field(default_factory=ToursTuning)
    deals: DealsTuning = field(default_factory=DealsTuning)
    large: LargeTuning = field(default_factory=LargeTuning)
    start: StartTuning = field(default_factory=StartTuning)
    slack: SlackTuning = field(default_factory=SlackTuning)
    neighbourhoods: NeighbourhoodsTuning = field(default_factory=NeighbourhoodsTuning)
    tidy: TidyTuning = field(default_factory=TidyTuning)
