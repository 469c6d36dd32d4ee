"""Runs CP-SAT under a deadline, with hints and bounds, interruptible; and the profiles under which
it is run: its options at each stage of a solve.

How long each stage may take stands beside its use: :mod:`.attempts`, :mod:`.strategy`.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ortools.sat.python import cp_model

from up_samp.model import Deadline

# ------------------ Profiles


Profile = dict[str, Any]

_LIGHT = {"cp_model_probing_level": 0, "symmetry_level": 0}
NO_LINEARIZATION: Profile = {**_LIGHT, "linearization_level": 0}
FIXED_SEARCH: Profile = {
    **NO_LINEARIZATION,
    "search_branching": cp_model.FIXED_SEARCH,
    "num_workers": 1,
}
DIVE: Profile = {**FIXED_SEARCH, "max_number_of_conflicts": 30}
"""A dive that leads somewhere has few conflicts; many take far longer than CP-SAT counts."""
LINEARIZATION: Profile = {**_LIGHT, "linearization_level": 1}
# No interleave_search: with several workers it aborts the process ("heuristics.fixed_search"). No
# use_dynamic_precedence_in_disjunctive, which makes shops quicker: it does so, too ("adding
# conflicting constraint at positive level").
CP_SATS_OWN: Profile = {}

IGNORED = ("ls*", "fj*")
"""Never run: CP-SAT's local search over violations and its feasibility jump write beyond their
memory (OR-Tools 9.15). Of 180 runs of a job shop's routing relaxation with two workers and ``ls``,
ten ended the process ("free(): invalid next size"); of 120 without it, none. With ``fj``, small
relaxations without a solution do: benchmarks/reliability/memory.py shows it, and whether a newer
OR-Tools is any better.
"""

NO_PRESOLVE: Profile = {
    **NO_LINEARIZATION,
    "num_workers": 1,
    "cp_model_presolve": False,
    "use_objective_lb_search": True,
}
"""For small problems, where presolve costs more than the search."""
NO_INPROCESSING: Profile = {**NO_PRESOLVE, "use_sat_inprocessing": False}
"""The same with a schedule near the bound in hand: half of so short a proof is inprocessing."""
ONE_PRESOLVE_PASS: Profile = {
    **NO_LINEARIZATION,
    "num_workers": 1,
    "max_presolve_iterations": 1,
}
"""For the whole problem with a schedule near the bound in hand: what presolve and a relaxation cost
is more than such a proof mostly takes."""
TWO_FULL_SEARCHES: Profile = {
    "subsolvers": ("no_lp", "default_lp"),
    "num_full_subsolvers": 2,
}
"""Two full searches that share what they learn: one without a linear relaxation, which proves most
shops, and one with it, which decides where loads do. CP-SAT's own choice for two workers is one
full search and local search beside it, which does not prove ft10 in 20 s."""
ONE_THREAD: tuple[Profile, ...] = (
    {"num_workers": 1, "linearization_level": 0},
    {"num_workers": 1, "linearization_level": 1},
)
"""The same with one thread: by turns, each starting from what the last one found."""


# ------------------ One run


Improved = Callable[[list[int], float], None]
"""Called with the values of a better solution, by CP-SAT's indices, and the bound."""


@dataclass(frozen=True)
class SolverAnswer:
    """What CP-SAT said. ``values`` are those of the last solution, by CP-SAT's indices."""

    status: int
    values: list[int] | None
    bound: float
    effort: float = 0.0
    """Deterministic time that it took."""


class _Watch(cp_model.CpSolverSolutionCallback):
    def __init__(self, improved: Improved) -> None:
        super().__init__()
        self._improved = improved
        self.error: BaseException | None = None

    def on_solution_callback(self) -> None:
        try:
            self._improved(list(self.response_proto.solution), self.best_objective_bound)
        except BaseException as error:  # raised again by the caller, outside C++
            self.error = error
            self.stop_search()


def run(
    model: cp_model.CpModel,
    deadline: Deadline,
    improved: Improved,
    *,
    interrupted: threading.Event | None = None,
    options: dict[str, Any] | None = None,
) -> SolverAnswer:
    """Solve ``model``, with ``options`` of CP-SAT. Ctrl-C stops the solver and is raised."""
    solver = cp_model.CpSolver()
    parameters = solver.parameters
    parameters.catch_sigint_signal = False
    parameters.ignore_subsolvers.extend(IGNORED)
    for name, value in (options or {}).items():
        if isinstance(value, tuple):
            getattr(parameters, name).extend(value)
        else:
            setattr(parameters, name, value)
    if deadline.work is not None:
        # counted like all other work; the clock only ends it
        parameters.max_deterministic_time = min(
            parameters.max_deterministic_time, deadline.remaining()
        )
    left = deadline.moment - time.monotonic()
    parameters.max_time_in_seconds = max(0.0, min(left, parameters.max_time_in_seconds))
    watch = _Watch(improved)
    outcome: dict[str, Any] = {}

    def work() -> None:
        try:
            outcome["status"] = solver.solve(model, watch)
        except BaseException as error:  # handed to the calling thread
            outcome["error"] = error

    _interruptible(work, solver, interrupted or threading.Event(), deadline)
    error = outcome.get("error") or watch.error
    if error is not None:
        raise error
    status = outcome["status"]
    deadline.spend(solver.response_proto.deterministic_time)
    solution = list(solver.response_proto.solution)
    known = status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    return SolverAnswer(
        status,
        solution if known else None,
        solver.best_objective_bound,
        solver.response_proto.deterministic_time,
    )


def _interruptible(
    work: Callable[[], None],
    solver: Any,
    interrupted: threading.Event,
    deadline: Deadline = Deadline.never(),
) -> None:
    """Run ``work`` in a thread, so that signals reach this one at once; stop the solver when it is
    interrupted, or its time is over by a clock that it does not know.

    The thread is over when this returns or raises: one that goes on when Python ends aborts the
    process. Ctrl-C may come at any instant, also while the thread starts.
    """
    cancelled = threading.Event()

    def unless_cancelled() -> None:
        if not cancelled.is_set():
            work()

    thread = threading.Thread(target=unless_cancelled, daemon=True)
    try:
        thread.start()
        while thread.is_alive():
            thread.join(0.1)
            if interrupted.is_set() or deadline.over():
                solver.stop_search()
    except BaseException:
        cancelled.set()
        _end(thread, solver)
        raise


def _end(thread: threading.Thread, solver: Any) -> None:
    while thread.is_alive():
        # a second Ctrl-C asks for what is under way
        with contextlib.suppress(KeyboardInterrupt):
            solver.stop_search()
            thread.join(0.05)
