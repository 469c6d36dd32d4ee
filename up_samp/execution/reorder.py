"""Re-ordering on the floor: who goes first, decided again (a switchable dependency graph): what is
decided, what of it is still open, and when everything would happen then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

from ortools.sat.python import cp_model

from up_samp.execution.build import Dependencies, steps_by, with_sides
from up_samp.execution.graph import At, Edge, Event, Graph
from up_samp.execution.lives import Stay
from up_samp.execution.meetings import Component, Key, Meeting, switched
from up_samp.execution.state import FloorState, Forecast, TaskPhase, forecast
from up_samp.model import ProblemError


def planned_sides(dependencies: Dependencies) -> dict[Component, bool]:
    """Return the components that could be passed on either side, with the plan's side."""
    found = {}
    for key, meetings in _parts(dependencies.meetings).items():
        sides = {bool(s) for m in meetings for s in m.one_first[m.component == key[2]]}
        if len(sides) == 1 and all(_free(m) for m in meetings):
            found[key] = sides.pop()
    return found


def _parts(meetings: Iterable[Meeting]) -> dict[Component, list[Meeting]]:
    """Return the meetings that each component is part of."""
    parts: dict[Component, list[Meeting]] = {}
    for meeting in meetings:
        for component in meeting.components:
            parts.setdefault((*meeting.pair, component), []).append(meeting)
    return parts


def _free(meeting: Meeting) -> bool:
    """Return whether a meeting fixes no side by itself: no rest without beginning or end, nothing
    that is put elsewhere, no body that cannot wait on its way.
    """
    for life, piece in ((meeting.one, meeting.a), (meeting.other, meeting.b)):
        if life.body.mobility.own_law or not life.drives:
            return False
        if isinstance(piece, Stay) and (
            math.isinf(piece.since) or math.isinf(piece.until) or piece.enter or piece.leave
        ):
            return False
    return True


# ------------------ Who goes first: what is decided, and what of it is still open


_EFFORT = 0.3
"""CP-SAT's deterministic time for one look at them."""
_MOST = 60
"""Decisions that are looked at, the earliest ones."""
WORTH = 0.5
"""s by which all has to be over sooner, or what ends have to cost less."""


class Goal(NamedTuple):
    """What an activity's end costs: ``weight`` for each second until then, and ``late`` for each
    one after ``due`` (s).
    """

    weight: float
    late: float
    due: float


class Followed:
    """What the orders of a plan under way hang on: an executor is one."""

    dependencies: Dependencies
    state: FloorState
    sides: dict[Key, bool]
    """What was decided anew."""
    goals: Mapping[str, Goal] = MappingProxyType({})
    """The activities whose ends count (none: the last end of all counts)."""
    lead: float = 0.0
    """Seconds that pass before an order that is decided now is followed."""
    horizon: float = 60.0
    """For how many seconds ahead decisions are looked at."""
    ahead: float | None = None
    """For how many seconds farther than they can stand robots are let drive for good (None: what
    they are told can be taken back)."""

    @property
    def now(self) -> float:
        """The latest time told (s)."""
        return self.state.now

    @cached_property
    def open_sides(self) -> dict[Component, bool]:
        """The components that could be passed on either side, with the plan's side."""
        return planned_sides(self.dependencies)

    def retime(self) -> Forecast:
        """Return when everything happens as soon as possible from now on."""
        return forecast(self.state)


@dataclass(frozen=True)
class Decision:
    """Something that may be one way (``True``) or the other."""

    key: Key
    now: bool
    """How it is so far."""
    needs: Mapping[bool, tuple[Edge, ...]]


def open_decisions(executor: Followed, ahead: Forecast) -> list[Decision]:
    """Return the open decisions that come up first, within the executor's ``horizon``."""
    found = [*_components(executor), *_choices(executor)]
    timed = []
    for decision in found:
        times = [ahead.span(p.then.activity)[0] for needs in decision.needs.values() for p in needs]
        due = min(times, default=math.inf)
        if due <= executor.now + executor.horizon and _is_open(executor, ahead, decision):
            timed.append((due, str(decision.key), decision))
    timed.sort(key=lambda t: t[:2])
    return [decision for _, _, decision in timed[:_MOST]]


def _components(executor: Followed) -> list[Decision]:
    found = []
    to_come = (m for m in executor.dependencies.meetings if not _over(executor.state, m))
    for key, meetings in _parts(to_come).items():
        if key not in executor.open_sides:
            continue
        needs = {
            side: tuple(step for m in meetings for step in switched(m, key[2], side))
            for side in (True, False)
        }
        found.append(Decision(key, executor.sides.get(key, executor.open_sides[key]), needs))
    return found


