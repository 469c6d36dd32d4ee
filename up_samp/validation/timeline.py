"""Values of expressions and fluents: what an expression is worth under a plan (Kleene's logic for
what absent activities leave open), which effects happen when, and every fluent's value over time.

The rules that are numbered in comments are those of ``docs/semantics.md``.
"""

from __future__ import annotations

import enum
import itertools
import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, Final

from unified_planning.model import OperatorKind as Op
from unified_planning.model import Timepoint, TimepointKind

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.violation import Violation

MISSING: Final = object()
"""The value of a start, end or parameter of an absent activity, and of all that depends on it."""

Value = Any
"""``bool``, ``int``, ``Fraction``, an object's name, or ``MISSING``."""

Key = tuple[str, tuple[Value, ...]]
"""A ground fluent: its name and the values of its arguments."""


@dataclass(frozen=True)
class Decisions:
    """What a plan decides: ``times[name] = (start, end)`` of present activities only, values of
    the parameters that have one (by their full name), and the makespan.
    """

    times: Mapping[str, tuple[Value, Value]]
    parameters: Mapping[str, Value]
    objects: Mapping[str, tuple[str, ...]]
    """Names of the objects of each user type, subtypes included."""
    instant: Value = 1
    """How far apart two instants are (units): what was executed has times between the units."""

    @cached_property
    def makespan(self) -> int:
        """Latest end of a present activity (every timing asks for it)."""
        return max((end for _, end in self.times.values()), default=0)

    def timepoint(self, point: Any, owner: str | None, global_end: int) -> Value:
        """Return the time of a UP ``Timepoint``; one without a container belongs to ``owner``."""
        if point.kind == TimepointKind.GLOBAL_START:
            return 0
        if point.kind == TimepointKind.GLOBAL_END:
            return global_end
        name = point.container if point.container is not None else owner
        if name is None or name not in self.times:
            return MISSING
        return self.times[name][0 if point.kind == TimepointKind.START else 1]

    def timing(self, timing: Any, owner: str | None, global_end: int) -> Value:
        """Return the time of a UP ``Timing`` (a timepoint and a delay), or of a bare timepoint, as
        scripts write it in intervals.
        """
        if isinstance(timing, Timepoint):
            return self.timepoint(timing, owner, global_end)
        base = self.timepoint(timing.timepoint, owner, global_end)
        return MISSING if base is MISSING else plain(base + timing.delay)


@dataclass
class Reader:
    """Evaluates expressions. ``fluent`` gives the value of a ground fluent (at the instant that
    the caller has in mind); ``reads`` collects the ground fluents that were looked at. ``hasty``
    readers leave out what cannot change a disjunction or conjunction, and do not collect all.
    """

    decisions: Decisions
    fluent: Callable[[Key], Value]
    owner: str | None = None
    bindings: Mapping[str, Value] = field(default_factory=dict)
    reads: set[Key] = field(default_factory=set)
    hasty: bool = False

    def value(self, node: Any) -> Value:
        """Return the value of a UP expression."""
        kind = node.node_type
        if kind in _LEAVES:
            return _LEAVES[kind](self, node)
        if kind in (Op.OR, Op.AND) and self.hasty:
            return _joined(map(self.value, node.args), kind == Op.OR)
        if kind in _OPERATORS:
            return _OPERATORS[kind]([self.value(a) for a in node.args])
        raise UnsupportedError(f"the validator does not know the operator {kind.name} in '{node}'")

    def key(self, node: Any) -> Key | None:
        """Return the ground fluent that a fluent expression means (None: unknown arguments)."""
        arguments = tuple(self.value(a) for a in node.args)
        return None if MISSING in arguments else (node.fluent().name, arguments)

    def told(self, node: Any) -> Value:
        """Return the value of a fluent expression, and note that it was read."""
        key = self.key(node)
        if key is None:
            return MISSING
        self.reads.add(key)
        return self.fluent(key)

    def quantified(self, node: Any) -> Value:
        """Return the value of an expression about all, or some, values of variables."""
        values = []
        for bindings in combinations(node.variables(), self.decisions.objects):
            inner = replace(self, bindings={**self.bindings, **bindings})
            values.append(inner.value(node.args[0]))
        return _joined(values, node.node_type == Op.EXISTS)


def chronicles(problem: Any, decisions: Decisions) -> list[tuple[Any, str | None]]:
    """Return what says something in a plan: the problem, and its present activities by name."""
    present = [(a, a.name) for a in problem.activities if a.name in decisions.times]
    return [(problem._base, None), *present]


def parts_of(node: Any) -> Iterator[Any]:
    """Yield an expression and all that it is made of."""
    stack = [node]
    while stack:
        item = stack.pop()
        stack += item.args
        yield item


def plain(number: Any) -> Value:
    """Return an integral ``Fraction`` as ``int``, anything else unchanged."""
    if number.__class__ is int:  # the most common, and asking for Fraction is slow
        return number
    if isinstance(number, Fraction) and number.denominator == 1:
        return int(number)
    return number


