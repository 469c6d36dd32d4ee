"""The tunables of the scheduler."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model.tunable import Tunables, effort_of, tunable


@dataclass(frozen=True)
class CpsatTuning(Tunables):
    """The stages of one solve (``scheduling/cpsat/solve/strategy.py``) and lower bounds without
    search (``scheduling/cpsat/routing/workload.py``): sizes, efforts.
    """

    tiny: int = tunable(
        2_000, "constraints", "up to so many, a search without presolve is tried first", least=0
    )
    relaxed_content: float = effort_of(
        0.4, "for the routing relaxation, where no optimum is asked for"
    )
    tour_rounds: int = tunable(
        60, "rounds a task", "of annealing over tours before CP-SAT is asked", least=0
    )
    doubted: int = tunable(
        150,
        "constraints",
        "of the problem as it is written, up to which claims that rest on what was recognised are "
        "doubted: the plain model is asked for a schedule that cannot be",
        least=0,
    )
    labels: int = tunable(
        4_000_000,
        "labels",
        "beginnings of sequences of tasks that proofs may look at, where the optimum is asked for "
        "(some 10 microseconds each)",
        least=0,
    )
