"""Fluents over time: which effects happen when, and the value of every fluent at every instant.

The rules that are numbered in comments are those of ``docs/semantics.md``.
"""

from __future__ import annotations

import enum
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from unified_planning.model import TimepointKind

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.violation import Violation
from up_samp.validation.values import (
    MISSING,
    Decisions,
    Key,
    Reader,
    Value,
    chronicles,
    combinations,
)


class Reading(enum.Enum):
    """When an effect at ``t`` is seen: from ``t + 1`` on (PDDL 2.1, as aries does), or at ``t``."""

    LATER = "seen from t + 1 on"
    AT_ONCE = "seen at t"


@dataclass(frozen=True)
class Change:
    """An effect that happened: ``owner`` (an activity; ``None``: the problem) changed ``key``."""

    time: int
    key: Key
    owner: str | None
    what: str


@dataclass(frozen=True)
class _Event:
    """An effect with its time, before it is known whether it happens."""

    time: int
    owner: str | None
    effect: Any
    bindings: Mapping[str, Value]

    @property
    def what(self) -> str:
        return f"effect '{self.effect}' of {self.owner or 'the problem'} at {self.time}"


@dataclass
class StateTimeline:
    """Values of all ground fluents over time. Build it with :func:`build_timeline`."""

    problem: Any
    decisions: Decisions
    horizon: int = 0
    """The latest of all ends and effect times."""
    changes: list[Change] = field(default_factory=list)
    effect_reads: list[tuple[int, str | None, frozenset[Key], str]] = field(default_factory=list)
    """When, and for whom, an effect's condition and value looked at which other fluents, and what
    it is."""
    violations: list[Violation] = field(default_factory=list)
    _initial: dict[Key, Value] = field(default_factory=dict)
    _times: dict[Key, list[int]] = field(default_factory=lambda: defaultdict(list))
    _values: dict[Key, list[Value]] = field(default_factory=lambda: defaultdict(list))

    def initial(self, key: Key) -> Value:
        """Return the initial value of a ground fluent."""
        if key in self._initial:
            return self._initial[key]
        fluent = self.problem.fluent(key[0])
        default = self.problem.fluents_defaults.get(fluent)
        if default is None:
            raise ProblemError(f"fluent {show(key)} has no initial value")
        return constant(default)

    def value(self, key: Key, instant: int, reading: Reading) -> Value:
        """Return the value of a ground fluent at an instant."""
        times = self._times.get(key)
        if not times:
            return self.initial(key)
        if reading is Reading.LATER:
            index = bisect_left(times, instant)
        else:
            index = bisect_right(times, instant)
        return self._values[key][index - 1] if index else self.initial(key)

    def global_end(self, reading: Reading) -> int:
        """Return the instant that ``GlobalEnd`` means in conditions (rule 12)."""
        later = reading is Reading.LATER
        return self.horizon + self.decisions.instant if later else self.horizon

    def record(self, key: Key, time: int, value: Value) -> None:
        """Note that ``key`` has ``value`` after the effects at ``time`` (in order of time)."""
        self._times[key].append(time)
        self._values[key].append(value)


def build_timeline(problem: Any, decisions: Decisions) -> StateTimeline:
    """Let all effects of present activities and of the problem happen, in order of time."""
    timeline = StateTimeline(problem, decisions)
    for node, value in problem.explicit_initial_values.items():
        timeline._initial[(node.fluent().name, tuple(constant(a) for a in node.args))] = constant(
            value
        )
    events = _events(problem, decisions)
    timeline.horizon = max([decisions.makespan, *(e.time for e in events)], default=0)
    by_time: dict[int, list[_Event]] = defaultdict(list)
    for event in events:
        if event.time < 0:  # rule 6
            timeline.violations.append(
                Violation("effect-time", f"{event.what} comes before the initial state at 0")
            )
        by_time[event.time].append(event)
    for time in sorted(by_time):
        _happen(timeline, time, by_time[time])
    return timeline


def _events(problem: Any, decisions: Decisions) -> list[_Event]:
    placed: list[tuple[Any, Any, str | None]] = []
    for chronicle, owner in chronicles(problem, decisions):
        if chronicle.simulated_effects:
            raise UnsupportedError(f"simulated effects ({owner or 'the problem'})")
        for timing, effects in chronicle.effects.items():
            placed += [(timing, effect, owner) for effect in effects]
    from_end = [p for p in placed if p[0].timepoint.kind == TimepointKind.GLOBAL_END]
    others = [p for p in placed if p[0].timepoint.kind != TimepointKind.GLOBAL_END]
    events = [e for p in others for e in _expand(*p, decisions, 0)]
    last = max([decisions.makespan, *(e.time for e in events)], default=0)
    return events + [e for p in from_end for e in _expand(*p, decisions, last)]


