"""Who goes first, decided again: the sides of components as binaries (CP-SAT).

The idea of the switchable action dependency graph in a receding horizon (Berndt, van Duijkeren,
Palmieri, Kleiner & Keviczky, "Receding horizon re-ordering of multi-agent execution schedules",
IEEE T-RO 40, 2024; switchable edges also in Jiang et al., arXiv 2412.15908 and Su et al.,
2401.00315), here over the components of continuous obstacles. An order is changed only where no
robot is committed yet, and only if the new graph has no cycle and is forecast to be better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ortools.sat.python import cp_model

from up_samp.execution.build import steps_by, with_sides
from up_samp.execution.forecast import Forecast, routes_of
from up_samp.execution.graph import At, Event, Graph
from up_samp.execution.meetings import Meeting
from up_samp.execution.reduce import MEETING
from up_samp.execution.sides import Key
from up_samp.execution.staircase import Step, steps_of, switched
from up_samp.execution.state import Phase, State
from up_samp.model import ProblemError

if TYPE_CHECKING:
    from up_samp.execution.executor import Executor

SCALE = 100
"""Ticks a second in the model."""

REACTION = 0.5
"""Seconds that pass before a robot obeys a new command."""

WORTH = 0.5
"""A new order has to save so many seconds of makespan (or four times that in all ends)."""


@dataclass(frozen=True)
class Choice:
    """A component that may be passed on either side: its steps on both."""

    key: Key
    one_first: bool
    """The side on which it is passed so far."""
    steps: Mapping[bool, tuple[Step, ...]]


def reorder(
    executor: Executor, *, horizon: float = 60.0, seconds: float = 0.3, most: int = 60
) -> int:
    """Change who goes first where that is forecast to end sooner; return how many orders changed.

    Decisions that come up within ``horizon`` s are looked at, the ``most`` earliest of them, for
    up to
    ``seconds`` s of the solver's deterministic time. What has begun is not touched.
    """
    before = executor.retime()
    choices = _choices(executor, before, horizon, most)
    if not choices:
        return 0
    chosen = _solve(executor, before, choices, seconds)
    flips = {c.key: chosen[c.key] for c in choices if chosen.get(c.key, c.one_first) != c.one_first}
    if not flips:
        return 0
    old_graph, old_sides = executor.state.graph, dict(executor.sides)
    try:
        graph = with_sides(executor.dependencies, {**executor.sides, **flips})
    except ProblemError:
        return 0  # it would have opened a cycle
    _load(executor, graph)
    after = executor.retime()
    if not _better(before, after):
        _load(executor, old_graph)
        executor.sides = old_sides
        return 0
    executor.sides = {**executor.sides, **flips}
    return len(flips)


def _load(executor: Executor, graph: Graph) -> None:
    executor.state.load(graph)
    executor.routes = routes_of(graph, executor.state.ways)


def _better(before: Forecast, after: Forecast) -> bool:
    def ends(f: Forecast) -> float:
        return sum(f.span(name)[1] for name in f.graph.tasks)

    saved = before.makespan - after.makespan
    return saved > WORTH or (saved > -1e-3 and ends(before) - ends(after) > 4 * WORTH)


def _choices(executor: Executor, ahead: Forecast, horizon: float, most: int) -> list[Choice]:
    """Return the open decisions, those that come up first."""
    state = executor.state
    found: list[tuple[float, Choice]] = []
    parts: dict[Key, list[Meeting]] = {}
    for meeting in executor.dependencies.meetings:
        if all(_over(state, p) for p in (meeting.a, meeting.b)):
            continue
        for component in meeting.components:
            key = (*meeting.pair, component)
            if key in executor.open_sides:
                parts.setdefault(key, []).append(meeting)
    for key, meetings in parts.items():
        steps = {
            side: tuple(s for m in meetings for s in switched(m, key[2], side))
            for side in (True, False)
        }
        now_first = executor.sides.get(key, executor.open_sides[key])
        due = min(
            (ahead.span(s.then.activity)[0] for side in steps.values() for s in side),
            default=math.inf,
        )
        open_ = all(_can_wait(state, s) for s in steps[not now_first])
        if (
            open_
            and due <= state.now + horizon
            and any(not _happened(state, s.first) for s in steps[now_first])
        ):
            found.append((due, Choice(key, now_first, steps)))
    found.sort(key=lambda f: (f[0], f[1].key))
    return [choice for _, choice in found[:most]]


def _over(state: State, piece: object) -> bool:
    activity = getattr(piece, "activity", None)
    return activity is not None and state.phase[activity] is Phase.DONE


def _happened(state: State, event: Event) -> bool:
    if event in state.fired:
        return True
    if event.at is At.REACH:
        way = state.ways[event.activity, event.object]
        begun = state.phase[event.activity] is not Phase.WAITING
        return begun and way.progress >= event.progress - state.tolerance
    return False


def _can_wait(state: State, step: Step) -> bool:
    """Return whether a step can still be kept: its first has happened, or who waits can still
    stop.
    """
    if _happened(state, step.first):
        return True
    event = step.then
    if event.at is not At.LEAVE:
        return event not in state.fired
    phase = state.phase[event.activity]
    if phase is Phase.WAITING:
        return True
    if phase is Phase.DONE:
        return False
    way = state.ways[event.activity, event.object]
    speed = max(way.travel.speed_at(way.progress), way.travel.speed_at(way.progress + 0.5))
    brake = speed * speed / (2 * way.travel.accel) + speed * REACTION + 0.05
    # a robot at rest at a gate goes nowhere
    committed = min(way.progress + brake, state.until(way))
    return event.progress >= committed - 1e-9


class _Model:
    """Times of events to come as variables, in ticks from now."""

    def __init__(self, executor: Executor, ahead: Forecast):
        self.state, self.pace, self.ahead = executor.state, executor.pace, ahead
        self.model = cp_model.CpModel()
        span = max(ahead.makespan - self.state.now, 1.0)
        self.latest = int(4 * span * SCALE) + 1000
        self.times: dict[Event, cp_model.IntVar] = {}
        self.on_way: dict[tuple[str, str], list[Event]] = {}

    def time(self, event: Event) -> cp_model.IntVar:
        """Return the variable of an event that has not happened."""
        if event not in self.times:
            self.times[event] = self.model.new_int_var(0, self.latest, "")
            if event.at in (At.REACH, At.LEAVE):
                self.on_way.setdefault((event.activity, event.object), []).append(event)
        return self.times[event]

    def after(self, first: Event, then: Event, lag: float, only_if: cp_model.IntVar | None) -> None:
        """``then`` is at least ``lag`` s after ``first``, where ``only_if`` is true."""
        if _happened(self.state, then) or self._passed(then):
            return
        if _happened(self.state, first):
            since = self.state.fired.get(first, self.state.now)
            left = math.ceil((since + lag - self.state.now) * SCALE)
            if left <= 0:
                return
            found = self.model.add(self.time(then) >= left)
        else:
            found = self.model.add(self.time(then) >= self.time(first) + math.ceil(lag * SCALE))
        if only_if is not None:
            found.only_enforce_if(only_if)

    def _passed(self, event: Event) -> bool:
        if event.at is not At.LEAVE:
            return False
        way = self.state.ways[event.activity, event.object]
        begun = self.state.phase[event.activity] is not Phase.WAITING
        return begun and way.progress > event.progress + self.state.tolerance

    def chain(self) -> None:
        """Tie each activity's events together by the times that driving and doing take."""
        state = self.state
        for name, task in state.graph.tasks.items():
            if state.phase[name] is Phase.DONE:
                continue
            start, end = Event(At.START, name), Event(At.END, name)
            if not task.moves:
                begun = state.fired.get(start)
                if begun is None:
                    self.after(start, end, task.expected, None)
                else:
                    left = max(0.0, begun + task.expected - state.now)
                    self.model.add(self.time(end) >= math.ceil(left * SCALE))
            for way in state.ways_of[name]:
                self._drive((way.activity, way.object), start, end)

    def _drive(self, key: tuple[str, str], start: Event, end: Event) -> None:
        way = self.state.ways[key]
        pace = self.pace.get(way.object, 1.0)
        events = sorted(self.on_way.get(key, ()), key=lambda e: (e.progress, e.at is At.LEAVE))
        begun = self.state.phase[way.activity] is Phase.RUNNING
        here = way.travel.time_at(way.progress) if begun else 0.0
        last = None if begun else self.time(start)
        for event in [*events, end]:
            there = float(way.travel.time[-1])
            if event is not end:
                there = way.travel.time_at(event.progress)
            need = max(0, round((there - here) / pace * SCALE))
            at = self.time(event)
            self.model.add(at >= (need if last is None else last + need))
            last, here = at, there


