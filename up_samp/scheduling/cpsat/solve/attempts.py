"""Attempts at one model: what is known of its schedules, and single runs of CP-SAT to know more."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from ortools.sat.python import cp_model

from up_samp.model import CandidateSchedule, Deadline
from up_samp.scheduling.cpsat.encode.forms import TRUE, Lin
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.solve import runner
from up_samp.scheduling.cpsat.solve.runner import Profile, SolverAnswer, run
from up_samp.tuning import Tuning


def schedule_of(model: ScheduleModel, value: Callable[[int], int]) -> CandidateSchedule:
    """Return the schedule in a solution; ``value(var)`` gives each variable's value."""

    def worth(lin: Lin) -> int:
        return lin.const + sum(c * value(v) for v, c in lin.terms)

    times = {
        a.name: (worth(a.start), worth(a.end))
        for a in model.world.activities.values()
        if value(a.present)
    }
    names = {code: name for name, code in model.world.objects.items()}
    parameters: dict[str, bool | int | str] = {}
    for name, (var, tpe, owner) in model.parameters.items():
        if owner is not None and owner not in times:
            continue
        number = value(var)
        if tpe.is_bool_type():
            parameters[name] = bool(number)
        else:
            parameters[name] = names[number] if tpe.is_user_type() else number
    return CandidateSchedule(times, parameters)


def hint_values(model: ScheduleModel, schedule: CandidateSchedule) -> dict[int, int]:
    """Return variable -> value as ``schedule`` has it (only the main decisions)."""
    values = {model.world.makespan: schedule.makespan}
    for made in model.world.activities.values():
        times = schedule.times.get(made.name)
        if made.present != TRUE:
            values[made.present] = int(times is not None)
        if times is not None:
            values[made.start.terms[0][0]] = times[0]
            if made.size.terms:
                values[made.end.terms[0][0]] = times[1]
                values[made.size.terms[0][0]] = times[1] - times[0]
    for name, (var, tpe, _) in model.parameters.items():
        if name in schedule.parameters:
            value = schedule.parameters[name]
            code = model.world.objects[str(value)] if tpe.is_user_type() else int(value)
            values[var] = code
    return values


Progress = Callable[[CandidateSchedule, int], None]

_SMALL = 20_000
"""Constraints up to which two full searches, one thread alone and quick proofs are tried: they must
not cost large models their time."""
# efforts, in CP-SAT's deterministic time
NO_PRESOLVE = 0.005
"""For a tiny problem: presolve costs more than the search."""
_NO_INPROCESSING = 0.02
"""For a tiny problem with a schedule near the bound in hand: half of so short a proof would be
inprocessing."""
_ONE_PRESOLVE_PASS = 0.3
"""For a proof from a schedule near the bound in hand."""
_TWO_SEARCHES = 4.0
"""For two full searches of a small problem."""
_ONE_THREAD = (0.1, 0.4, 2.0)
"""For the same with one thread, one attempt after the other."""
_REALIZE = 1.0
"""For a schedule of the whole from one of its relaxation, under each of these caps:"""
_CAPS = (1.0, 1.1, 1.3, 1.7)
"""Over the relaxation's makespan."""
_FIRST_DIVE = 0.5
"""For the first dive under a loose cap."""
_FIRST, _GROWTH = 1.0, 1.6
"""For a first schedule under the tightest cap, and how it grows with each looser one."""


@dataclass(frozen=True)
class Orders:
    """How all runs of one solve are made. ``optimal``: the proven optimum is asked for."""

    seed: int
    workers: int
    optimal: bool
    tuning: Tuning
    interrupted: threading.Event
    progress: Progress | None = None


