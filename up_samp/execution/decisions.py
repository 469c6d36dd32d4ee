"""Who goes first: what is decided, and what of it is still open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from up_samp.execution.build import Dependencies, steps_by
from up_samp.execution.forecast import Forecast, Routes
from up_samp.execution.graph import At, Event, Precedence
from up_samp.execution.meetings import Meeting
from up_samp.execution.pace import Pace
from up_samp.execution.reduce import MEETING
from up_samp.execution.sides import Key
from up_samp.execution.staircase import Step, steps_of, switched
from up_samp.execution.state import Phase, State
from up_samp.model.execution_tuning import ExecutionTuning

REACTION = 0.5
"""Seconds that pass before a robot obeys a new command."""


class Followed(Protocol):
    """What the orders of a plan under way hang on: an executor is one."""

    dependencies: Dependencies
    state: State
    routes: Routes
    tuning: ExecutionTuning
    pace: Pace
    sides: dict[Key, bool]
    turned: frozenset[int]

    @property
    def now(self) -> float:
        """The latest time told (s)."""
        ...

    @property
    def open_sides(self) -> dict[Key, bool]:
        """The components that could be passed on either side, with the plan's side."""
        ...

    def retime(self) -> Forecast:
        """Return when everything happens as soon as possible from now on."""
        ...

    def predicted_makespan(self) -> float:
        """Return when the last activity will end (s)."""
        ...

    def reorder(self) -> int:
        """Decide again who goes first, at once; return how many decisions changed."""
        ...


@dataclass(frozen=True)
class Decision:
    """Something that may be one way (``True``) or the other: the side of a component (``True``: the
    pair's first object goes first), or a choice by its number (``True``: as planned).
    """

    key: Key | int
    now: bool
    """How it is so far."""
    needs: Mapping[bool, tuple[Precedence, ...]]


def open_decisions(
    executor: Followed, ahead: Forecast, horizon: float, most: int
) -> list[Decision]:
    """Return the ``most`` open decisions that come up first, within ``horizon`` s."""
    found = [*_components(executor), *_choices(executor)]
    timed = []
    for decision in found:
        times = [ahead.span(p.then.activity)[0] for needs in decision.needs.values() for p in needs]
        due = min(times, default=math.inf)
        if due <= executor.now + horizon and _is_open(executor.state, decision):
            timed.append((due, str(decision.key), decision))
    timed.sort(key=lambda t: t[:2])
    return [decision for _, _, decision in timed[:most]]


def _components(executor: Followed) -> list[Decision]:
    parts: dict[Key, list[Meeting]] = {}
    for meeting in executor.dependencies.meetings:
        if _over(executor.state, meeting):
            continue
        for component in meeting.components:
            key = (*meeting.pair, component)
            if key in executor.open_sides:
                parts.setdefault(key, []).append(meeting)
    found = []
    for key, meetings in parts.items():
        needs = {
            side: tuple(_need(s) for m in meetings for s in switched(m, key[2], side))
            for side in (True, False)
        }
        found.append(Decision(key, executor.sides.get(key, executor.open_sides[key]), needs))
    return found


def _choices(executor: Followed) -> list[Decision]:
    return [
        Decision(k, k not in executor.turned, {True: (c.ways[0],), False: (c.ways[1],)})
        for k, c in enumerate(executor.dependencies.choices)
    ]


def _is_open(state: State, decision: Decision) -> bool:
    """Return whether it can still be the other way, and is not settled by what has happened."""
    other = all(can_wait(state, p) for p in decision.needs[not decision.now])
    return other and any(not happened(state, p.first) for p in decision.needs[decision.now])


def _need(step: Step) -> Precedence:
    return Precedence(step.first, step.then, 0.0)


def _over(state: State, meeting: Meeting) -> bool:
    names = (getattr(piece, "activity", None) for piece in (meeting.a, meeting.b))
    return all(name is not None and state.phase[name] is Phase.DONE for name in names)


def happened(state: State, event: Event) -> bool:
    """Return whether an event has happened, also one that the graph does not watch."""
    if event in state.fired:
        return True
    if event.at is At.REACH:
        return state.reached(state.ways[event.activity, event.object], event.progress)
    return False


def can_wait(state: State, need: Precedence) -> bool:
    """Return whether a precedence can still be kept: its first has happened, or who waits can still
    stop.
    """
    if happened(state, need.first):
        return need.lag <= 0.0 or need.then not in state.fired
    event = need.then
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
    return max(0.0, event.progress - state.localisation) >= committed - 1e-9


def settled(executor: Followed, open_: set[Key | int]) -> list[Precedence]:
    """Return all precedences but those of the decisions ``open_``."""
    graph = executor.dependencies.graph
    found = [
        Precedence(graph.events[e.first], graph.events[e.then], e.lag)
        for e in graph.edges
        if e.kind != MEETING and not e.free
    ]
    for k, choice in enumerate(executor.dependencies.choices):
        if k not in open_:
            found.append(choice.ways[int(k in executor.turned)])
    for meeting in executor.dependencies.meetings:
        if _over(executor.state, meeting):
            continue
        mine = {c for c in meeting.components if (*meeting.pair, c) in open_}
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
        found += [_need(s) for s in steps]
    return found
