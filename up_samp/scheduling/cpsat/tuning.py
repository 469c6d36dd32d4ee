"""The tunables of the scheduler."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, share_of, tunable

EFFORT = "CP-SAT's deterministic time"


@dataclass(frozen=True)
class StagesTuning(Tunables):
    """The stages of one solve (``solve/strategy.py``): sizes, efforts and shares of the time."""

    tiny: int = tunable(
        2_000, "constraints", "up to so many, a search without presolve is tried first", least=0
    )
    small: int = tunable(
        20_000,
        "constraints",
        "up to so many, two full searches, one thread alone and quick proofs are tried: they must "
        "not cost large models their time",
        least=0,
    )
    without_presolve: float = tunable(
        0.005, EFFORT, "for a tiny problem: presolve costs more than the search", least=0
    )
    without_inprocessing: float = tunable(
        0.02,
        EFFORT,
        "for a tiny problem with a schedule near the bound in hand: half of so short a proof is "
        "inprocessing",
        least=0,
    )
    one_presolve_pass: float = tunable(
        0.3, EFFORT, "for a proof from a schedule near the bound in hand", least=0
    )
    two_searches: float = tunable(4.0, EFFORT, "for two full searches of a small problem", least=0)
    one_thread: tuple[float, ...] = tunable(
        (0.1, 0.4, 2.0), EFFORT, "the same with one thread, one attempt after the other", least=0
    )
    relaxed_proof: float = tunable(
        20.0, EFFORT, "for the routing relaxation, where the optimum is asked for", least=0
    )
    relaxed_content: float = tunable(
        0.4, EFFORT, "for the routing relaxation, where it is not", least=0
    )
    content: float = tunable(
        1.0, EFFORT, "for the whole problem, where no optimum is asked for", least=0
    )
    first_dive: float = tunable(0.5, EFFORT, "for the first dive under a loose cap", least=0)
    first: float = tunable(
        1.0,
        EFFORT,
        "for a first schedule under the tightest cap; more under each looser one",
        least=0,
    )
    first_growth: float = tunable(
        1.6, "factor", "how the effort for a first schedule grows with each looser cap", least=1
    )
    realize: float = tunable(
        1.0, EFFORT, "for a schedule of the whole from one of its relaxation, at each cap", least=0
    )
    realize_caps: tuple[float, ...] = tunable(
        (1.0, 1.1, 1.3, 1.7),
        "factor",
        "caps over the relaxation's makespan under which a schedule of the whole is sought",
        least=1,
    )
    tour_rounds: int = tunable(
        60, "rounds a task", "of annealing over tours before CP-SAT is asked", least=0
    )
    few_tasks: int = tunable(
        8,
        "tasks",
        "up to so many, the relaxation is solved sooner than tours are annealed",
        least=0,
    )
    bound_share: float = share_of(0.1, "of the time that is left, for bounds without search")
    tour_share: float = share_of(0.2, "of the time that is left, for tours")
    relaxed_share: float = share_of(
        0.35, "of the time that is left, for each attempt at the routing relaxation"
    )


@dataclass(frozen=True)
class CpsatTuning(Tunables):
    """All of the engine's tunables."""

    stages: StagesTuning = field(default_factory=StagesTuning)