@dataclass
class Attempts:
    """What is known of one model: ``bound`` (of what is minimised: the makespan, or ``objective``
    of the model) and ``best`` grow. Efforts are in CP-SAT's deterministic time, so that with one
    worker the same seed gives the same schedule.

    ``left``: effort that is left for all attempts together (``None``: no limit).
    """

    model: ScheduleModel
    orders: Orders
    deadline: Deadline
    start: int | None
    """A proven bound to begin with."""
    left: float | None = None
    best: CandidateSchedule | None = None
    value: int = 0
    """What ``best`` costs: its makespan, or its ``objective``."""
    known: dict[int, int] = field(default_factory=dict)
    """Values of variables in a schedule to start from: hints."""
    bound: int = 0
    infeasible: bool = False
    proven: bool = False
    invalid: str = ""

    def __post_init__(self) -> None:
        self.minimizes_makespan = self.model.asked is None
        store, objective = self.model.store, self.model.objective
        least = store.range(objective)[0]
        self.bound = least if self.start is None else max(self.start, least)
        store.model.minimize(store.expression(objective))

    # -- what is known -------------------------------------------------------------------------
    @property
    def size(self) -> int:
        """How many constraints the model has."""
        return len(self.model.store.model.proto.constraints)

    @property
    def tiny(self) -> bool:
        """Whether the model is small enough for runs without presolve."""
        return self.size <= self.orders.tuning.tiny

    @property
    def small(self) -> bool:
        """Whether the model is small enough for proofs on the side."""
        return self.size <= _SMALL

    def met(self) -> bool:
        """Whether the best schedule costs what is the proven bound."""
        if self.best is not None and self.value <= self.bound:
            self.proven = True
        return self.proven

    def over(self) -> bool:
        """Whether nothing more can be learned, or there is no time or effort left."""
        spent = self.left is not None and self.left <= 0
        ended = self.met() or self.infeasible or bool(self.invalid)
        return ended or spent or self.deadline.expired()

    @property
    def cap(self) -> int:
        """By when schedules that are not worse than the best one end."""
        known = self.minimizes_makespan and self.best is not None
        return self.value if known else self.model.limit

    @property
    def prices(self) -> dict[str | None, int]:
        """What each activity costs that is there; nothing where that is not all that counts, or
        where some are worth having.
        """
        names = {a.present: a.name for a in self.model.world.activities.values()}
        prices = {names.get(var): price for var, price in self.model.objective.terms}
        return {} if None in prices or min(prices.values(), default=0) < 0 else prices

    # -- attempts ------------------------------------------------------------------------------
    def without_presolve(self, cap: int) -> None:
        """Try what solves the smallest problems at once."""
        if self.tiny:
            self.improve(cap, runner.NO_PRESOLVE, NO_PRESOLVE)

    def climb(self) -> None:
        """Solve a small problem without routes, with more and more effort."""
        if not self.small:
            return
        optimal = self.orders.optimal
        self.without_presolve(self.cap)
        if self.over():
            return
        if optimal and self.orders.workers > 1:
            # a poor schedule as a hint leads both searches astray
            profile = runner.TWO_FULL_SEARCHES
            self.improve(self.model.limit, profile, _TWO_SEARCHES, hinted=False)
            return
        turns = zip(itertools.cycle(runner.ONE_THREAD), _ONE_THREAD, strict=False)
        for profile, effort in turns if optimal else itertools.islice(turns, 1):
            self.improve(self.cap, profile, effort)
            if self.over():
                return

    def prove_quickly(self) -> None:
        """Try a quick proof from the schedule in hand, if the optimum is asked for."""
        known = self.best is not None and self.minimizes_makespan and self.orders.optimal
        if not known or not self.small:
            return
        if self.tiny:
            self.improve(self.cap, runner.NO_INPROCESSING, _NO_INPROCESSING)
        if not self.over():
            self.improve(self.cap, runner.ONE_PRESOLVE_PASS, _ONE_PRESOLVE_PASS)

    def finish(self, effort: float | None) -> None:
        """Improve the schedule until it is proven optimal, or good enough."""
        optimal = self.orders.optimal
        profile = runner.CP_SATS_OWN if optimal else runner.LINEARIZATION
        self.improve(self.cap, profile, effort)

    def realize(self, guess: CandidateSchedule, others: Iterable[str] = ()) -> bool:
        """Try to make a schedule of a relaxed one; return whether that worked.

        Who is present is taken over, but for ``others``, of which it says nothing; times may
        shift, for what the relaxation left out.
        """
        hints = hint_values(self.model, guess)
        activities = self.model.world.activities
        for name in others:
            hints.pop(activities[name].present, None)
        self.known.update(hints)
        presences = {abs(a.present) for a in activities.values()} - {TRUE}
        caps = [int(f * guess.makespan) + (2 if f > 1 else 0) for f in _CAPS]
        if self.cap < self.model.limit:
            # any better one will do, if there is none as short as the guess
            caps = [cap for cap in caps if cap < self.value - 1] + [self.value - 1]
        for cap in caps:
            if cap < self.bound * self.minimizes_makespan:
                continue
            model = self._capped(cap)
            for var in sorted(presences & hints.keys()):
                position = self.model.store.position(var)
                model.add(model.get_int_var_from_proto_index(position) == hints[var])
            answer = None
            if self.tiny:
                answer = self._run(model, runner.NO_PRESOLVE, NO_PRESOLVE, first=True)
            if answer is None or answer.status == cp_model.UNKNOWN:
                answer = self._run(model, runner.NO_LINEARIZATION, _REALIZE, first=True)
            if answer.values is not None or self.over():
                return answer.values is not None
        return False

    def first(self, base: int) -> None:
        """Find some schedule: a dive under a loose cap, which mostly does; then caps from tight
        to loose, with more effort each time. ``base``: the makespan to expect (0: not known).
        """
        limit = self.model.limit
        model = self._capped(max(limit // 8, 4 * base))
        dived = self._run(model, runner.DIVE, _FIRST_DIVE, first=True)
        if dived.values is not None or self.over():
            return
        base = max(base, self.bound)
        cap = int(1.1 * base) + 5 if base else max(20, limit // 64)
        effort = _FIRST
        while self.best is None and not self.over():
            last = cap >= limit
            if self._under(min(cap, limit), effort, last=last) or last:
                return
            cap, effort = 2 * cap, _GROWTH * effort

    def _under(self, cap: int, effort: float, *, last: bool) -> bool:
        """Look for some schedule under a cap; return whether that is over, well or not."""
        model = self._capped(cap)
        for profile, weight in (
            (runner.LINEARIZATION, 2.0),
            (runner.NO_LINEARIZATION, 1.0),
            (runner.FIXED_SEARCH if last else runner.DIVE, 1.0),
        ):
            unlimited = profile is runner.FIXED_SEARCH
            answer = self._run(model, profile, None if unlimited else weight * effort, first=True)
            if answer.status == cp_model.INFEASIBLE:
                if last:
                    self.infeasible = True
                elif self.minimizes_makespan:
                    self.bound = max(self.bound, cap + 1)
                return False
            if answer.values is not None or self.over():
                return True
        return False

    def below(self, most: int | None) -> None:
        """Look for some schedule that costs at most so much (``None``: for any), from nothing that
        is known.
        """
        capped = self.minimizes_makespan and most is not None
        cap = self.model.limit if most is None or not capped else most
        if cap < 0:
            return
        model = self.model.capped(cap)
        if most is not None and not capped:
            store, cost = self.model.store, self.model.objective
            some = [model.get_int_var_from_proto_index(store.position(v)) for v, _ in cost.terms]
            total = cp_model.LinearExpr.weighted_sum(some, [c for _, c in cost.terms])
            model.add_linear_constraint(total, cp_model.INT_MIN, most - cost.const)
        self._run(model, runner.ONE_PRESOLVE_PASS, None, first=True)

    def improve(
        self, cap: int, profile: Profile, effort: float | None, *, hinted: bool = True
    ) -> None:
        """Search between the bound and ``cap``, and learn from the answer."""
        store = self.model.store
        model = self._capped(cap, hinted=hinted)
        if self.minimizes_makespan and self.bound:
            makespan = model.get_int_var_from_proto_index(store.position(self.model.world.makespan))
            model.add(makespan >= self.bound)
        answer = self._run(model, profile, effort, first=False)
        if answer.status == cp_model.INFEASIBLE and self.best is None:
            self.infeasible = True
        if answer.status == cp_model.OPTIMAL:
            self.proven = True
        told = answer.values is not None or answer.status == cp_model.UNKNOWN
        if told and math.isfinite(answer.bound):
            self.bound = max(self.bound, math.ceil(answer.bound - 1e-6))

    # -- running -------------------------------------------------------------------------------
    def _run(
        self, model: Any, profile: Profile, effort: float | None, *, first: bool
    ) -> SolverAnswer:
        usual = {"random_seed": self.orders.seed, "num_workers": self.orders.workers}
        profile = {**usual, **profile}
        limits = [e for e in (effort, self.left) if e is not None]
        if limits:
            profile = {**profile, "max_deterministic_time": max(0.0, min(limits))}
        if first:
            profile = {**profile, "stop_after_first_solution": True}
        progress = self.orders.progress

        def improved(values: list[int], bound: float) -> None:
            self._take(values)
            if progress is not None and self.best is not None:
                if not first and math.isfinite(bound):
                    self.bound = max(self.bound, math.ceil(bound - 1e-6))
                progress(self.best, self.bound)

        answer = run(
            model,
            self.deadline,
            improved,
            interrupted=self.orders.interrupted,
            options=profile,
        )
        if self.left is not None:
            self.left -= answer.effort
        if answer.status == cp_model.MODEL_INVALID:
            self.invalid = model.validate()
        elif answer.values is not None:
            self._take(answer.values)
        return answer

    def _take(self, values: list[int]) -> None:
        store = self.model.store
        schedule = schedule_of(self.model, lambda var: values[store.position(var)])
        value = schedule.makespan
        if not self.minimizes_makespan:
            cost = self.model.objective
            value = cost.const + sum(c * values[store.position(v)] for v, c in cost.terms)
        if self.best is None or value < self.value:
            self.best, self.value = schedule, value
            self.known = {v: values[p] for v, p in store.positions() if v and p < len(values)}

    def _capped(self, cap: int, *, hinted: bool = True) -> Any:
        """Return the model in which everything ends by ``cap``, with what is known as hints."""
        model = self.model.capped(cap)
        model.clear_hints()
        some = sorted(self.known.items()) if hinted else []
        hint = model.proto.solution_hint  # one by one takes a hundred times as long
        hint.vars.extend([self.model.store.position(var) for var, _ in some])
        hint.values.extend([value for _, value in some])
        return model
