"""Schedules as the loop sees them: plain names and integers, no UP objects."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

from up_samp.model.bodies import Configuration

Value = bool | int | str
"""Value of a decision variable: an object is given by its name."""


@dataclass(frozen=True)
class CandidateSchedule:
    """A schedule: ``times[name] = (start, end)`` for the activities that are present;
    ``parameters["activity.parameter"]`` (or the variable's name) for every decision variable.
    """

    times: Mapping[str, tuple[int, int]]
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def makespan(self) -> int:
        """Latest end of a present activity (0 when there is none)."""
        return max((end for _, end in self.times.values()), default=0)


class ScheduleStatus(enum.Enum):
    """What a scheduler's answer is worth. ``INFEASIBLE`` is a proof; ``NOT_FOUND`` is none."""

    OPTIMAL = "optimal"
    FOUND = "found"
    INFEASIBLE = "infeasible"
    NOT_FOUND = "not found"
    OUT_OF_TIME = "out of time"
    ERROR = "error"


@dataclass(frozen=True)
class ScheduleReport:
    """A scheduler's answer. ``bound``: a proven lower bound on what is minimised (the makespan, or
    the cost of an objective); ``cost``: what our own scheduler says that the schedule costs.
    ``late`` says of a schedule that it is the best at the deadline, and the search was not over.
    ``recognised`` and ``left_over`` tell which structures the scheduler found in the problem.
    ``handed_over`` tells what another engine was asked for, and what it answered.
    ``refuted`` tells of an error of ours: what was claimed at first, and was refuted.
    """

    status: ScheduleStatus
    schedule: CandidateSchedule | None = None
    bound: int | Fraction | None = None
    message: str = ""
    seconds: float = 0.0
    late: bool = False
    recognised: tuple[str, ...] = ()
    left_over: tuple[str, ...] = ()
    refuted: str = ""
    cost: int | Fraction | None = None
    handed_over: tuple[str, ...] = ()


@dataclass(frozen=True)
class ScheduledMotion:
    """A motion as a candidate schedule wants it: ``object`` drives ``configurations[0]`` through
    the others (names), in ``[start, end]`` (schedule units). ``given`` are the decisions (variable,
    value) that the configurations come from. ``loads`` travel with it (name, configuration at the
    end).
    """

    activity: str
    constraint: int
    object: str
    configurations: tuple[str, ...]
    poses: tuple[Configuration, ...]
    start: int
    end: int
    avoid: frozenset[str] | None = None
    given: tuple[tuple[str, str], ...] = ()
    loads: tuple[tuple[str, str], ...] = ()

    @cached_property
    def moved(self) -> frozenset[str]:
        """The object and what travels with it."""
        return frozenset(name for name, _ in self.brings)

    @property
    def brings(self) -> tuple[tuple[str, str], ...]:
        """The object and what travels with it, with where (configurations) they are in the end."""
        return (self.object, self.configurations[-1]), *self.loads


@dataclass(frozen=True)
class ScheduledChange:
    """An instantaneous change of an object's configuration at ``time``, at an activity's end.
    ``given``: as of a motion.
    """

    activity: str
    object: str
    configuration: str
    pose: Configuration
    time: int
    given: tuple[tuple[str, str], ...] = ()
