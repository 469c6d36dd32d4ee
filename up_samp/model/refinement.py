"""What the scheduler is told after a motion check, as plain values.

A refinement is a statement about activities, which schedules satisfy (``holds``) or not.
``upio.write_refinements`` puts it into a UP problem. ``activities`` are those that a statement
speaks of.
"""

from __future__ import annotations

import enum
import itertools
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from up_samp.model.schedule import CandidateSchedule

Places = Callable[[str, int, int], Collection[str]]
"""``places(object, first, last)``: where the object's state is during [first, last] (units), if
it is set at the end of what moves it."""


class Strength(enum.Enum):
    """What a refinement is worth.

    ``PROVEN``: no valid plan breaks it. ``RELATIVE``: no plan breaks it whose motions are no faster
    than those that the motion planner takes for the fastest (the paper's relative optimality).
    ``HEURISTIC``: a search ran out of time, or robots meet; it may remove valid plans.
    """

    PROVEN = "proven"
    RELATIVE = "relative"
    HEURISTIC = "heuristic"


ABSOLUTE = "absolute"
RELATIVE = "relative to the motion planner's durations"
"""The kinds of bounds, as results and plan files tell them: of every valid plan, or
(:attr:`Strength.RELATIVE`) of those whose motions are no faster than the ones that were found.
"""


class Layer(enum.Enum):
    """Which check gave a refinement."""

    BOUND = "bound"
    GEOMETRIC = "geometric"
    TEMPORAL = "temporal"
    GROUP = "group"


@dataclass(frozen=True)
class TimeRef:
    """The start or end of an activity."""

    activity: str
    at_end: bool

    def of(self, times: Mapping[str, tuple[int, int]]) -> int:
        """Return when that is in a schedule (units)."""
        start, end = times[self.activity]
        return end if self.at_end else start

    def __str__(self) -> str:
        return f"{self.activity}.{'end' if self.at_end else 'start'}"


def start_of(activity: str) -> TimeRef:
    """Return the reference to an activity's start."""
    return TimeRef(activity, at_end=False)


def end_of(activity: str) -> TimeRef:
    """Return the reference to an activity's end."""
    return TimeRef(activity, at_end=True)


@dataclass(frozen=True)
class OfOne:
    """What is said of one activity."""

    activity: str

    @property
    def activities(self) -> tuple[str, ...]:
        """What it speaks of."""
        return (self.activity,)


@dataclass(frozen=True)
class Absent(OfOne):
    """The activity is not in the schedule."""

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        return self.activity not in schedule.times

    def __str__(self) -> str:
        return f"{self.activity} absent"


@dataclass(frozen=True)
class Apart:
    """``later - earlier >= at_least`` (schedule units), both activities present."""

    earlier: TimeRef
    later: TimeRef
    at_least: int

    @property
    def activities(self) -> tuple[str, ...]:
        """What it speaks of."""
        return self.earlier.activity, self.later.activity

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        times = schedule.times
        there = times.keys() >= set(self.activities)
        return there and self.later.of(times) - self.earlier.of(times) >= self.at_least

    def __str__(self) -> str:
        return f"{self.later} - {self.earlier} >= {self.at_least}"


@dataclass(frozen=True)
class Elsewhere(OfOne):
    """While ``activity`` lasts, ``object`` is not at ``configuration`` (the paper's CHCONF)."""

    object: str
    configuration: str

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        if self.activity not in schedule.times:
            return False
        start, end = schedule.times[self.activity]
        return self.configuration not in places(self.object, start + 1, end)

    def __str__(self) -> str:
        return f"{self.object} not at {self.configuration} during {self.activity}"


@dataclass(frozen=True)
class Overlap:
    """``rival`` is present and neither wholly before nor wholly after all of ``others``."""

    rival: str
    others: tuple[str, ...]

    @property
    def activities(self) -> tuple[str, ...]:
        """What it speaks of."""
        return self.rival, *self.others

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        times = schedule.times
        if not times.keys() >= set(self.activities):
            return False
        start, end = times[self.rival]
        others = [times[name] for name in self.others]
        return start <= max(e for _, e in others) and min(s for s, _ in others) <= end

    def __str__(self) -> str:
        return f"{self.rival} overlaps {', '.join(self.others)}"


