"""Another engine is handed over what our own scheduler drew: a thinned problem, then wider ones."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Any

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    ScheduleReport,
    ScheduleStatus,
    UnsupportedError,
)
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.engine_scheduler import EngineScheduler
from up_samp.tuning import Tuning
from up_samp.upio import Relaxation
from up_samp.upio.objective import only_makespan
from up_samp.upio.restrict import parts_for_engines, restrict

_DRAWING = 0.6
"""Of the time for an answer, for drawing; the rest is the engine's."""
_EFFORT = 2.0
"""For letting what the engine scheduled end as soon as it can (CP-SAT's deterministic time)."""


class ThinnedScheduler(CpsatSession):
    """Our own scheduler decides who does what on which ways, and gives the bounds; the ``engine``
    schedules that. Engines that are lost among all that might be done schedule what is left of it
    in seconds.

    Where the engine finds no schedule of what was drawn, it is handed over more: all moves, and
    then the whole. What it runs out of time with has no larger part that takes less. Bounds come
    from the whole problem alone: that a part leaves nothing, or nothing sooner, says nothing of it.
    """

    def __init__(
        self,
        engine: EngineScheduler,
        relaxation: Relaxation,
        *,
        seed: int = 0,
        tuning: Tuning = Tuning(),
    ) -> None:
        super().__init__(relaxation.problem, seed=seed, tuning=tuning)
        self.engine, self.relaxation = engine, relaxation

    def close(self) -> None:
        """End the engine's process."""
        self.engine.close()

    def solve(self, deadline: Deadline, *, optimal: bool = True, **others: Any) -> ScheduleReport:
        """Draw a schedule (see the base class), and return the engine's with the same decisions.

        ``optimal``: the hint is the best plan's; a draw that ends no sooner is not handed over.
        """
        drawing = deadline.share(_DRAWING)
        try:
            drawn = super().solve(drawing, optimal=optimal, **others)
        except UnsupportedError:  # the engine may do what ours does not
            return self._hand_over(ScheduleReport(ScheduleStatus.FOUND), None, deadline)
        if drawn.schedule is None:
            return drawn
        hint = others.get("hint")
        known = optimal and only_makespan(self.problem)
        if known and hint is not None and drawn.schedule.makespan >= hint.makespan:
            return drawn
        return self._hand_over(drawn, drawn.schedule, deadline)

    def _hand_over(
        self, drawn: ScheduleReport, schedule: CandidateSchedule | None, deadline: Deadline
    ) -> ScheduleReport:
        """Return what the engine makes of a draw (of all there is, if there is none)."""
        started, answer = deadline.elapsed(), ScheduleReport(ScheduleStatus.OUT_OF_TIME)
        told: list[str] = []
        for what, part in parts_for_engines(self.relaxation, schedule):
            try:
                answer = self.engine.solve(deadline, optimal=False, part=part)
            except UnsupportedError as error:
                if not told:
                    raise
                answer = ScheduleReport(ScheduleStatus.ERROR, message=str(error))
            told.append(f"{what}: {answer.status.value} in {answer.seconds:.1f} s")
            if answer.schedule is not None or answer.status is ScheduleStatus.OUT_OF_TIME:
                break
        handed = replace(drawn, schedule=None, handed_over=tuple(told), cost=None)
        if answer.schedule is not None:
            handed = replace(handed, schedule=self._soon(answer.schedule, deadline))
        else:
            none = answer.status is ScheduleStatus.INFEASIBLE
            status = ScheduleStatus.NOT_FOUND if none else answer.status
            handed = replace(handed, status=status, message=answer.message)
        return replace(handed, seconds=drawn.seconds + deadline.elapsed() - started)

    def _soon(self, schedule: CandidateSchedule, deadline: Deadline) -> CandidateSchedule:
        """Return a schedule with the same decisions that heeds what the engine was not told, as
        soon as these can end (no worse than found in little time).
        """
        problem = restrict(self.relaxation, schedule)
        session = CpsatSession(
            problem, seed=self.seed, workers=1, effort=_EFFORT, tuning=self.tuning, plain=self.plain
        )
        with contextlib.suppress(UnsupportedError):
            found = session.solve(deadline, hint=schedule).schedule
            if found is not None:
                return replace(found, parameters={**schedule.parameters, **found.parameters})
        return schedule
