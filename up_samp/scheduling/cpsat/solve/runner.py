"""Runs CP-SAT under a deadline, with hints and bounds, interruptible."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ortools.sat.python import cp_model

from up_samp.model import Deadline
from up_samp.scheduling.cpsat.solve.options import IGNORED

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
    remaining = deadline.remaining()
    if math.isfinite(remaining) and deadline.work is None:
        parameters.max_time_in_seconds = max(0.0, remaining)
    if deadline.work is not None:
        # counted like all other work; the clock only ends it
        parameters.max_deterministic_time = min(parameters.max_deterministic_time, remaining)
        left = deadline.moment - time.monotonic()
        parameters.max_time_in_seconds = max(0.0, min(left, parameters.max_time_in_seconds))
    watch = _Watch(improved)
    outcome: dict[str, Any] = {}

    def work() -> None:
        try:
            outcome["status"] = solver.solve(model, watch)
        except BaseException as error:  # handed to the calling thread
            outcome["error"] = error

    _interruptible(work, solver, interrupted or threading.Event())
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
) -> None:
    """Run ``work`` in a thread, so that signals reach this one at once.

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
            if interrupted.is_set():
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
