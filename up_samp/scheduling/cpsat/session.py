"""One problem, solved again and again while constraints are added to it."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable

from ortools.sat.python import cp_model
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import CandidateSchedule, Deadline, ScheduleReport, ScheduleStatus
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.problem import Watcher
from up_samp.scheduling.cpsat.solving import Answer, Run, run
from up_samp.scheduling.cpsat.store import Lin

Progress = Callable[[CandidateSchedule, "int | None"], None]
"""Called with each better schedule and the best proven lower bound on the makespan so far."""

PATIENCE = 0.3
"""Seconds without a better schedule after which a satisficing solve is content."""


class CpsatSession:
    """A persistent CP-SAT model of a scheduling problem.

    Each :meth:`solve` first picks up what was appended to ``problem`` since the last one:
    constraints, conditions, activities, narrower durations go into the model as it is; anything else
    makes a new model. The last schedule is the hint, and the lower bound is carried over as
    long as things were only appended.

    :param problem: watched, never changed.
    :param seed: for CP-SAT; with ``workers=1`` answers are deterministic.
    :param workers: threads of CP-SAT (``None``: one per core).
    """

    def __init__(
        self, problem: SchedulingProblem, *, seed: int = 0, workers: int | None = None
    ) -> None:
        self.problem = problem
        self.settings = Run(seed, workers or os.cpu_count() or 1)
        self.bound = 0
        self.rebuilds = 0
        self._watcher = Watcher(problem)
        self._model: ScheduleModel | None = None
        self._last: list[int] | None = None
        self._last_schedule: CandidateSchedule | None = None
        self._stated_bound = 0
        self._interrupted = threading.Event()

    @property
    def minimizes_makespan(self) -> bool:
        """Whether the problem asks for the shortest schedule."""
        return any(m.is_minimize_makespan() for m in self.problem.quality_metrics)

    def close(self) -> None:
        """Do nothing: a session keeps no processes."""

    def solve(
        self,
        deadline: Deadline,
        *,
        optimal: bool = True,
        hint: CandidateSchedule | None = None,
        lower_bound: int | None = None,
        on_solution: Progress | None = None,
    ) -> ScheduleReport:
        """Solve the problem as it is now.

        :param deadline: kept to within a fraction of a second, once the model is built.
        :param optimal: search to the proven optimum of the metric; otherwise return a first good
            schedule. Without a metric there is no optimum, and a good schedule is returned.
        :param hint: a schedule to start from (default: the last one).
        :param lower_bound: a proven lower bound on the makespan.
        :param on_solution: told of each better schedule.
        """
        started = deadline.elapsed()
        model = self._update()
        if lower_bound is not None:
            self.bound = max(self.bound, lower_bound)
        self._state_bound(model)
        self._hint(model, hint)
        self._set_objective(model)
        wants_optimum = optimal and bool(self.problem.quality_metrics)

        def improved(values: list[int], objective: float, bound: float) -> bool:
            if on_solution is not None:
                if model.objective is None:
                    self._learn(bound)
                schedule = model.schedule(self._lookup(model, values))
                on_solution(schedule, self.bound or None)
            return False

        if deadline.expired():
            return ScheduleReport(ScheduleStatus.OUT_OF_TIME, bound=self.bound or None)
        patience = None if wants_optimum else PATIENCE
        answer = run(
            model.store.model,
            self.settings,
            deadline,
            improved,
            patience=patience,
            interrupted=self._interrupted,
        )
        return self._report(model, answer, wants_optimum, deadline, started)

    def interrupt(self) -> None:
        """Stop a :meth:`solve` that runs in another thread."""
        self._interrupted.set()

    # -- stages --------------------------------------------------------------------------------
    def _update(self) -> ScheduleModel:
        parts = self._watcher.look()
        if parts.rewritten:
            self.bound = 0
        if self._model is not None and self._model.can_grow(parts):
            self._model.grow(parts)
            return self._model
        self.rebuilds += 1
        self._last = None
        self._stated_bound = 0
        model = ScheduleModel(self.problem)
        self._model = None
        model.build(Watcher(self.problem).look())
        self._model = model
        return model

    def _state_bound(self, model: ScheduleModel) -> None:
        if self.bound > self._stated_bound:
            self._stated_bound = self.bound
            makespan = Lin(((model.world.makespan, 1),))
            model.store.enforce(Lin((), self.bound).le(makespan))

    def _hint(self, model: ScheduleModel, hint: CandidateSchedule | None) -> None:
        values: dict[int, int] = {}
        last = self._last
        if last is not None:
            for var, position in model.store.positions():
                if var and position < len(last):
                    values[var] = last[position]
        chosen = hint if hint is not None else self._last_schedule
        if chosen is not None and (last is None or chosen != self._last_schedule):
            values.update(model.hint_values(chosen))
        model.store.hint(values)

    def _set_objective(self, model: ScheduleModel) -> None:
        objective = model.objective or Lin(((model.world.makespan, 1),))
        model.store.model.minimize(model.store.expression(objective))

    @staticmethod
    def _lookup(model: ScheduleModel, values: list[int]) -> Callable[[int], int]:
        def value(var: int) -> int:
            return values[model.store.position(var)]

        return value

    def _learn(self, bound: float) -> None:
        if math.isfinite(bound):
            self.bound = max(self.bound, math.ceil(bound - 1e-6))

    def _report(
        self,
        model: ScheduleModel,
        answer: Answer,
        wants_optimum: bool,
        deadline: Deadline,
        started: float,
    ) -> ScheduleReport:
        seconds = deadline.elapsed() - started
        if answer.status == cp_model.INFEASIBLE:
            if model.horizon.certain:
                return ScheduleReport(ScheduleStatus.INFEASIBLE, seconds=seconds)
            message = f"no schedule ends by {model.limit}; longer ones were not tried"
            return ScheduleReport(ScheduleStatus.NOT_FOUND, message=message, seconds=seconds)
        if answer.status == cp_model.MODEL_INVALID:
            message = model.store.model.validate()
            return ScheduleReport(ScheduleStatus.ERROR, message=message, seconds=seconds)
        if model.objective is None:
            self._learn(answer.bound)
        bound = self.bound or None
        if answer.values is None:
            return ScheduleReport(ScheduleStatus.OUT_OF_TIME, bound=bound, seconds=seconds)
        self._last = answer.values
        schedule = model.schedule(self._lookup(model, answer.values))
        self._last_schedule = schedule
        proven = answer.status == cp_model.OPTIMAL and wants_optimum and model.horizon.certain
        status = ScheduleStatus.OPTIMAL if proven else ScheduleStatus.FOUND
        return ScheduleReport(status, schedule, bound, seconds=seconds)
