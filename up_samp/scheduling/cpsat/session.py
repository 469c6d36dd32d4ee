"""One problem, solved again and again while constraints are added to it; its claims doubted, and
what they rest on in words.
"""

from __future__ import annotations

import logging
import math
import os
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial

from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    OutOfTimeError,
    ScheduleReport,
    ScheduleStatus,
    UnsupportedError,
)
from up_samp.model.deadline import in_force
from up_samp.scheduling.cpsat.encode.states import Key
from up_samp.scheduling.cpsat.encode.timeline import Timeline
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.normal import Watcher
from up_samp.scheduling.cpsat.routing.detection import refusals
from up_samp.scheduling.cpsat.routing.dispatch import find_unit_places
from up_samp.scheduling.cpsat.routing.route import Route
from up_samp.scheduling.cpsat.solve.attempts import NO_PRESOLVE, Attempts, Orders
from up_samp.scheduling.cpsat.solve.strategy import Solve, solve
from up_samp.tuning import Tuning
from up_samp.upio.expressions import constraints_of
from up_samp.upio.objective import Number, plain_number

log = logging.getLogger(__name__)
Told = Callable[[CandidateSchedule, "Number | None"], None]
"""Called with each better schedule, and the bound."""


class CpsatSession:
    """A persistent CP-SAT model of a scheduling problem.

    Each :meth:`solve` first picks up what was appended to ``problem`` since the last one:
    constraints, conditions, activities, narrower durations go into the model as it is; anything
    else makes a new model. The last schedule is the hint, and the lower bound is carried over as
    long as things were only appended.

    :param problem: watched, never changed.
    :param seed: for CP-SAT; with ``workers=1`` answers are deterministic.
    :param workers: threads of CP-SAT (``None``: one per core).
    :param effort: limit of one :meth:`solve` in CP-SAT's deterministic time (0.1 may take a
        second): unlike a deadline, it ends the same way on every machine (``None``: no limit).
    :param tuning: sizes, efforts and shares of its stages.
    :param plain: recognise nothing in the problem. It takes longer, and rests on less.

    ``doubts``: what rests on what was recognised is doubted before it is told; what is refuted is
    told as an error of ours, and the answer is one with nothing recognised. ``soon``: a schedule
    better than the hint is told before more is proven, but not twice for hints as good.
    """

    def __init__(
        self,
        problem: SchedulingProblem,
        *,
        seed: int = 0,
        workers: int | None = None,
        effort: float | None = None,
        tuning: Tuning = Tuning(),
        plain: bool = False,
    ) -> None:
        self.problem = problem
        self.plain = plain
        self.doubts = False
        self.soon = False
        self.seed, self.workers = seed, workers or os.cpu_count() or 1
        self.effort = effort
        self.tuning = tuning
        self.bound: float | Fraction = -math.inf
        self.rebuilds = 0
        self._watcher = Watcher(problem)
        self._model: ScheduleModel | None = None
        self._last: CandidateSchedule | None = None
        self._bounded = False  # whether bounds were sought with all effort
        self._soonest = math.inf  # guesses that end before have had no better one told soon
        self.explanation: tuple[tuple[str, ...], tuple[str, ...]] = (), ()
        """What was recognised, and left over, when the model was last built."""
        self._interrupted = threading.Event()

    def close(self) -> None:
        """Do nothing: a session keeps no processes."""

    def solve(
        self,
        deadline: Deadline,
        *,
        optimal: bool = True,
        hint: CandidateSchedule | None = None,
        lower_bound: Number | None = None,
        on_solution: Told | None = None,
    ) -> ScheduleReport:
        """Solve the problem as it is now.

        :param deadline: kept to within a fraction of a second or so, also while the model is built.
        :param optimal: search to the proven optimum of the metric; otherwise return a first good
            schedule. Without a metric there is no optimum, and a good schedule is returned.
        :param hint: a schedule to start from (default: the last one).
        :param lower_bound: a proven lower bound on what is minimised.
        :param on_solution: told of each better schedule.
        """
        report = self._answer(deadline, optimal, hint, lower_bound, on_solution)
        refuted = self._refuted(report, deadline) if self.doubts and not self.plain else ""
        if not refuted:
            return report
        log.error("%s", refuted)
        self.recognise_nothing()
        return replace(self._answer(deadline, optimal, hint, None, on_solution), refuted=refuted)

    def interrupt(self) -> None:
        """Stop a :meth:`solve` that runs in another thread."""
        self._interrupted.set()

    def _answer(
        self,
        deadline: Deadline,
        optimal: bool,
        hint: CandidateSchedule | None,
        lower_bound: Number | None,
        on_solution: Told | None,
    ) -> ScheduleReport:
        """Return what is found, be it right or not."""
        started = deadline.elapsed()
        try:
            model = self._update(deadline)
        except OutOfTimeError:
            return ScheduleReport(ScheduleStatus.OUT_OF_TIME, seconds=deadline.elapsed() - started)
        if lower_bound is not None:
            self.bound = max(self.bound, lower_bound)
        wants_optimum = optimal and bool(self.problem.quality_metrics)
        orders = Orders(
            self.seed,
            self.workers,
            wants_optimum,
            self.tuning,
            self._interrupted,
            None if on_solution is None else partial(self._tell, model, on_solution),
        )
        start = None if math.isinf(self.bound) else math.ceil(self.bound * model.scale)
        whole = Attempts(model, orders, deadline, start, left=self.effort)
        guess = hint if hint is not None else self._last
        # nothing may come of what was found for a guess soon: once is enough
        soon = self.soon and guess is not None and guess.makespan < self._soonest
        search = Solve(whole, guess, again=self._bounded, soon=soon)
        if not deadline.expired():
            solve(search)
        if guess is not None and search.better:
            self._soonest = min(self._soonest, guess.makespan)
        self._bounded |= search.bounded
        if search.routes is not None:
            self.explanation = explain(model, search.routes)
        report = self._report(whole, deadline.elapsed() - started)
        recognised, left_over = self.explanation
        return replace(report, recognised=recognised, left_over=left_over)

    def recognise_nothing(self) -> None:
        """Go on with the plain model, and forget what was proven otherwise."""
        self.plain, self._model, self.bound = True, None, -math.inf
        self.explanation = (), ()

    def _refuted(self, report: ScheduleReport, deadline: Deadline) -> str:
        """Return what is wrong with a claim ("": nothing that is known)."""
        none = report.status is ScheduleStatus.INFEASIBLE
        if not none and report.bound is None:
            return ""
        best, cost = report.schedule, report.cost
        if best is None or report.bound is None or cost is None or report.bound <= cost:
            best = sooner(
                self.problem,
                None if none else report.bound,
                deadline,
                seed=self.seed,
                tuning=self.tuning,
            )
        return "" if best is None else refuted_by(None if none else report.bound, best)

    # -- stages --------------------------------------------------------------------------------
    def _update(self, deadline: Deadline) -> ScheduleModel:
        parts = self._watcher.look()
        if self._model is None or not self._model.only_tightened(parts):
            self.bound, self._bounded = -math.inf, False
        if self._model is not None and self._model.can_grow(parts):
            # a model that the time ended in the middle of is not used any more
            grown, self._model = self._model, None
            with in_force(deadline):
                grown.grow(parts)
            self._model = grown
            return grown
        self.rebuilds += 1
        self._model = None
        self._model = ScheduleModel(self.problem, deadline=deadline, plain=self.plain)
        return self._model

    def _report(self, search: Attempts, seconds: float) -> ScheduleReport:
        model = search.model
        if search.invalid:
            return ScheduleReport(ScheduleStatus.ERROR, message=search.invalid, seconds=seconds)
        if search.infeasible:
            if model.horizon.certain:
                return ScheduleReport(ScheduleStatus.INFEASIBLE, seconds=seconds)
            message = f"no schedule ends by {model.limit}; longer ones were not tried"
            return ScheduleReport(ScheduleStatus.NOT_FOUND, message=message, seconds=seconds)
        # a schedule that is longer than the horizon is no better, but may have more of other things
        all_seen = model.horizon.certain or search.minimizes_makespan
        if all_seen:
            self.bound = max(self.bound, cost_of(model, search.bound))
        bound = self._told(model)
        if search.best is None:
            return ScheduleReport(ScheduleStatus.OUT_OF_TIME, bound=bound, seconds=seconds)
        self._last = search.best
        proven = search.proven and search.orders.optimal and all_seen
        status = ScheduleStatus.OPTIMAL if proven else ScheduleStatus.FOUND
        late = not proven and search.deadline.expired()
        cost = cost_of(model, search.value)
        return ScheduleReport(status, search.best, bound, seconds=seconds, late=late, cost=cost)

    def _told(self, model: ScheduleModel) -> Number | None:
        """Return the bound, if it says anything: no schedule ends before 0."""
        nothing = math.isinf(self.bound) or (model.asked is None and not self.bound)
        return None if nothing else plain_number(self.bound)

    def _tell(
        self, model: ScheduleModel, tell: Told, schedule: CandidateSchedule, bound: int
    ) -> None:
        if model.horizon.certain or model.asked is None:
            self.bound = max(self.bound, cost_of(model, bound))
        tell(schedule, self._told(model))


