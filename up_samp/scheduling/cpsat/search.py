"""How one model is solved: collapsed problem, first schedules under tight caps, then the proof."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ortools.sat.python import cp_model

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.collapse import Collapsed
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.problem import Additions
from up_samp.scheduling.cpsat.routes import find_routes
from up_samp.scheduling.cpsat.solving import Answer, Run, run
from up_samp.scheduling.cpsat.store import TRUE, Lin

Progress = Callable[[CandidateSchedule, "int | None"], None]

_QUICK = {"linearization_level": 0, "cp_model_probing_level": 0, "symmetry_level": 0}
# no interleave_search: with several workers it aborts the process ("heuristics.fixed_search")
_THOROUGH: dict[str, Any] = {}
_COLLAPSED_EFFORT = 15.0
_CONTENT_EFFORT = 1.0
_SLACKS = (1.0, 1.1, 1.3, 1.7)


@dataclass
class Search:
    """One solve. ``bound`` and ``best`` grow; efforts are in CP-SAT's deterministic time, so
    that with one worker the same seed gives the same schedule.
    """

    model: ScheduleModel
    settings: Run
    deadline: Deadline
    bound: int
    wants_optimum: bool
    progress: Progress | None
    interrupted: threading.Event
    best: CandidateSchedule | None = None
    values: list[int] | None = None
    infeasible: bool = False
    proven: bool = False
    invalid: str = ""
    effort: float | None = None
    _known: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.minimizes_makespan = self.model.objective is None
        store = self.model.store
        objective = self.model.objective or Lin(((self.model.world.makespan, 1),))
        store.model.minimize(store.expression(objective))

    def run(self, parts: Callable[[], Additions], guess: CandidateSchedule | None) -> None:
        """Solve the model. ``parts`` gives all of the problem, ``guess`` a schedule to start
        from (it may break what was added since).
        """
        if guess is not None:
            self._known.update(self.model.hint_values(guess))
        base = guess.makespan if guess is not None else 0
        base = max(base, self._collapse(parts))
        if self._over():
            return
        if self.best is None:
            self._first(base)
        if not self._over():
            self._finish()

    def _over(self) -> bool:
        return self.infeasible or self.proven or bool(self.invalid) or self.deadline.expired()

    # -- stages --------------------------------------------------------------------------------
    def _collapse(self, parts: Callable[[], Additions]) -> int:
        """Solve the collapsed problem, if there is one; return the makespan to expect."""
        if not self.minimizes_makespan:
            return 0
        routes = find_routes(self.model)
        if not routes:
            return 0
        collapsed = Collapsed(self.model, parts(), routes)
        expected = 0
        for restricted in (False, True):
            if restricted:
                collapsed.once_only()
            answer = self._solve_collapsed(collapsed, restricted)
            if answer is None or self._over():
                return expected
            schedule = collapsed.model.schedule(_lookup(collapsed.model, answer))
            expected = schedule.makespan
            if self._realize(collapsed.expand(schedule)):
                return expected
        return expected

    def _solve_collapsed(self, collapsed: Collapsed, restricted: bool) -> list[int] | None:
        inner = Search(
            collapsed.model,
            self.settings,
            self.deadline.within(0.3 * self.deadline.remaining()),
            self.bound,
            self.wants_optimum,
            None,
            self.interrupted,
        )
        inner.effort = _COLLAPSED_EFFORT if self.wants_optimum else _CONTENT_EFFORT
        inner._first(0)
        if not inner._over():
            inner._finish()
        if not restricted:
            self.bound = max(self.bound, inner.bound)
            self.infeasible = inner.infeasible
            self.proven = False
        return inner.values

    def _realize(self, guess: CandidateSchedule) -> bool:
        """Try to make a schedule of a collapsed one; return whether that worked.

        Who is present is taken over; times may shift, for what the collapsed problem left out.
        """
        hints = self.model.hint_values(guess)
        self._known.update(hints)
        presences = {abs(a.present) for a in self.model.world.activities.values()} - {TRUE}
        for slack in _SLACKS:
            model = self.model.capped(max(int(slack * guess.makespan) + 2, self.bound))
            for var in sorted(presences & hints.keys()):
                position = self.model.store.position(var)
                model.add(model.get_int_var_from_proto_index(position) == hints[var])
            self._set_hints(model)
            answer = self._run(model, _QUICK, 1.0, first=True)
            if answer.values is not None or self._over():
                return answer.values is not None
        return False

    def _first(self, base: int) -> None:
        """Find some schedule: caps from tight to loose, with more effort each time."""
        limit = self.model.limit
        base = max(base, self.bound)
        cap = int(1.1 * base) + 5 if base else max(20, limit // 64)
        effort = 1.0
        while self.values is None and not self._over():
            last = cap >= limit
            model = self.model.capped(min(cap, limit))
            self._set_hints(model)
            answer = self._run(model, _QUICK, None if last else effort, first=True)
            if answer.status == cp_model.INFEASIBLE:
                if last:
                    self.infeasible = True
                elif self.minimizes_makespan:
                    self.bound = max(self.bound, cap + 1)
            elif last and answer.values is None:
                return
            cap, effort = 2 * cap, 1.6 * effort

    def _finish(self) -> None:
        """Improve the schedule until it is proven optimal, or good enough."""
        if self._met():
            return
        store, limit = self.model.store, self.model.limit
        cap = limit
        if self.minimizes_makespan and self.best is not None:
            cap = self.best.makespan
        model = self.model.capped(cap)
        if self.minimizes_makespan and self.bound:
            makespan = model.get_int_var_from_proto_index(store.position(self.model.world.makespan))
            model.add(makespan >= self.bound)
        self._set_hints(model)
        effort = self.effort if self.wants_optimum or self.effort else _CONTENT_EFFORT
        answer = self._run(model, _THOROUGH, effort, first=False)
        if answer.status == cp_model.INFEASIBLE and self.best is None:
            self.infeasible = True
        if answer.status == cp_model.OPTIMAL:
            self.proven = True
        if self.minimizes_makespan and math.isfinite(answer.bound) and answer.values is not None:
            self.bound = max(self.bound, math.ceil(answer.bound - 1e-6))
        elif self.minimizes_makespan and answer.status == cp_model.UNKNOWN:
            self.bound = max(self.bound, math.ceil(max(answer.bound, 0) - 1e-6))

    def _met(self) -> bool:
        """Whether the schedule's makespan is the proven bound."""
        if self.minimizes_makespan and self.best is not None and self.best.makespan <= self.bound:
            self.proven = True
        return self.proven

    # -- running -------------------------------------------------------------------------------
    def _run(
        self, model: Any, options: dict[str, Any], effort: float | None, *, first: bool
    ) -> Answer:
        if effort is not None:
            options = {**options, "max_deterministic_time": effort}
        if first:
            options = {**options, "stop_after_first_solution": True}

        def improved(values: list[int], objective: float, bound: float) -> bool:
            self._take(values)
            if self.progress is not None and self.best is not None:
                if self.minimizes_makespan and not first and math.isfinite(bound):
                    self.bound = max(self.bound, math.ceil(bound - 1e-6))
                self.progress(self.best, self.bound or None)
            return False

        answer = run(
            model,
            self.settings,
            self.deadline,
            improved,
            interrupted=self.interrupted,
            options=options,
        )
        if answer.status == cp_model.MODEL_INVALID:
            self.invalid = model.validate()
        elif answer.values is not None:
            self._take(answer.values)
        return answer

    def _take(self, values: list[int]) -> None:
        schedule = self.model.schedule(_lookup(self.model, values))
        better = self.best is None or schedule.makespan < self.best.makespan
        if better or not self.minimizes_makespan:
            self.best, self.values = schedule, values
            positions = self.model.store.positions()
            self._known = {v: values[p] for v, p in positions if v and p < len(values)}

    def _set_hints(self, model: Any) -> None:
        """Give the model what is known as hints."""
        model.clear_hints()
        for var, value in sorted(self._known.items()):
            position = self.model.store.position(var)
            model.add_hint(model.get_int_var_from_proto_index(position), value)


def _lookup(model: ScheduleModel, values: list[int]) -> Callable[[int], int]:
    def value(var: int) -> int:
        return values[model.store.position(var)]

    return value