def _choices(executor: Followed) -> list[Decision]:
    return [
        Decision(k, executor.sides.get(k, True), {True: c[:1], False: c[1:]})
        for k, c in enumerate(executor.dependencies.choices)
    ]


def _is_open(executor: Followed, ahead: Forecast, decision: Decision) -> bool:
    """Return whether it can still be the other way, and is not settled by what has happened."""
    state, needs = executor.state, decision.needs
    if not any(not happened(state, p.first) for p in needs[decision.now]):
        return False
    other = needs[not decision.now]
    return all(can_wait(state, p) and not _too_soon(executor, ahead, p) for p in other)


def _too_soon(executor: Followed, ahead: Forecast, need: Edge) -> bool:
    """Return whether who is to wait is past where it would wait before it can be told."""
    event, state = need.then, executor.state
    at = ahead.span(event.activity)[event.at is At.END]
    if event.at in (At.REACH, At.LEAVE):
        way = state.ways[event.activity, event.object]
        begun = state.phase[event.activity] is not TaskPhase.WAITING
        # who is under way may be at full speed from the point on where it counts
        brake = way.braked(way.travel.fastest) if begun else 0.0
        place = event.progress - way.error - brake - way.reach(executor.ahead)
        left = way.travel.time_at(max(0.0, place)) - state.driven(way)
        at = (state.now if begun else at) + left
    return at < state.now + executor.lead


def _over(state: FloorState, meeting: Meeting) -> bool:
    names = (meeting.a.activity, meeting.b.activity)
    return all(name and state.phase[name] is TaskPhase.DONE for name in names)


def happened(state: FloorState, event: Event) -> bool:
    """Return whether an event has happened, also one that the graph does not watch."""
    if event in state.fired:
        return True
    if event.at is At.REACH:
        return state.reached(state.ways[event.activity, event.object], event.progress)
    return False


def can_wait(state: FloorState, need: Edge) -> bool:
    """Return whether a precedence can still be kept: its first has happened, or who waits can still
    stop.
    """
    if happened(state, need.first):
        return need.lag <= 0.0 or need.then not in state.fired
    event = need.then
    if event.at is not At.LEAVE:
        return event not in state.fired
    phase = state.phase[event.activity]
    if phase is TaskPhase.WAITING:
        return True
    if phase is TaskPhase.DONE:
        return False
    way = state.ways[event.activity, event.object]
    return max(0.0, event.progress - way.error) >= state.committed(way) - 1e-9


def settled(executor: Followed, open_: set[Key]) -> list[Edge]:
    """Return all precedences but those of the decisions ``open_``."""
    found = [e for e in executor.dependencies.graph.edges if e.fixed]
    for k, (planned, other) in enumerate(executor.dependencies.choices):
        if k not in open_:
            found.append(planned if executor.sides.get(k, True) else other)
    for meeting in executor.dependencies.meetings:
        if _over(executor.state, meeting):
            continue
        mine = {c for c in meeting.components if (*meeting.pair, c) in open_}
        found += steps_by(meeting, executor.sides, mine)
    return found


# ------------------ Times of events to come
# They are tied by what driving and doing take and by who waits for whom; as variables of CP-SAT
# there are no more of them than have to be told apart.


SCALE = 100
"""Ticks a second in the model."""

NOW = -1
"""The number of an event that stands for now."""


class Tie(NamedTuple):
    """Event number ``then`` comes ``ticks`` after event number ``first`` or later, where
    ``only_if`` holds: 0 always, k + 1 where decision k is ``True``, -(k + 1) where it is not.
    """

    first: int
    then: int
    ticks: int
    only_if: int


