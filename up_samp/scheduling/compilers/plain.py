"""Scheduling problems as plain values: what the compilers work on.

A :class:`PlainProblem` says the same as a UP ``SchedulingProblem`` in tuples and names: it is
cheap to rewrite, to compare and to send to another process (:mod:`.expressions`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from up_samp.model import CandidateSchedule, UnsupportedError
from up_samp.scheduling.compilers.expressions import TRUE, Expr, Type, show


@dataclass(frozen=True)
class Activity:
    """An activity; ``lower`` and ``upper`` bound its duration (both included)."""

    name: str
    optional: bool
    lower: Expr
    upper: Expr
    parameters: tuple[tuple[str, Type], ...] = ()


@dataclass(frozen=True)
class Condition:
    """``expression`` holds at every instant of the closed interval ``[low, high]`` (two ``time``
    expressions; nothing is demanded where it is empty), if its ``owner`` is present. ``dense``:
    and until right before ``high + 1``.
    """

    low: Expr
    high: Expr
    expression: Expr
    owner: str | None = None
    dense: bool = False


@dataclass(frozen=True)
class Effect:
    """At ``time``: ``fluent`` is set to, increased or decreased by ``value`` (``kind`` is
    ``assign``, ``increase`` or ``decrease``) if ``condition`` holds and its ``owner`` is present.
    """

    time: Expr
    kind: str
    fluent: Expr
    value: Expr
    condition: Expr = TRUE
    owner: str | None = None


@dataclass(frozen=True)
class Fluent:
    """A fluent: its type, its parameters ``(name, type)`` and its default initial value."""

    type: Type
    parameters: tuple[tuple[str, Type], ...] = ()
    default: Expr | None = None


@dataclass(frozen=True)
class PlainProblem:
    """A scheduling problem. Constraints carry no scopes: they are written as implications.

    ``types`` maps a user type to its father, ``objects`` an object to its type, ``initial`` a
    ground fluent expression to its value where that is not the fluent's default.
    """

    name: str
    activities: tuple[Activity, ...]
    constraints: tuple[Expr, ...] = ()
    conditions: tuple[Condition, ...] = ()
    effects: tuple[Effect, ...] = ()
    variables: Mapping[str, Type] = field(default_factory=dict)
    types: Mapping[str, str | None] = field(default_factory=dict)
    objects: Mapping[str, str] = field(default_factory=dict)
    fluents: Mapping[str, Fluent] = field(default_factory=dict)
    initial: Mapping[Expr, Expr] = field(default_factory=dict)
    minimize_makespan: bool = False

    def activity(self, name: str) -> Activity:
        """Return the activity with this name."""
        for activity in self.activities:
            if activity.name == name:
                return activity
        raise KeyError(name)

    def optional_names(self) -> frozenset[str]:
        """Return the names of the optional activities."""
        return frozenset(a.name for a in self.activities if a.optional)

    def parameter_types(self) -> dict[str, Type]:
        """Return the type of every decision variable, by its full name."""
        types = dict(self.variables)
        for activity in self.activities:
            types.update(activity.parameters)
        return types

    def objects_of(self, user_type: str) -> list[str]:
        """Return the objects of a user type and of the types below it."""
        below = {user_type}
        grown = True
        while grown:
            more = {t for t, father in self.types.items() if father in below} - below
            grown = bool(more)
            below |= more
        return [name for name, t in self.objects.items() if t in below]

    def initial_value(self, fluent: Expr) -> Expr:
        """Return the initial value of a ground fluent expression."""
        value = self.initial.get(fluent, self.fluents[fluent[1]].default)
        if value is None:
            raise UnsupportedError(f"fluent {show(fluent)} has no initial value")
        return value


@dataclass(frozen=True)
class Compiled:
    """A compiled problem and the way back for its schedules.

    ``floor``: schedules of the compiled problem are never shorter than this even where the
    original's are, so an optimum at or below it proves nothing about the original.
    ``exact``: every schedule of the original has one in the compiled problem, of the same makespan
    (or ``floor``); otherwise neither "optimal" nor "unsolvable" carries over.
    """

    problem: PlainProblem
    map_back: Callable[[CandidateSchedule], CandidateSchedule] = lambda schedule: schedule
    floor: int = 0
    exact: bool = True