def cost_of(model: ScheduleModel, number: int) -> Number:
    """Return a number of a model's objective as a cost."""
    return plain_number(Fraction(number, model.scale))


# ------------------ Claims that rest on what was recognised, doubted
# The plain model of a small problem, in which nothing is recognised, is asked for a schedule that
# cannot be if they hold.


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


# ------------------ What was recognised and what was left over, in words: why a bound may be weak


def explain(model: ScheduleModel, routes: list[Route]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return sentences about what was recognised in a model, and about what was left over;
    ``routes`` are those that were found in it.
    """
    found = [
        *(_route(model, route) for route in routes),
        *_cliques(model),
        *_alternatives(model),
        *_states(model, routes),
    ]
    return tuple(found), tuple(_left(model, routes))


def name_of(model: ScheduleModel, key: Key) -> str:
    """Return a ground fluent as it is written."""
    fluent, *arguments = key
    names = {code: name for name, code in model.world.objects.items()}
    if str(fluent).startswith("#"):
        return "a state said with precedences"
    return (
        f"{fluent}({', '.join(str(names.get(a, a)) for a in arguments)})" if arguments else fluent
    )


def _route(model: ScheduleModel, route: Route) -> str:
    doors = len({e.state for entries in route.entries.values() for e in entries})
    names = {move.name for move in route.moves} - route.odd.keys()
    parts = [f"{len(names)} moves", f"{len(route.stops)} stops"]
    if route.visits:
        parts.append(f"{len(route.visits)} places to come to")
    if doors:
        parts.append(f"{doors} needed open on the way")
    if route.final is not None:
        parts.append("a way home")
    return f"route {name_of(model, route.key)}: {', '.join(parts)}"


def _cliques(model: ScheduleModel) -> list[str]:
    sizes = sorted((len(members) for _, members in model.disjunctions.cliques), reverse=True)
    large = [size for size in sizes if size > 2]
    if not large:
        return []
    return [f"one thing at a time: {len(large)} sets of {large[-1]} to {large[0]} activities"]


def _alternatives(model: ScheduleModel) -> list[str]:
    counts = Counter(len(members) for members in model.disjunctions.groups if len(members) > 1)
    return [f"exactly one of {size} activities: {n} times" for size, n in sorted(counts.items())]


def _states(model: ScheduleModel, routes: list[Route]) -> list[str]:
    known = {route.key for route in routes}
    circuits = [
        key
        for key, timeline in model.timelines.items()
        if isinstance(timeline, Timeline) and timeline.linked and key not in known
    ]
    replaced = [key for key in model.replaced if not str(key[0]).startswith("#")]
    counts = {
        "unary places": find_unit_places(model, routes),
        "state variables with transitions": circuits,
        "resources and flags that are for one": replaced,
    }
    return [f"{what}: {len(some)}" for what, some in counts.items() if some]


def _left(model: ScheduleModel, routes: list[Route]) -> list[str]:
    found = [
        f"{name_of(model, key)} is no route: {why}"
        for key, why in sorted(refusals(model, routes).items(), key=str)
    ]
    several = [p for p in model.unread if p.initially is not None or any(p.helpers.values())]
    if several:
        found.append(
            f"{len(several)} preconditions said with precedences (of {several[0].activity} and "
            "others) are stated as written: helpers and rivals may overlap, or some are not named"
        )
    whole = {route.key for route in routes}
    stops = {name for route in routes for name, _ in route.stops}
    moves = {name for route in routes for name in route.movers}
    found += [
        f"beside route {name_of(model, route.key)}: {name} {why}"
        for route in routes
        for name, why in sorted(route.odd.items())
    ]
    odd = {name for route in routes for name in route.odd}
    if whole:
        others = [
            name
            for name, activity in model.world.activities.items()
            if name not in stops | moves | odd and not model.store.never(activity.present)
        ]
        if others:
            found.append(f"{len(others)} activities are on no route ({others[0]} and others)")
    return found