class Times:
    """Times of events to come, in ticks from now."""

    def __init__(self, executor: Followed):
        self.state, self.pace = executor.state, executor.state.pace.shares
        self.number: dict[Event, int] = {}
        self.ties: list[Tie] = []
        self.on_way: dict[tuple[str, str], list[Event]] = {}

    def event(self, event: Event) -> int:
        """Return the number of an event that has not happened."""
        if event not in self.number:
            self.number[event] = len(self.number)
            if event.at in (At.REACH, At.LEAVE):
                self.on_way.setdefault((event.activity, event.object), []).append(event)
        return self.number[event]

    # ------------------------------------------------------------------ what is tied

    def all_after(self, needs: Iterable[Edge], only_if: int = 0) -> None:
        """State precedences, where ``only_if`` holds, but those that say nothing new.

        Of a staircase these are the first step, the last, and the one that holds the second robot
        back for longest when nothing else stops the two. The times are a forecast: what is decided
        by them is looked at again with the whole graph.
        """
        stairs: dict[tuple[str, str, str, str], list[Edge]] = {}
        for need in needs:
            first, then = need.first, need.then
            if first.at is At.REACH and then.at is At.LEAVE:
                key = (first.activity, first.object, then.activity, then.object)
                stairs.setdefault(key, []).append(need)
            else:
                self.after(need, only_if)
        for steps in stairs.values():
            steps.sort(key=lambda n: (n.then.progress, n.first.progress))
            for need in dict.fromkeys((steps[0], max(steps, key=self._push), steps[-1])):
                self.after(need, only_if)

    def _push(self, need: Edge) -> float:
        """Return by how much later (s) than the first robot the second has to begin."""
        return self._driving(need.first) - self._driving(need.then)

    def _driving(self, event: Event) -> float:
        way = self.state.ways[event.activity, event.object]
        return way.travel.time_at(event.progress) / self.pace.get(way.object, 1.0)

    def after(self, need: Edge, only_if: int = 0) -> None:
        """State a precedence, where ``only_if`` holds."""
        first, then, lag = need.first, need.then, need.lag
        if happened(self.state, then) or self._passed(then):
            return
        if happened(self.state, first):
            since = self.state.fired.get(first, self.state.now)
            left = math.ceil((since + lag - self.state.now) * SCALE)
            if left > 0:
                self.ties.append(Tie(NOW, self.event(then), left, only_if))
            return
        ticks = math.ceil(lag * SCALE)
        self.ties.append(Tie(self.event(first), self.event(then), ticks, only_if))

    def _passed(self, event: Event) -> bool:
        if event.at is not At.LEAVE:
            return False
        if self.state.phase[event.activity] is TaskPhase.WAITING:
            return False
        # who waits there may tell to be a little beyond: what counts is where it comes to anyhow
        way = self.state.ways[event.activity, event.object]
        place = max(0.0, event.progress - way.error) + self.state.tolerance
        return self.state.committed(way) > place

    def chain(self) -> None:
        """Tie each activity's events together by the times that driving and doing take."""
        state = self.state
        for name, task in state.graph.tasks.items():
            if state.phase[name] is TaskPhase.DONE:
                continue
            start, end = Event(At.START, name), Event(At.END, name)
            if not task.moves:
                self.after(Edge(start, end, task.expected))
            for way in state.ways_of[name]:
                self._drive((way.activity, way.object), start, end)

    def _drive(self, key: tuple[str, str], start: Event, end: Event) -> None:
        way = self.state.ways[key]
        pace = self.pace.get(way.object, 1.0)
        events = sorted(self.on_way.get(key, ()), key=lambda e: (e.progress, e.at is At.LEAVE))
        begun = self.state.phase[way.activity] is TaskPhase.RUNNING
        here = way.travel.time_at(way.progress) if begun else 0.0
        last = NOW if begun else self.event(start)
        gone = self.state.silent(way.object) if begun else 0.0
        for event in [*events, end]:
            there = way.travel.whole if event is end else way.travel.time_at(event.progress)
            number = self.event(event)
            ticks = max(0, round(((there - here) / pace - gone) * SCALE))
            self.ties.append(Tie(last, number, ticks, 0))
            last, here, gone = number, there, 0.0

    def variables(
        self, model: cp_model.CpModel, latest: int, literals: list[cp_model.IntVar]
    ) -> list[cp_model.LinearExprT]:
        """Return the events' times in a model with all ties; ``literals`` are the decisions."""
        found: list[cp_model.LinearExprT] = [model.new_int_var(0, latest, "") for _ in self.number]
        found.append(0)  # now's
        for tie in self.ties:
            stated = model.add(found[tie.then] >= found[tie.first] + tie.ticks)
            if tie.only_if:
                literal = literals[abs(tie.only_if) - 1]
                stated.only_enforce_if(literal if tie.only_if > 0 else literal.negated())
        return found


def tied(executor: Followed, decisions: Sequence[Decision]) -> tuple[Times, list[int]]:
    """Return the times of events to come with all their ties, those of ``decisions`` by what is
    decided, and the numbers of the ends to come.
    """
    times = Times(executor)
    times.all_after(settled(executor, {d.key for d in decisions}))
    for k, decision in enumerate(decisions):
        times.all_after(decision.needs[True], k + 1)
        times.all_after(decision.needs[False], -k - 1)
    times.chain()
    left = executor.state.those(TaskPhase.WAITING, TaskPhase.RUNNING)
    return times, [times.event(Event(At.END, name)) for name in left]


@dataclass(frozen=True)
class Proposal:
    """Another order: ``flips`` says how decisions are to be, and ``graph`` is what comes of them
    where ``base`` was decided before.
    """

    flips: Mapping[Key, bool]
    graph: Graph
    base: Mapping[Key, bool]


