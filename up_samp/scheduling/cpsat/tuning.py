"""The tunables of the scheduler."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, effort_of, share_of, tunable


@dataclass(frozen=True)
class StagesTuning(Tunables):
    """The stages of one solve (``scheduling/cpsat/solve/strategy.py``): sizes, efforts,
    shares of the time.
    """

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
    without_presolve: float = effort_of(
        0.005, "for a tiny problem: presolve costs more than the search"
    )
    without_inprocessing: float = effort_of(
        0.02,
        "for a tiny problem with a schedule near the bound in hand: half of so short a proof is "
        "inprocessing",
    )
    one_presolve_pass: float = effort_of(0.3, "for a proof from a schedule near the bound in hand")
    two_searches: float = effort_of(4.0, "for two full searches of a small problem")
    one_thread: tuple[float, ...] = effort_of(
        (0.1, 0.4, 2.0), "the same with one thread, one attempt after the other"
    )
    relaxed_proof: float = effort_of(
        20.0, "for the routing relaxation, where the optimum is asked for"
    )
    relaxed_content: float = effort_of(0.4, "for the routing relaxation, where it is not")
    relaxed_size: int = tunable(
        50_000,
        "constraints",
        "of the whole, up to which the routing relaxation is solved where the optimum is not asked "
        "for and some schedule is at hand",
        least=0,
    )
    content: float = effort_of(1.0, "for the whole problem, where no optimum is asked for")
    first_dive: float = effort_of(0.5, "for the first dive under a loose cap")
    first: float = effort_of(
        1.0, "for a first schedule under the tightest cap; more under each looser one"
    )
    first_growth: float = tunable(
        1.6, "factor", "how the effort for a first schedule grows with each looser cap", least=1
    )
    realize: float = effort_of(
        1.0, "for a schedule of the whole from one of its relaxation, at each cap"
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
    bound_share: float = share_of(0.35, "of the time that is left, for bounds without search")
    beam: int = tunable(
        500,
        "labels",
        "beginnings of each length among which sequences of tasks are sought that end before the "
        "schedule in hand, where the optimum is asked for",
        least=1,
    )
    beam_content: int = tunable(100, "labels", "the same where it is not", least=1)
    tour_share: float = share_of(0.2, "of the time that is left, for tours")
    relaxed_share: float = share_of(
        0.35, "of the time that is left, for each attempt at the routing relaxation"
    )
    doubted: int = tunable(
        150,
        "constraints",
        "of the problem as it is written, up to which claims that rest on what was recognised are "
        "doubted: the plain model is asked for a schedule that cannot be",
        least=0,
    )


@dataclass(frozen=True)
class BoundsTuning(Tunables):
    """Lower bounds without search (``scheduling/cpsat/routing/workload.py``): how much of what is
    looked at.
    """

    states: int = tunable(
        2_000_000,
        "states",
        "of the dynamic programme over sets of tasks; with more of them it is only asked who does "
        "what",
        least=1,
    )
    labels: int = tunable(
        4_000_000,
        "labels",
        "beginnings of sequences of tasks that proofs may look at, where the optimum is asked for "
        "(some 10 microseconds each)",
        least=0,
    )
    labels_again: int = tunable(
        150_000,
        "labels",
        "the same when bounds were sought before, and more is stated now",
        least=0,
    )
    unaided: int = tunable(
        100_000,
        "labels",
        "beginnings of sequences that are looked at before it is found out how long what is left "
        "takes at least",
        least=0,
    )
    steep: float = tunable(
        4.0, "factor", "how many times as many labels the next proof may cost", least=1
    )
    cheap: int = tunable(2_000, "labels", "up to so many, a proof costs next to nothing", least=1)
    kept: int = tunable(
        4, "sequences", "that a bound is met by, and that are made schedules", least=1
    )
    near: int = tunable(
        24, "labels", "before each one in order, which it is compared with for dominance", least=1
    )
    near_rounds: int = tunable(
        6, "rounds", "of these comparisons, as long as labels fall away", least=1
    )
    sets: int = tunable(
        20_000, "sets of tasks", "that one proof over who does what may look at", least=1
    )
    cover: float = effort_of(0.5, "for one proof over who does what")


@dataclass(frozen=True)
class CpsatTuning(Tunables):
    """All of the engine's tunables."""

    stages: StagesTuning = field(default_factory=StagesTuning)
    bounds: BoundsTuning = field(default_factory=BoundsTuning)
