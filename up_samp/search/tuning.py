"""The tunables of the search's components."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, effort_of, share_of, tunable
from up_samp.search.fleet.tuning import (
    DealsTuning,
    InOrderTuning,
    LargeTuning,
    RoundsTuning,
    ToursTuning,
)

ROPKE = "Ropke and Pisinger (2006), doubled: there are fewer tries here"


@dataclass(frozen=True)
class BudgetTuning(Tunables):
    """What parts of a search may take of its time (``search/budget.py``)."""

    group_share: float = share_of(0.2, "of the remaining time, for one group of motions")
    longest_query: float = tunable(
        3600.0, "s", "limit of one motion query, however often it was doubled", least=0
    )
    patience: float = tunable(
        1.0, "s", "to go on at least without a better plan, where patience ends a search", least=0
    )


@dataclass(frozen=True)
class PaceTuning(Tunables):
    """How long our own scheduler may take for an answer (``search/budget.py``)."""

    first_proof: float = tunable(
        15.0,
        "s",
        "for the first attempt at a proof, once there is a plan; doubled after it",
        least=0,
    )
    schedule_share: float = share_of(
        0.4,
        "of the remaining time, for a schedule until there is a plan: schedules get better with "
        "time, but their motions have to be checked, too",
    )


@dataclass(frozen=True)
class RestartTuning(Tunables):
    """How often a search begins anew (``search/budget.py``)."""

    untimed: int = tunable(3, "restarts", "where there is no time limit", least=0)
    stale: int = tunable(
        8,
        "restarts",
        "in a row that may bring nothing but guesses made before, from other random numbers",
        least=0,
    )


@dataclass(frozen=True)
class ProofTuning(Tunables):
    """How long proofs and reasons are sought (``search/proof.py``)."""

    share: float = share_of(0.3, "of the remaining time, for one attempt at a proof")
    seconds: float = tunable(20.0, "s", "at most, for one attempt at a proof", least=0)
    explain_share: float = share_of(0.2, "of the remaining time, for a shorter reason")
    explain_seconds: float = tunable(5.0, "s", "at most, for a shorter reason", least=0)
    limits: int = tunable(
        40,
        "constraints",
        "of the problem that are looked at to tell what the facts run into",
        least=0,
    )
    demands: int = tunable(
        300,
        "demands",
        "of the problem that are looked at where no motion is to blame",
        least=0,
    )
    rarer: int = tunable(
        3,
        "times",
        "as many rounds of another engine until it is asked again whether anything is left",
        least=1,
    )
    doubt_seconds: float = tunable(2.0, "s", "at most, for doubting it", least=0)


@dataclass(frozen=True)
class DurationsTuning(Tunables):
    """Durations known before the first schedule (``search/statements/durations.py``)."""

    share: float = share_of(0.2, "of the remaining time, for all of them")
    seconds: float = tunable(30.0, "s", "at most, for all of them", least=0)
    query: float = tunable(
        2.0, "s", "for one motion; what takes longer may never be needed", least=0
    )
    probe: int = tunable(30, "motions", "after which is told whether all can be asked for", least=1)
    hopeless: float = tunable(
        4.0,
        "factor",
        "where all would take so many times the time that there is, the others are left to be "
        "learned when a candidate uses them: most never are",
        least=0,
    )
    cases: int = tunable(
        128, "cases", "of one motion's decisions that are looked at before any schedule", least=1
    )


@dataclass(frozen=True)
class HandoversTuning(Tunables):
    """Gaps at shared places (``search/statements/handovers.py``)."""

    pairs: int = tunable(
        1500, "pairs of motions", "that are stated at once at most; others when they meet", least=0
    )
    share: float = share_of(
        0.1,
        "of the remaining time, for gaps between fastest motions: all, or one late one's",
    )
    seconds: float = tunable(6.0, "s", "at most, for these gaps", least=0)


@dataclass(frozen=True)
class CutsTuning(Tunables):
    """What is asked to learn from a failed check (``search/cuts/``)."""

    profile_share: float = share_of(
        0.05, "of the remaining time, for one late motion's interaction profile"
    )
    profile_seconds: float = tunable(6.0, "s", "at most, for one profile", least=0)
    explore_share: float = share_of(
        0.2,
        "of a query's time, for which the paper's tree grows on to tell what it reaches",
    )


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

    budget: BudgetTuning = field(default_factory=BudgetTuning)
    pace: PaceTuning = field(default_factory=PaceTuning)
    restarts: RestartTuning = field(default_factory=RestartTuning)
    proof: ProofTuning = field(default_factory=ProofTuning)
    durations: DurationsTuning = field(default_factory=DurationsTuning)
    handovers: HandoversTuning = field(default_factory=HandoversTuning)
    cuts: CutsTuning = field(default_factory=CutsTuning)
    repair: RepairTuning = field(default_factory=RepairTuning)
    turns: TurnsTuning = field(default_factory=TurnsTuning)
    in_order: InOrderTuning = field(default_factory=InOrderTuning)
    tours: ToursTuning = field(default_factory=ToursTuning)
    deals: DealsTuning = field(default_factory=DealsTuning)
    large: LargeTuning = field(default_factory=LargeTuning)
    rounds: RoundsTuning = field(default_factory=RoundsTuning)
    start: StartTuning = field(default_factory=StartTuning)
    slack: SlackTuning = field(default_factory=SlackTuning)
    neighbourhoods: NeighbourhoodsTuning = field(default_factory=NeighbourhoodsTuning)
    tidy: TidyTuning = field(default_factory=TidyTuning)
