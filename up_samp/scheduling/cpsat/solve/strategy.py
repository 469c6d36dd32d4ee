"""How one model is solved: collapsed problem, first schedules under tight caps, then the proof."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ortools.sat.python import cp_model

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.encode.store import TRUE, Lin
from up_samp.scheduling.cpsat.model import OutOfTimeError, ScheduleModel
from up_samp.scheduling.cpsat.problem import Additions
from up_samp.scheduling.cpsat.routing.detection import Route, find_routes
from up_samp.scheduling.cpsat.routing.dispatch import Work, find_work
from up_samp.scheduling.cpsat.routing.expand import expand
from up_samp.scheduling.cpsat.routing.list_scheduling import decode, improve, sequence_of
from up_samp.scheduling.cpsat.routing.relaxation import Collapsed
from up_samp.scheduling.cpsat.routing.workload import bound_by_work
from up_samp.scheduling.cpsat.solve import options as efforts
from up_samp.scheduling.cpsat.solve.runner import Answer, Run, run
from up_samp.scheduling.cpsat.solve.solutions import hint_values, schedule_of

Progress = Callable[[CandidateSchedule, "int | None"], None]

_ROUNDS_PER_TASK = 60
"""Rounds of annealing over tours before CP-SAT is asked."""
_FEW_TASKS = 8
"""Up to so many the collapsed problem is solved to its optimum sooner than tours are annealed."""
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
    collapsed: bool = False
    left: float | None = None
    """Effort that is left for all stages together (``None``: no limit)."""
    value: int = 0
    """The makespan of ``best``, with the way home where moves were taken out."""
    routes: list[Route] | None = None
    """What was found when they were looked for."""
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
            self._known.update(hint_values(self.model, guess))
        if guess is not None and guess.times and self.minimizes_makespan:
            # the same activities again, if they still fit, are mostly near the optimum
            self._realize(guess)
            if self._met() or self._over() or self._swiftly():
                return
        base = guess.makespan if guess is not None else 0
        routes = self.routes = find_routes(self.model) if self.minimizes_makespan else []
        base = max(base, self._collapse(parts, routes))
        if not routes and not self._over():
            self._climb()
        if self._over():
            return
        content = bool(routes) and not self.wants_optimum
        if self.best is None:
            self._first(base)
        elif content:
            return  # what the collapsed problem does not better, the whole one does not soon
        if not self._over():
            self._finish()

    def _over(self) -> bool:
        spent = self.left is not None and self.left <= 0
        ended = self.infeasible or self.proven or bool(self.invalid)
        return ended or spent or self.deadline.expired()

    # -- stages --------------------------------------------------------------------------------
    def _climb(self) -> None:
        """Solve a small problem without routes, with more and more effort."""
        if self._size() > efforts.SMALL or self._sprint(self._cap()):
            return
        if self.wants_optimum and self.settings.workers > 1:
            # a poor schedule as a hint leads both searches astray
            self._improve(self.model.limit, efforts.TEAM, efforts.TEAM_EFFORT, hinted=False)
            return
        for options, effort in efforts.ALONE if self.wants_optimum else efforts.ALONE[:1]:
            self._improve(self._cap(), options, effort)
            if self._met() or self._over():
                return

    def _sprint(self, cap: int) -> bool:
        """Try what solves the smallest problems at once; return whether all is done."""
        if self._size() <= efforts.TINY:
            self._improve(cap, efforts.SPRINT, efforts.SPRINT_EFFORT)
        return self._met() or self._over()

    def _size(self) -> int:
        return len(self.model.store.model.proto.constraints)

    def _collapse(self, parts: Callable[[], Additions], routes: list[Route]) -> int:
        """Solve the collapsed problem, if there is one; return the makespan to expect."""
        if not routes:
            return 0
        work = find_work(self.model, routes)
        if work is not None:
            deadline = self.deadline.within(0.1 * self.deadline.remaining())
            self.bound = bound_by_work(
                self.model, work, self.bound, deadline.expired, thorough=self.wants_optimum
            )
        if work is not None and self.best is None:
            few = self.wants_optimum and len(work.tasks) <= _FEW_TASKS
            rounds = 0 if few else _ROUNDS_PER_TASK * len(work.tasks)
            deadline = self.deadline.within(0.2 * self.deadline.remaining())
            tour = improve(work, rounds, self.settings.seed, deadline.expired)
            if tour is not None:
                self._realize(tour.schedule)
        if self._met() or self._over():
            return self.value
        try:
            collapsed = Collapsed(self.model, parts(), routes, self.deadline)
        except OutOfTimeError:
            return self.value
        return self._through(collapsed, work)

    def _through(self, collapsed: Collapsed, work: Work | None) -> int:
        """Solve the collapsed problem and make what is found a schedule of the whole, the first
        one at once and the best one in the end; return the collapsed makespan.

        A schedule of the whole in hand is one of the collapsed problem, for its search to start
        from; where there is no better one, it is an optimal one.
        """
        inner = Search(
            collapsed.model,
            self.settings,
            self.deadline.within(0.35 * self.deadline.remaining()),
            self.bound,
            self.wants_optimum,
            None,
            self.interrupted,
        )
        inner.collapsed = True
        inner.left = self.left
        inner._known.update(collapsed.hints(self._known))
        inner.effort = (
            efforts.COLLAPSED_EFFORT if self.wants_optimum else efforts.CONTENT_COLLAPSED_EFFORT
        )
        if self.best is not None:
            options = efforts.THOROUGH if self.wants_optimum else efforts.RELAXED
            if not inner._sprint(self.value):
                inner._improve(self.value, options, inner.effort)
        else:
            inner._first(0)
            if inner.best is not None:
                self._realize(expand(collapsed.routes, inner.best))
                inner.deadline = self.deadline.within(0.35 * self.deadline.remaining())
            if not inner._over():
                inner._finish()
            self.infeasible = inner.infeasible
        self.bound = max(self.bound, inner.bound)
        self.left = inner.left
        if inner.best is None:
            return self.value
        if not self._met():
            tour = None if work is None else decode(work, sequence_of(work, inner.best))
            if tour is None or not self._realize(tour.schedule) or self.value > inner.value:
                self._realize(expand(collapsed.routes, inner.best))
        self._met()
        return inner.value

    def _realize(self, guess: CandidateSchedule) -> bool:
        """Try to make a schedule of a collapsed one; return whether that worked.

        Who is present is taken over; times may shift, for what the collapsed problem left out.
        """
        hints = hint_values(self.model, guess)
        self._known.update(hints)
        presences = {abs(a.present) for a in self.model.world.activities.values()} - {TRUE}
        for slack in _SLACKS:
            cap = max(int(slack * guess.makespan) + (2 if slack > 1 else 0), self.bound)
            if self.best is not None and cap >= self.value:
                break
            model = self.model.capped(cap)
            for var in sorted(presences & hints.keys()):
                position = self.model.store.position(var)
                model.add(model.get_int_var_from_proto_index(position) == hints[var])
            self._set_hints(model)
            answer = None
            if self._size() <= efforts.TINY:
                answer = self._run(model, efforts.SPRINT, efforts.SPRINT_EFFORT, first=True)
            if answer is None or answer.status == cp_model.UNKNOWN:
                answer = self._run(model, efforts.QUICK, 1.0, first=True)
            if answer.values is not None or self._over():
                return answer.values is not None
        return False

    def _first(self, base: int) -> None:
        """Find some schedule: a dive under a loose cap, which mostly does; then caps from tight
        to loose, with more effort each time.
        """
        limit = self.model.limit
        model = self.model.capped(max(limit // 8, 4 * base))
        self._set_hints(model)
        if self._run(model, efforts.DIVE, 0.5, first=True).values is not None or self._over():
            return
        base = max(base, self.bound)
        cap = int(1.1 * base) + 5 if base else max(20, limit // 64)
        effort = 1.0
        while self.values is None and not self._over():
            last = cap >= limit
            model = self.model.capped(min(cap, limit))
            self._set_hints(model)
            for options, share in (
                (efforts.RELAXED, 2.0),
                (efforts.QUICK, 1.0),
                (efforts.DIVE, 1.0),
            ):
                unlimited = last and options is efforts.DIVE
                budget = None if unlimited else share * effort
                answer = self._run(model, options, budget, first=True)
                if answer.status == cp_model.INFEASIBLE:
                    self._no_schedule(cap, last)
                    break
                if answer.values is not None or self._over():
                    return
            if last:
                return
            cap, effort = 2 * cap, 1.6 * effort

    def _no_schedule(self, cap: int, last: bool) -> None:
        """Learn that no schedule ends by ``cap``."""
        if last:
            self.infeasible = True
        elif self.minimizes_makespan:
            self.bound = max(self.bound, cap + 1)

    def _finish(self) -> None:
        """Improve the schedule until it is proven optimal, or good enough."""
        if self._met():
            return
        if not self.collapsed and self._swiftly():
            return
        effort = self.effort if self.wants_optimum or self.effort else efforts.CONTENT_EFFORT
        options = efforts.THOROUGH if self.wants_optimum else efforts.RELAXED
        self._improve(self._cap(), options, effort)

    def _swiftly(self) -> bool:
        """Try a quick proof from the schedule in hand; return whether all is done."""
        known = self.best is not None and self.minimizes_makespan and self.wants_optimum
        if known and self._size() <= efforts.SMALL:
            if self._size() <= efforts.TINY:
                self._improve(self._cap(), efforts.DASH, efforts.DASH_EFFORT)
            if not self._met() and not self._over():
                self._improve(self._cap(), efforts.SWIFT, efforts.SWIFT_EFFORT)
        return self._met() or self._over()

    def _cap(self) -> int:
        """Return by when schedules that are not worse than the best one end."""
        known = self.minimizes_makespan and self.best is not None
        return self.value if known else self.model.limit

    def _improve(
        self, cap: int, options: dict[str, Any], effort: float | None, *, hinted: bool = True
    ) -> None:
        """Search between the bound and ``cap``, and learn from the answer."""
        store = self.model.store
        model = self.model.capped(cap)
        if self.minimizes_makespan and self.bound:
            makespan = model.get_int_var_from_proto_index(store.position(self.model.world.makespan))
            model.add(makespan >= self.bound)
        if hinted:
            self._set_hints(model)
        answer = self._run(model, options, effort, first=False)
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
        if self.minimizes_makespan and self.best is not None and self.value <= self.bound:
            self.proven = True
        return self.proven

    # -- running -------------------------------------------------------------------------------
    def _run(
        self, model: Any, options: dict[str, Any], effort: float | None, *, first: bool
    ) -> Answer:
        limits = [e for e in (effort, self.left) if e is not None]
        if limits:
            options = {**options, "max_deterministic_time": max(0.0, min(limits))}
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
        if self.left is not None:
            self.left -= answer.effort
        if answer.status == cp_model.MODEL_INVALID:
            self.invalid = model.validate()
        elif answer.values is not None:
            self._take(answer.values)
        return answer

    def _take(self, values: list[int]) -> None:
        schedule = schedule_of(self.model, _lookup(self.model, values))
        value = schedule.makespan
        if self.collapsed:
            value = values[self.model.store.position(self.model.world.makespan)]
        if self.best is None or value < self.value or not self.minimizes_makespan:
            self.best, self.values, self.value = schedule, values, value
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
