"""Claims that rest on what was recognised, doubted: the plain model of a small problem, in which
nothing is, is asked for a schedule that cannot be if they hold.
"""

from __future__ import annotations

import math
import threading

from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import CandidateSchedule, Deadline, OutOfTimeError, UnsupportedError
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.solve.attempts import NO_PRESOLVE, Attempts, Orders
from up_samp.tuning import Tuning
from up_samp.upio.expressions import constraints_of
from up_samp.upio.objective import Number


def sooner(
    problem: SchedulingProblem,
    before: Number | None,
    deadline: Deadline,
    *,
    seed: int,
    tuning: Tuning,
) -> CandidateSchedule | None:
    """Return a schedule that costs less (ends before a time; ``None``: any schedule), if the plain
    model of a problem has one that is found with little effort. Large problems are not looked at.
    """
    said = sum(1 for _ in constraints_of(problem))
    if said > tuning.doubted or deadline.expired():
        return None
    try:
        model = ScheduleModel(problem, deadline=deadline, plain=True)
    except (OutOfTimeError, UnsupportedError):
        return None
    orders = Orders(seed, 1, False, tuning, threading.Event())
    attempts = Attempts(model, orders, deadline, None, left=NO_PRESOLVE)
    attempts.below(None if before is None else math.ceil(before * model.scale) - 1)
    return attempts.best


def refuted_by(bound: Number | None, schedule: CandidateSchedule) -> str:
    """Return in words what a schedule refutes: a lower bound, or that there is none (``None``)."""
    claim = "that there is no schedule" if bound is None else f"the lower bound {bound}"
    return refuted(
        f"{claim} rests on what was recognised in the problem",
        f"there is a schedule for less (it ends at {schedule.makespan})",
    )


def refuted(claim: str, because: str) -> str:
    """Return in words that a claim of ours was wrong."""
    return f"refuted: {claim}, but {because}; this is an error of up_samp's, please report it"
