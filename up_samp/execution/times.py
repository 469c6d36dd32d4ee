"""Times of events to come as variables of CP-SAT, tied by what driving and doing take."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ortools.sat.python import cp_model

from up_samp.execution.decisions import happened
from up_samp.execution.forecast import Forecast
from up_samp.execution.graph import At, Event, Precedence
from up_samp.execution.state import Phase

if TYPE_CHECKING:
    from up_samp.execution.executor import Executor

SCALE = 100
"""Ticks a second in the model."""


class Times:
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

    def after(self, need: Precedence, only_if: cp_model.BoolVarT | None = None) -> None:
        """State a precedence, where ``only_if`` is true."""
        first, then, lag = need.first, need.then, need.lag
        if happened(self.state, then) or self._passed(then):
            return
        if happened(self.state, first):
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
                    self.after(Precedence(start, end, task.expected))
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
