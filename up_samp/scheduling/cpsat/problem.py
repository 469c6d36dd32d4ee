"""What a scheduling problem holds, read once and then by what was appended."""

from __future__ import annotations

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
    whole: bool = True
    """Whether nothing was left out (see :func:`.routing.reduce.without`)."""
    vague: frozenset[str] = frozenset()
    """Activities of whose durations nothing is known but their constant bounds."""


class Watcher:
    """Remembers what of a problem has been seen, and tells what was appended."""

    def __init__(self, problem: SchedulingProblem) -> None:
        self.problem = problem
        self._constraints: dict[str | None, list[Any]] = {}
        self._conditions: dict[str | None, dict[TimeInterval, list[FNode]]] = {}
        self._effects: dict[str | None, dict[Timing, list[Effect]]] = {}
        self._durations: dict[str, Any] = {}
        self._parameters: dict[str | None, list[Any]] = {}
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
        key = None if activity is None else activity.name
        parameters = chronicle.parameters
        seen = self._parameters.get(key, [])
        if len(seen) != len(parameters):
            new.rewritten |= parameters[: len(seen)] != seen
            for parameter in parameters[len(seen) :]:
                if activity is None:
                    new.variables.append(parameter)
                else:
                    new.parameters.append((activity, parameter))
            self._parameters[key] = list(parameters)
        scoped = chronicle.scoped_constraints
        done = self._constraints.get(key, [])
        if any(a is not b[0] for a, b in zip(done, scoped, strict=False)) or len(done) > len(
            scoped
        ):
            new.rewritten = True
        new.constraints += [
            (self._written_out(c), [self._written_out(s) for s in scope], activity)
            for c, scope in scoped[len(done) :]
        ]
        self._constraints[key] = [c for c, _ in scoped]
        self._timed(self._conditions.setdefault(key, {}), chronicle.conditions, new, activity, True)
        self._timed(self._effects.setdefault(key, {}), chronicle.effects, new, activity, False)

    def _timed(
        self, seen: Any, now: Any, new: Additions, activity: Activity | None, is_cond: bool
    ) -> None:
        if any(t not in now for t in seen):
            new.rewritten = True
        for time, items in now.items():
            old = seen.get(time, [])
            if len(items) == len(old) and all(a is b for a, b in zip(items, old, strict=True)):
                continue
            if items[: len(old)] != old:
                new.rewritten = True
            target: list[Any] = new.conditions if is_cond else new.effects
            when = with_timings(time) if is_cond else time
            added = items[len(old) :]
            if is_cond:
                added = [self._written_out(c) for c in added]
            else:
                added = [each for effect in added for each in self._written_out.effects(effect)]
            target += [(when, item, activity) for item in added]
            seen[time] = list(items)

    def _duration(self, activity: Activity, new: Additions) -> None:
        duration = activity.duration
        old = self._durations.get(activity.name)
        if old is not duration:
            if old is not None and old != duration:
                new.durations.append(activity)
            self._durations[activity.name] = duration