@dataclass(frozen=True)
class Differs:
    """A decision variable (``activity.parameter``, or a variable's name) has another ``value``.

    What was found for a motion holds only for the configurations that it was asked with. Where
    these hang on decisions, every statement about it gives way when one of them differs.
    """

    variable: str
    value: str

    @property
    def activities(self) -> tuple[str, ...]:
        """What it speaks of."""
        return ()

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        return schedule.parameters.get(self.variable) != self.value

    def __str__(self) -> str:
        return f"{self.variable} is not {self.value}"


Given = tuple[tuple[str, str], ...]
"""The decisions (variable, value) that something was found for; none: it always holds."""

Literal = Absent | Apart | Elsewhere | Overlap | Differs


@dataclass(frozen=True)
class Clause:
    """At least one of the literals holds."""

    literals: tuple[Literal, ...]

    @property
    def activities(self) -> tuple[str, ...]:
        """What it speaks of."""
        return tuple(name for literal in self.literals for name in literal.activities)

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        return any(literal.holds(schedule, places) for literal in self.literals)

    def __str__(self) -> str:
        return " or ".join(str(x) for x in self.literals) or "false"


@dataclass(frozen=True)
class Lasts(OfOne):
    """If present, the activity lasts at least ``at_least`` units."""

    at_least: int

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        span = schedule.times.get(self.activity)
        return span is None or span[1] - span[0] >= self.at_least

    def __str__(self) -> str:
        return f"{self.activity} lasts at least {self.at_least}"


@dataclass(frozen=True)
class Requires(OfOne):
    """``object`` is not at ``configuration`` while ``activity`` lasts (changes at its very start
    and end do no harm, and nothing is asked of one that lasts one unit), or just ``at_end``.
    """

    object: str
    configuration: str
    at_end: bool = False

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""
        if self.activity not in schedule.times:
            return True
        start, end = schedule.times[self.activity]
        first, last = (end, end) if self.at_end else (start + 1, end - 1)
        return self.configuration not in places(self.object, first, last)

    def __str__(self) -> str:
        when = "in the end" if self.at_end else "all the time"
        return f"{self.activity} needs {self.object} away from {self.configuration} {when}"


@dataclass(frozen=True)
class Exclusive:
    """A unary place: at most one object rests at any of its configurations.

    ``arrivals`` are activities that bring an object there (at their end), ``departures`` those
    that take it away (at their start: it rests there until then); ``taken`` tells whether an
    object is there at first. ``leaving`` are departures, ``coming`` arrivals (activity, variable,
    value) only where the variable, which tells where they begin or end, has that value.
    """

    name: str
    arrivals: frozenset[str]
    departures: frozenset[str]
    taken: bool
    leaving: frozenset[tuple[str, str, str]] = frozenset()
    coming: frozenset[tuple[str, str, str]] = frozenset()

    def back_at(self, activity: str) -> int:
        """Return how long after the start of a departure the place is free again: at once for who
        may come back, at its end.
        """
        return 0 if activity in {*self.arrivals, *(name for name, _, _ in self.coming)} else 1

    @property
    def activities(self) -> tuple[str, ...]:
        """What it speaks of."""
        decided = (name for name, _, _ in (*self.leaving, *self.coming))
        return *self.arrivals, *self.departures, *decided

    def holds(self, schedule: CandidateSchedule, places: Places) -> bool:
        """Return whether a schedule satisfies it."""

        def moving(always: Iterable[str], some: Iterable[tuple[str, str, str]]) -> list[str]:
            told = schedule.parameters
            chosen = (name for name, variable, value in some if told.get(variable) == value)
            return [name for name in (*always, *chosen) if name in schedule.times]

        times = schedule.times
        changes = [(times[a][1], 1) for a in moving(self.arrivals, self.coming)]
        leaving = moving(self.departures, self.leaving)
        changes += [(times[a][0] + self.back_at(a), -1) for a in leaving]
        # at one time some go before others come
        levels = itertools.accumulate(
            (step for _, step in sorted(changes)), initial=int(self.taken)
        )
        return max(levels) <= 1

    def __str__(self) -> str:
        return f"place {self.name} holds one object"


Statement = Clause | Lasts | Requires | Exclusive


@dataclass(frozen=True)
class Refinement:
    """A statement with its reason: which check found it, what it is worth, whom it concerns."""

    statement: Statement
    layer: Layer
    strength: Strength
    why: str

    def __str__(self) -> str:
        return f"[{self.strength.value}, {self.layer.value}] {self.statement}  ({self.why})"