def domain(type_: Any, objects: Mapping[str, tuple[str, ...]]) -> list[Value]:
    """Return all values of a finite UP type."""
    if type_.is_bool_type():
        return [False, True]
    if type_.is_user_type():
        return list(objects.get(type_.name, ()))
    if type_.is_int_type() and type_.lower_bound is not None and type_.upper_bound is not None:
        return list(range(type_.lower_bound, type_.upper_bound + 1))
    raise UnsupportedError(f"the validator cannot quantify over the infinite type {type_}")


def combinations(variables: Any, objects: Mapping[str, tuple[str, ...]]) -> list[dict[str, Value]]:
    """Return all ways to bind quantified UP variables to values of their types."""
    found: list[dict[str, Value]] = [{}]
    for variable in variables:
        values = domain(variable.type, objects)
        pairs = itertools.product(found, values)
        found = [{**old, variable.name: value} for old, value in pairs]
    return found


def _joined(values: Iterable[Value], decides: bool) -> Value:
    """Return the value of a disjunction (``decides``: true) or conjunction (false); what comes
    after a value that decides it is not asked for.
    """
    result: Value = not decides
    for value in values:
        if value is decides:
            return decides
        if value is MISSING:
            result = MISSING
    return result


def _not(value: Value) -> Value:
    return MISSING if value is MISSING else not value


def _strict(function: Callable[..., Value]) -> Callable[[list[Value]], Value]:
    """Return ``function`` of all values, missing as soon as one of them is."""
    return lambda values: MISSING if MISSING in values else plain(function(*values))


_LEAVES: dict[Any, Callable[[Reader, Any], Value]] = {
    **dict.fromkeys(
        (Op.BOOL_CONSTANT, Op.INT_CONSTANT, Op.REAL_CONSTANT),
        lambda _, node: plain(node.constant_value()),
    ),
    Op.OBJECT_EXP: lambda _, node: node.object().name,
    Op.PARAM_EXP: lambda r, node: r.decisions.parameters.get(node.parameter().name, MISSING),
    Op.VARIABLE_EXP: lambda r, node: r.bindings[node.variable().name],
    Op.PRESENT_EXP: lambda r, node: node.presence().container in r.decisions.times,
    Op.TIMING_EXP: lambda r, n: r.decisions.timing(n.timing(), r.owner, r.decisions.makespan),
    Op.FLUENT_EXP: Reader.told,
    Op.EXISTS: Reader.quantified,
    Op.FORALL: Reader.quantified,
}
"""What is read by itself, not from the values of its parts."""

_OPERATORS: dict[Any, Callable[[list[Value]], Value]] = {
    Op.AND: lambda v: _joined(v, False),
    Op.OR: lambda v: _joined(v, True),
    Op.NOT: lambda v: _not(v[0]),
    Op.IMPLIES: lambda v: _joined([_not(v[0]), v[1]], True),
    Op.IFF: _strict(lambda a, b: a == b),
    Op.EQUALS: _strict(lambda a, b: a == b),
    Op.LE: _strict(lambda a, b: a <= b),
    Op.LT: _strict(lambda a, b: a < b),
    Op.PLUS: _strict(lambda *v: sum(v)),
    Op.MINUS: _strict(lambda a, b: a - b),
    Op.TIMES: _strict(lambda *v: math.prod(v)),
    Op.DIV: _strict(lambda a, b: Fraction(a) / Fraction(b)),
}


def telling(given: Any, item: Any) -> Any:
    """Return the expression for a listed obstacle: ``at`` means ``at(item)`` (rule 19)."""
    if getattr(given, "arity", 0) == 1 and given.signature[0].type.is_compatible(item.type):
        return given(item)
    return item.environment.expression_manager.auto_promote(given)[0]


# ------------------ Fluents over time


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
        before = bisect_left if reading is Reading.LATER else bisect_right
        index = before(self._times.get(key, ()), instant)
        return self._values[key][index - 1] if index else self.initial(key)

    def global_end(self, reading: Reading) -> int:
        """Return the instant that ``GlobalEnd`` means in conditions (rule 12)."""
        later = reading is Reading.LATER
        return self.horizon + self.decisions.instant if later else self.horizon

    def record(self, key: Key, time: int, value: Value) -> None:
        """Note that ``key`` has ``value`` after the effects at ``time`` (in order of time)."""
        self._times[key].append(time)
        self._values[key].append(value)


def present_activities(problem: Any, timeline: StateTimeline) -> list[Any]:
    """Return the activities that the plan has."""
    return [a for a in problem.activities if a.name in timeline.decisions.times]


def reader_at(timeline: StateTimeline, instant: int, reading: Reading, owner: str | None) -> Reader:
    """Return what reads expressions of an activity (None: of nobody) at an instant."""
    return Reader(timeline.decisions, lambda k: timeline.value(k, instant, reading), owner)


def build_timeline(problem: Any, decisions: Decisions) -> StateTimeline:
    """Let all effects of present activities and of the problem happen, in order of time."""
    timeline = StateTimeline(problem, decisions)
    for node, value in problem.explicit_initial_values.items():
        key = node.fluent().name, tuple(map(constant, node.args))
        timeline._initial[key] = constant(value)
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