def _expand(
    timing: Any, effect: Any, owner: str | None, decisions: Decisions, end: int
) -> Iterator[_Event]:
    time = decisions.timing(timing, owner, end)
    if time is MISSING:
        return
    if decisions.instant == 1 and not isinstance(time, int):
        raise UnsupportedError(f"effect at the fractional time {time}: '{effect}' of {owner}")
    if not (effect.is_assignment() or effect.is_increase() or effect.is_decrease()):
        raise UnsupportedError(f"continuous effect '{effect}' of {owner or 'the problem'}")
    for bindings in combinations(effect.forall, decisions.objects):
        yield _Event(time, owner, effect, bindings)


def _happen(timeline: StateTimeline, time: int, events: list[_Event]) -> None:
    """Apply the effects of one instant; all of them see the state before it (rule 6)."""
    assigned: dict[Key, list[tuple[_Event, Value]]] = defaultdict(list)
    added: dict[Key, list[tuple[_Event, Value]]] = defaultdict(list)
    for event in events:
        reader = Reader(
            timeline.decisions,
            lambda key: timeline.value(key, time, Reading.LATER),
            event.owner,
            event.bindings,
        )
        key = reader.key(event.effect.fluent)
        happens = reader.value(event.effect.condition)
        value = reader.value(event.effect.value)
        others = frozenset(reader.reads - {key})
        if others:
            timeline.effect_reads.append((time, event.owner, others, event.what))
        if key is None or happens is MISSING or value is MISSING:
            timeline.violations.append(
                Violation("effect-value", f"{event.what} uses a value that is not there")
            )
        elif happens:
            timeline.changes.append(Change(time, key, event.owner, event.what))
            if event.effect.is_assignment():
                assigned[key].append((event, value))
            else:
                added[key].append((event, -value if event.effect.is_decrease() else value))
    for key in [*assigned, *(k for k in added if k not in assigned)]:
        _settle(timeline, key, time, assigned.get(key, []), added.get(key, []))


def _settle(
    timeline: StateTimeline,
    key: Key,
    time: int,
    assigned: list[tuple[_Event, Value]],
    added: list[tuple[_Event, Value]],
) -> None:
    """Give ``key`` its value after the effects at ``time`` (rules 7 and 8)."""
    if len(assigned) > 1 or (assigned and added):
        names = " and ".join(event.what for event, _ in assigned + added)
        timeline.violations.append(
            Violation(
                "effect-conflict",
                f"{show(key)} is changed twice at {time}: {names}",
                about=(show(key),),
            )
        )
    value = assigned[-1][1] if assigned else timeline.value(key, time, Reading.LATER)
    value = value + sum(amount for _, amount in added) if added else value
    timeline.record(key, time, value)
    type_ = timeline.problem.fluent(key[0]).type
    if not in_type(value, type_, timeline.decisions.objects):
        names = ", ".join(event.what for event, _ in assigned + added)
        timeline.violations.append(
            Violation(
                "bounds",
                f"{show(key)} becomes {value}, outside {type_}, at {time}: {names}",
                about=(show(key),),
            )
        )


def in_type(value: Value, type_: Any, objects: Mapping[str, tuple[str, ...]]) -> bool:
    """Return whether a value belongs to a UP type (subtypes and bounds considered)."""
    if type_.is_bool_type():
        return isinstance(value, bool)
    if type_.is_user_type():
        return value in objects.get(type_.name, ())
    if isinstance(value, (bool, str)) or (type_.is_int_type() and not isinstance(value, int)):
        return False
    low, high = type_.lower_bound, type_.upper_bound
    return (low is None or value >= low) and (high is None or value <= high)


def constant(node: Any) -> Value:
    """Return the value of a constant UP expression (a number, a truth value or an object)."""
    reader = Reader(Decisions({}, {}, {}), lambda key: MISSING)
    value = reader.value(node)
    if value is MISSING:
        raise ProblemError(f"'{node}' is not a constant")
    return value


def show(key: Key) -> str:
    """Return a ground fluent for people: ``f(a, b)``."""
    return f"{key[0]}({', '.join(str(a) for a in key[1])})" if key[1] else key[0]