def _solve(
    executor: Executor, ahead: Forecast, choices: list[Choice], seconds: float
) -> dict[Key, bool]:
    """Return who should go first, by component; empty where the solver found nothing in time."""
    state = executor.state
    build = _Model(executor, ahead)
    graph = with_choices_left_out(executor, {c.key for c in choices})
    for first, then, lag in graph:
        build.after(first, then, lag, None)
    literals = {}
    for choice in choices:
        literal = build.model.new_bool_var("")
        literals[choice.key] = literal
        for step in choice.steps[True]:
            build.after(step.first, step.then, 0.0, literal)
        for step in choice.steps[False]:
            build.after(step.first, step.then, 0.0, literal.negated())
        build.model.add_hint(literal, choice.one_first)
    build.chain()
    ends = [build.time(Event(At.END, n)) for n, p in state.phase.items() if p is not Phase.DONE]
    makespan = build.model.new_int_var(0, build.latest, "")
    build.model.add_max_equality(makespan, ends)
    weight = 10 * len(ends)
    build.model.minimize(weight * makespan + sum(ends))
    number = state.graph.number
    for event, variable in build.times.items():
        if event in number:
            at = ahead.times[number[event]] - state.now
            build.model.add_hint(variable, max(0, round(at * SCALE)))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = 0
    solver.parameters.max_deterministic_time = seconds
    solver.parameters.max_time_in_seconds = 5 * seconds
    status = solver.solve(build.model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return {}
    return {key: bool(solver.boolean_value(literal)) for key, literal in literals.items()}


def with_choices_left_out(executor: Executor, open_: set[Key]) -> list[tuple[Event, Event, float]]:
    """Return all edges (first, then, lag) but those of components that are open to choice."""
    graph = executor.dependencies.graph
    found = [
        (graph.events[e.first], graph.events[e.then], e.lag)
        for e in graph.edges
        if e.kind != MEETING
    ]
    for meeting in executor.dependencies.meetings:
        mine = {c for c in meeting.components if (*meeting.pair, c) in open_}
        if all(_over(executor.state, p) for p in (meeting.a, meeting.b)):
            continue
        sides = {
            (*meeting.pair, c): executor.sides[(*meeting.pair, c)]
            for c in meeting.components
            if (*meeting.pair, c) in executor.sides and c not in mine
        }
        if not mine:
            steps = steps_by(meeting, sides)
        else:
            changed = {k[2] for k in sides}
            steps = steps_of(meeting, without=mine | changed)
            for key, side in sides.items():
                steps += switched(meeting, key[2], side)
        found += [(s.first, s.then, 0.0) for s in steps]
    return found


class Reorderer:
    """Reorders when the predicted makespan has grown by more than ``threshold`` s since it last
    did, but not more often than every ``pause`` s.
    """

    def __init__(self, threshold: float = 1.5, pause: float = 4.0, horizon: float = 60.0):
        self.threshold, self.pause, self.horizon = threshold, pause, horizon
        self.known: float | None = None
        self.since = -math.inf

    def __call__(self, executor: Executor) -> int:
        """Look at the executor; return how many orders were changed."""
        ahead = executor.predicted_makespan()
        if self.known is None:
            planned = (t.planned[1] for t in executor.state.graph.tasks.values())
            self.known = min(ahead, max(planned, default=ahead))
        if ahead < self.known + self.threshold or executor.now < self.since + self.pause:
            return 0
        self.since = executor.now
        changed = reorder(executor, horizon=self.horizon)
        self.known = executor.predicted_makespan()
        return changed
