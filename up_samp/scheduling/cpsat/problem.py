"""What a scheduling problem holds, read once and then by what was appended."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.upio.expressions import QuantifierRemover
from up_samp.upio.spans import with_timings


@dataclass
class Additions:
    """What is new since the last look. ``activity`` is ``None`` for the problem's own parts."""

    activities: list[Activity] = field(default_factory=list)
    variables: list[Any] = field(default_factory=list)
    parameters: list[tuple[Activity, Any]] = field(default_factory=list)
    constraints: list[tuple[FNode, list[FNode], Activity | None]] = field(default_factory=list)
    conditions: list[tuple[TimeInterval, FNode, Activity | None]] = field(default_factory=list)
    effects: list[tuple[Timing, Effect, Activity | None]] = field(default_factory=list)
    durations: list[Activity] = field(default_factory=list)
    new_objects: bool = False
    rewritten: bool = False
    """Something was taken back or exchanged, not only appended."""


class Watcher:
    """Remembers what of a problem has been seen, and tells what was appended."""

    def __init__(self, problem: SchedulingProblem) -> None:
        self.problem = problem
        self._seen: dict[tuple[Any, ...], list[Any]] = {}
        """By whose it is (``None``: the problem's own), what it is, and when: what was seen."""
        self._durations: dict[str, Any] = {}
        self._activities: list[Activity] = []
        self._state: tuple[Any, ...] = ()
        self._written_out = QuantifierRemover(problem)

    def look(self) -> Additions:
        """Return what was appended since the last call (the first time: everything)."""
        new = Additions()
        known = len(self._activities)
        now = list(self.problem.activities)
        if [id(a) for a in now[:known]] != [id(a) for a in self._activities]:
            new.rewritten = True
        new.activities = now[known:]
        self._activities = now
        self._chronicle(None, self.problem._base, new)
        for activity in now:
            self._chronicle(activity, activity, new)
            self._duration(activity, new)
        state = (
            len(list(self.problem.all_objects)),
            len(self.problem.fluents),
            tuple(
                sorted((str(k), str(v)) for k, v in self.problem.explicit_initial_values.items())
            ),
            tuple(id(m) for m in self.problem.quality_metrics),
        )
        if self._state and state != self._state:
            new.new_objects = state[0] != self._state[0]
            new.rewritten |= state[2:] != self._state[2:]
        self._state = state
        return new

    def _chronicle(self, activity: Activity | None, chronicle: Any, new: Additions) -> None:
        name, put = None if activity is None else activity.name, self._written_out
        for parameter in self._appended((name, "parameters"), chronicle.parameters, new):
            if activity is None:
                new.variables.append(parameter)
            else:
                new.parameters.append((activity, parameter))
        constraints = self._appended((name, "constraints"), chronicle.scoped_constraints, new)
        new.constraints += [(put(c), [put(s) for s in scope], activity) for c, scope in constraints]
        for span, items in self._timed((name, "conditions"), chronicle.conditions, new):
            new.conditions += [(with_timings(span), put(c), activity) for c in items]
        for time, items in self._timed((name, "effects"), chronicle.effects, new):
            new.effects += [(time, each, activity) for e in items for each in put.effects(e)]

    def _timed(
        self, key: tuple[Any, ...], now: dict[Any, list[Any]], new: Additions
    ) -> Iterator[tuple[Any, list[Any]]]:
        """Yield what was appended at each time."""
        new.rewritten |= any(time not in now for time in self._seen.get(key, ()))
        self._seen[key] = list(now)
        for time, items in now.items():
            yield time, self._appended((*key, time), items, new)

    def _appended(self, key: tuple[Any, ...], now: list[Any], new: Additions) -> list[Any]:
        """Return what was appended to a list since it was looked at."""
        old = self._seen.get(key, [])
        new.rewritten |= now[: len(old)] != old
        self._seen[key] = list(now)
        return list(now[len(old) :])

    def _duration(self, activity: Activity, new: Additions) -> None:
        duration = activity.duration
        old = self._durations.get(activity.name)
        if old is not duration:
            if old is not None and old != duration:
                new.durations.append(activity)
            self._durations[activity.name] = duration
