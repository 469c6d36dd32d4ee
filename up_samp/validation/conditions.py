"""Conditions of a schedule, and interference: nobody changes what another one reads or writes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from up_samp.model import UnsupportedError
from up_samp.model.violation import Violation
from up_samp.validation.timeline import (
    Change,
    Reading,
    StateTimeline,
    show,
)
from up_samp.validation.values import MISSING, Reader, chronicles, parts_of, telling


@dataclass(frozen=True)
class _Condition:
    """A timed condition of an activity (``owner``) or of the problem, over integer instants.

    ``seen`` is the last instant whose value it needs: ``last + 1`` for a half-open interval, in
    whose last unit an effect at ``last`` is seen.
    """

    owner: str | None
    node: Any
    first: int
    last: int
    seen: int

    @property
    def what(self) -> str:
        over = f"at {self.first}" if self.first == self.last else f"over {self.first}..{self.last}"
        return f"condition '{self.node}' of {self.owner or 'the problem'} {over}"


def present_activities(problem: Any, timeline: StateTimeline) -> list[Any]:
    """Return the activities that the plan has."""
    return [a for a in problem.activities if a.name in timeline.decisions.times]


def reader_at(timeline: StateTimeline, instant: int, reading: Reading, owner: str | None) -> Reader:
    """Return what reads expressions of an activity (None: of nobody) at an instant."""
    return Reader(timeline.decisions, lambda k: timeline.value(k, instant, reading), owner)


def _timed_conditions(
    problem: Any, timeline: StateTimeline, reading: Reading
) -> Iterator[_Condition]:
    """Rules 10, 12 and 13: each condition with its first and last instant."""
    for chronicle, owner in chronicles(problem, timeline.decisions):
        for interval, nodes in chronicle.conditions.items():
            found = _instants(interval, owner, timeline, reading)
            if found is not None and found[0] <= found[1]:
                yield from (_Condition(owner, node, *found) for node in nodes)


def _instants(
    interval: Any, owner: str | None, timeline: StateTimeline, reading: Reading
) -> tuple[int, int, int] | None:
    """Return the first and last instant of an interval, and the last that is seen (``None``: it
    hangs on an absent one).
    """
    end = timeline.global_end(reading)
    first = timeline.decisions.timing(interval.lower, owner, end)
    last = timeline.decisions.timing(interval.upper, owner, end)
    if first is MISSING or last is MISSING:
        return None
    step = timeline.decisions.instant
    if step == 1 and not (isinstance(first, int) and isinstance(last, int)):
        raise UnsupportedError(f"fractional time in the condition interval {interval}")
    last -= interval.is_right_open() * step
    half_open = interval.is_right_open() and reading is Reading.LATER
    return first + interval.is_left_open() * step, last, last + half_open * step


def _new_values(timeline: StateTimeline, reading: Reading) -> dict[str, set[int]]:
    """Return for each fluent's name the instants at which a new value is seen first."""
    times_of: dict[str, set[int]] = defaultdict(set)
    for change in timeline.changes:
        later = reading is Reading.LATER
        seen = change.time + timeline.decisions.instant if later else change.time
        times_of[change.key[0]].add(seen)
    return times_of


def broken_conditions(
    problem: Any, timeline: StateTimeline, reading: Reading
) -> Iterator[Violation]:
    """Rule 9 and 10: every condition holds at every instant of its interval."""
    times_of = _new_values(timeline, reading)
    for condition in _timed_conditions(problem, timeline, reading):
        instant = _first_failure(condition, timeline, reading, times_of)
        if instant is not None:
            text = f"{condition.what} is false at {instant}"
            about = tuple(sorted(_fluents_in(condition.node)))
            yield Violation("condition", text, about=about)


