"""Times of events to come, tied by what driving and doing take and by who waits for whom; as
variables of CP-SAT no more of them than have to be told apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ortools.sat.python import cp_model

from up_samp.execution.decisions import Decision, Followed, happened, settled
from up_samp.execution.graph import At, Event, Precedence, topological
from up_samp.execution.state import Phase
from up_samp.model import ProblemError

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
        self.state, self.pace = executor.state, executor.pace
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

    def all_after(self, needs: Iterable[Precedence], only_if: int = 0) -> None:
        """State precedences, where ``only_if`` holds, but those that say nothing new.

        Of a staircase these are the first step, the last, and the one that holds the second robot
        back for longest when nothing else stops the two. The times are a forecast: what is decided
        by them is looked at again with the whole graph.
        """
        stairs: dict[tuple[str, str, str, str], list[Precedence]] = {}
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

    def _push(self, need: Precedence) -> float:
        """Return by how much later (s) than the first robot the second has to begin."""
        return self._driving(need.first) - self._driving(need.then)

    def _driving(self, event: Event) -> float:
        way = self.state.ways[event.activity, event.object]
        return way.travel.time_at(event.progress) / self.pace.get(way.object, 1.0)

    def after(self, need: Precedence, only_if: int = 0) -> None:
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
        way = self.state.ways[event.activity, event.object]
        begun = self.state.phase[event.activity] is not Phase.WAITING
        early = self.state.tolerance - self.state.localisation
        return begun and way.progress > event.progress + early

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
                    self.ties.append(Tie(NOW, self.event(end), math.ceil(left * SCALE), 0))
            for way in state.ways_of[name]:
                self._drive((way.activity, way.object), start, end)

    def _drive(self, key: tuple[str, str], start: Event, end: Event) -> None:
        way = self.state.ways[key]
        pace = self.pace.get(way.object, 1.0)
        events = sorted(self.on_way.get(key, ()), key=lambda e: (e.progress, e.at is At.LEAVE))
        begun = self.state.phase[way.activity] is Phase.RUNNING
        here = way.travel.time_at(way.progress) if begun else 0.0
        last = NOW if begun else self.event(start)
        for event in [*events, end]:
            there = way.travel.whole if event is end else way.travel.time_at(event.progress)
            number = self.event(event)
            ticks = max(0, round((there - here) / pace * SCALE))
            self.ties.append(Tie(last, number, ticks, 0))
            last, here = number, there

    # ------------------------------------------------------------------ what follows

    def earliest(self) -> list[int]:
        """Return the earliest time of each event, whatever is decided."""
        always = [t for t in self.ties if t.only_if == 0 and t.first != NOW]
        count = len(self.number)
        order = topological(count, [(t.first, t.then) for t in always], [0.0] * count)
        if order is None:
            raise ProblemError("the dependencies have a cycle: nobody could go first")
        after: list[list[Tie]] = [[] for _ in range(count)]
        low = [0] * count
        for tie in always:
            after[tie.first].append(tie)
        for tie in self.ties:
            if tie.only_if == 0 and tie.first == NOW:
                low[tie.then] = max(low[tie.then], tie.ticks)
        for k in order:
            for tie in after[k]:
                low[tie.then] = max(low[tie.then], low[k] + tie.ticks)
        return low

    def variables(
        self,
        model: cp_model.CpModel,
        low: list[int],
        latest: int,
        literals: list[cp_model.IntVar],
    ) -> list[cp_model.LinearExprT]:
        """Return the events' times in a model with all ties; ``literals`` are the decisions.

        What only follows one other event has that one's variable.
        """
        into: list[list[Tie]] = [[] for _ in low]
        for tie in self.ties:
            if tie.only_if or tie.first != NOW:
                into[tie.then].append(tie)
        always = [(t.first, t.then) for t in self.ties if t.only_if == 0 and t.first != NOW]
        found: list[cp_model.LinearExprT] = [0] * len(low)
        for k in topological(len(low), always, [0.0] * len(low)) or ():
            only = into[k][0] if len(into[k]) == 1 else None
            if only is not None and not only.only_if and low[k] == low[only.first] + only.ticks:
                found[k] = found[only.first] + only.ticks
            else:
                found[k] = model.new_int_var(min(low[k], latest), latest, "")
        for k, ties in enumerate(into):
            for tie in ties if isinstance(found[k], cp_model.IntVar) else ():
                first = 0 if tie.first == NOW else found[tie.first]
                stated = model.add(found[k] >= first + tie.ticks)
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
    left = [name for name, phase in executor.state.phase.items() if phase is not Phase.DONE]
    return times, [times.event(Event(At.END, name)) for name in left]