def propose(executor: Followed) -> Proposal | None:
    """Return an order that is forecast to end sooner than the present one, if one is found.

    The executor is used up: it is left with whatever order was tried last.
    """
    base = dict(executor.sides)
    before = executor.retime()
    decisions = open_decisions(executor, before)
    if not decisions:
        return None
    chosen = _solve(executor, before, decisions)
    flips = {d.key: chosen[d.key] for d in decisions if chosen.get(d.key, d.now) != d.now}
    if not flips:
        return None
    try:
        graph = with_sides(executor.dependencies, {**base, **flips})
    except ProblemError:  # it would have opened a cycle
        return None
    proposal = Proposal(flips, graph, base)
    return proposal if adopt(executor, proposal) else None


def settle(executor: Followed) -> None:
    """Decide who goes first where the plan leaves no order (``Dependencies.undecided``).

    Raises :class:`ProblemError` where no order is found.
    """
    ahead, open_ = executor.retime(), executor.dependencies.undecided
    some = (d for d in _components(executor) if d.key in open_)
    decisions = [d for d in some if _is_open(executor, ahead, d)]
    executor.sides |= _solve(executor, ahead, decisions)
    executor.state.load(with_sides(executor.dependencies, executor.sides))


def adopt(executor: Followed, proposal: Proposal) -> int:
    """Take over an order, if it still can be kept and still is better; return how many orders
    changed. Nothing that has begun is touched.
    """
    if proposal.base != executor.sides:
        return 0
    old, state = executor.state.graph, executor.state
    known = {(p.first, p.then, p.lag) for p in old.edges}
    for need in proposal.graph.edges:
        if (need.first, need.then, need.lag) not in known and not can_wait(state, need):
            return 0
    before = executor.retime()
    state.load(proposal.graph)
    if not _better(executor.goals, before, executor.retime()):
        state.load(old)
        return 0
    executor.sides = {**proposal.base, **proposal.flips}
    return len(proposal.flips)


def cost(goals: Mapping[str, Goal], ahead: Forecast) -> float:
    """Return what the ends that count cost by a forecast (no goals: the last end of all, s)."""
    if not goals:
        return ahead.makespan
    ends = ((goal, ahead.span(name)[1]) for name, goal in goals.items())
    return sum(g.weight * end + g.late * max(0.0, end - g.due) for g, end in ends)


def _better(goals: Mapping[str, Goal], before: Forecast, after: Forecast) -> bool:
    """Return whether ends cost ``WORTH`` less, and no deadline is missed by more."""
    less = cost(goals, before) - cost(goals, after) > WORTH
    return less and _missed(after) <= _missed(before) + 1e-3


def _missed(ahead: Forecast) -> float:
    """Return by how much (s) deadlines, windows and longest durations will be missed, in all."""
    return sum(max(0.0, ahead.over(bound)) for bound in ahead.graph.bounds)


def _value(
    executor: Followed,
    model: cp_model.CpModel,
    times: Times,
    found: list[cp_model.LinearExprT],
    latest: int,
) -> cp_model.LinearExprT:
    """Return what the ends that count cost, in a model of all times."""
    state = executor.state
    left = state.those(TaskPhase.WAITING, TaskPhase.RUNNING)
    ends = {name: found[times.event(Event(At.END, name))] for name in left}

    if not executor.goals:
        last = model.new_int_var(0, latest, "")
        for end in ends.values():
            model.add(last >= end)
        return 10 * len(ends) * last
    total: cp_model.LinearExprT = 0
    for name, goal in executor.goals.items():
        if name not in ends:
            continue
        total += round(10 * goal.weight) * ends[name]
        if goal.late:
            due = math.floor((goal.due - state.now) * SCALE)
            late = model.new_int_var(0, max(0, latest - due), "")
            model.add(late >= ends[name] - due)
            total += round(10 * goal.late) * late
    return total


def _solve(executor: Followed, ahead: Forecast, decisions: list[Decision]) -> dict[Key, bool]:
    """Return how each decision should be; empty where nothing better was found."""
    state = executor.state
    times, ends = tied(executor, decisions)
    # where other ends count, the last one may come later
    more = ahead.makespan - state.now if executor.goals else -WORTH
    latest = math.ceil((ahead.makespan + more - state.now) * SCALE)
    model = cp_model.CpModel()
    literals = [model.new_bool_var("") for _ in decisions]
    found = times.variables(model, latest, literals)
    model.minimize(_value(executor, model, times, found, latest) + sum(found[k] for k in ends))
    for literal, decision in zip(literals, decisions, strict=True):
        model.add_hint(literal, decision.now)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = 0
    solver.parameters.cp_model_probing_level = 0
    solver.parameters.linearization_level = 0
    solver.parameters.max_deterministic_time = _EFFORT
    status = solver.solve(model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return {}
    return {d.key: bool(solver.boolean_value(x)) for d, x in zip(decisions, literals, strict=True)}