def _first_failure(
    condition: _Condition,
    timeline: StateTimeline,
    reading: Reading,
    times_of: Mapping[str, set[int]],
    *,
    surely: bool = False,
) -> int | None:
    """Return the first instant at which a condition is false (``surely``: not true). Looking at the
    first instant and where a fluent that it mentions gets a new value is enough.
    """
    instants = {condition.first}
    for name in _fluents_in(condition.node):
        new = times_of.get(name, set())
        instants |= {t for t in new if condition.first < t <= condition.seen}
    for instant in sorted(instants):
        reader = reader_at(timeline, instant, reading, condition.owner)
        value = reader.value(condition.node)
        if value is False or (surely and value is not True):
            return instant
    return None


def holds_throughout(interval: Any, node: Any, timeline: StateTimeline, reading: Reading) -> bool:
    """Return whether an expression is true at every instant of a global time interval (of a
    half-open one as a condition: also what is seen in its last unit).
    """
    found = _instants(interval, None, timeline, reading)
    if found is None:
        return False
    if found[0] > found[1]:
        return True
    condition = _Condition(None, node, *found)
    new = _new_values(timeline, reading)
    return _first_failure(condition, timeline, reading, new, surely=True) is None


def interference(problem: Any, timeline: StateTimeline) -> Iterator[Violation]:
    """Rule 11: an activity's effects keep apart from what other activities read."""
    by_name: dict[str, list[Change]] = defaultdict(list)
    for change in timeline.changes:
        if change.owner is not None:
            by_name[change.key[0]].append(change)
    for condition in _timed_conditions(problem, timeline, Reading.LATER):
        if condition.owner is None:
            continue
        for name in sorted(_fluents_in(condition.node)):
            for change in by_name[name]:
                if change.owner == condition.owner:
                    continue
                if not condition.first <= change.time <= condition.last:
                    continue
                reader = reader_at(timeline, change.time, Reading.LATER, condition.owner)
                reader.value(condition.node)
                if change.key in reader.reads:
                    yield _clash(change, condition.what)
    yield from _other_interference(problem, timeline, by_name)


def _other_interference(
    problem: Any, timeline: StateTimeline, by_name: dict[str, list[Change]]
) -> Iterator[Violation]:
    """Rule 11 for what effects, durations and motions read."""
    readings = [(time, time, by, keys, what) for time, by, keys, what in timeline.effect_reads]
    step = timeline.decisions.instant
    for activity in present_activities(problem, timeline):
        start, end = timeline.decisions.times[activity.name]
        for first, last, told, nodes in _read_by(activity, start, end, step):
            reader = reader_at(timeline, first, Reading.LATER, activity.name)
            for node in nodes:
                reader.value(node)
            what = f"the {told} of {activity.name}, read at {first}"
            readings.append((first, last, activity.name, frozenset(reader.reads), what))
    for first, last, owner, keys, what in readings:
        for change in (c for key in sorted(keys, key=str) for c in by_name[key[0]]):
            read = first <= change.time <= last and change.key in keys
            if read and owner is not None and change.owner != owner:
                yield _clash(change, what)


def _read_by(
    activity: Any, start: Any, end: Any, step: Any
) -> Iterator[tuple[Any, Any, str, list[Any]]]:
    """Yield what an activity reads besides its conditions and effects, and from when to when (rules
    2, 14 and 19).
    """
    yield start, start, "duration", [activity.duration.lower, activity.duration.upper]
    for constraint in getattr(activity, "motion_constraints", ()):
        yield start, start, "motion", [constraint.starting, *constraint.waypoints]
        still = constraint.static_obstacles
        told = [telling(still[item], item) for item in still] if isinstance(still, dict) else []
        yield start, max(start, end - 2 * step), "static obstacles", told
    yield end, end, "motion effect", list(getattr(activity, "motion_effects", {}).values())


def _clash(change: Change, what: str) -> Violation:
    return Violation(
        "interference",
        f"{change.what} changes {show(change.key)}, which the {what.removeprefix('the ')} reads",
        about=(show(change.key),),
    )


def _fluents_in(node: Any) -> set[str]:
    """Return the names of all fluents that an expression mentions."""
    return {item.fluent().name for item in parts_of(node) if item.is_fluent_exp()}
