"""Building blocks of the lean encoding: who is where is told by fluents of robots.

What a schedule means, for every family:

- Activities occupy *closed* intervals of integer time. Two that need the same thing (a robot, a
  machine, a job) must not even touch: one ends strictly before the other starts (Definition 4 of
  the paper, where an activity uses its resources over ``[start, end]``).
- Therefore a move that ends at t lets the robot act from t + 1 on. That is also when PDDL 2.1 lets
  an effect at t be seen, and it satisfies Definition 3 (an effect at t is seen at t) as well: no
  schedule depends on which of the readings is taken, and both encodings have the same schedules.
- A robot's moves form a walk from its start; every move happens at most once.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Literal, TypeGuard

from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    FNode,
    GlobalEndTiming,
    TimePointInterval,
    Timing,
)
from unified_planning.model.motion import (
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MotionModels,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import LT, Equals, MovableType, Not, Or

from up_samp.benchmarks.places import (
    CAR,
    FamilyDoor,
    FamilyFloor,
    ProblemOnMap,
    duration_bounds,
)
from up_samp.benchmarks.published import PUBLISHED, Published
from up_samp.model import ProblemError

Encoding = Literal["lean"] | Published
"""``lean`` is built here, all others are the published forms."""
ENCODINGS: tuple[Encoding, ...] = (*PUBLISHED, "lean")


def is_published(encoding: Encoding) -> TypeGuard[Published]:
    """Return whether ``encoding`` is one of the published forms; raise where it is none at all."""
    check_encoding(encoding)
    return encoding != "lean"


def check_encoding(encoding: Encoding, known: Sequence[Encoding] = ENCODINGS) -> None:
    """Raise :class:`ProblemError` where there is no such encoding."""
    if encoding not in known:
        raise ProblemError(f"encoding must be one of {tuple(known)}, not {encoding!r}")


def before(a: Activity, b: Activity) -> FNode:
    """Return the constraint that ``a`` ends strictly before ``b`` starts."""
    return LT(a.end, b.start)


def at_start(a: Activity) -> TimePointInterval:
    """Return the instant at which ``a`` starts, as the time of a condition."""
    return TimePointInterval(Timing(0, a.start))


def scope_of(*activities: Activity) -> list[FNode]:
    """Return the scope "all these activities are present"."""
    return [a.present for a in activities if a.optional]


class Family(ProblemOnMap):
    """A problem under construction: map, robots, doors, moves, and the rules they share."""

    def __init__(self, name: str, floor: FamilyFloor, *, a_max: float, metric: bool) -> None:
        super().__init__(name, floor.yaml, metric=metric)
        self.floor = floor
        self.a_max = a_max
        self.robot_type = MovableType("robot")
        self.door_type = MovableType("door")
        self.robots: list[MovableObject] = []
        self.doors: list[MovableObject] = []
        self.busy: dict[str, list[Activity]] = {}
        self.door_at = Fluent("door_at", self.pose_type, door=self.door_type)
        self.robot_at = Fluent("robot_at", self.pose_type, robot=self.robot_type)
        self.problem.add_fluent(self.robot_at)

    def robot(self, name: str, start: ConfigurationObject) -> MovableObject:
        """Add a car that stands at ``start``."""
        limits = {**CAR, "a_max": self.a_max}
        robot = self.body(
            name,
            self.robot_type,
            self.floor.footprint,
            start,
            MotionModels.REEDSSHEPP,
            motion_parameters=limits,
        )
        self.problem.set_initial_value(self.robot_at(robot), start)
        self.robots.append(robot)
        self.busy[name] = []
        return robot

    def door(
        self, door: FamilyDoor, *, prefix: str
    ) -> tuple[MovableObject, ConfigurationObject, ConfigurationObject]:
        """Add a closed door; return it with its closed and its open configuration."""
        closed = self.place(f"{prefix}_closed", door.closed)
        opened = self.place(f"{prefix}_open", door.open)
        leaf = self.body(door.name, self.door_type, door.footprint, closed)
        self.doors.append(leaf)
        if len(self.doors) == 1:
            self.problem.add_fluent(self.door_at)
        self.problem.set_initial_value(self.door_at(leaf), closed)
        return leaf, closed, opened

    def move(
        self,
        robot: MovableObject,
        origin: ConfigurationObject,
        to: ConfigurationObject,
        name: str | None = None,
    ) -> MotionActivity:
        """Add the optional motion of ``robot`` from ``origin`` to ``to``, after all objects.

        Doors are its static obstacles, the other robots its dynamic ones.
        """
        a = self.problem.add_motion_activity(
            name or f"move_{robot.name}_{origin.name}_to_{to.name}", optional=True
        )
        a.set_duration_bounds(
            *duration_bounds(self.poses[origin.name], self.poses[to.name], self.a_max)
        )
        a.add_motion_constraint(
            ActivityWaypoints(
                robot,
                origin,
                [to],
                static_obstacles=list(self.doors),
                dynamic_obstacles_at_start=[r for r in self.robots if r is not robot],
            )
        )
        a.add_condition(at_start(a), Equals(self.robot_at(robot), origin))
        a.add_effect(a.end, self.robot_at(robot), to)
        self.busy[robot.name].append(a)
        return a

    def work(
        self, robot: MovableObject, name: str, place: ConfigurationObject, duration: int
    ) -> Activity:
        """Add something optional that ``robot`` does while it stands at ``place``."""
        a = self.problem.add_activity(name, duration=duration, optional=True)
        self._stand(robot, a, place)
        return a

    def _stand(self, robot: MovableObject, a: Activity, place: ConfigurationObject) -> None:
        """Let ``robot`` stand at ``place`` throughout ``a``, which it does."""
        throughout = ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))
        a.add_condition(throughout, Equals(self.robot_at(robot), place))
        self.busy[robot.name].append(a)

    def end(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """Let ``robot`` be at ``place`` when everything is over."""
        there = Equals(self.robot_at(robot), place)
        self.problem.add_condition(TimePointInterval(GlobalEndTiming()), there)

    def open_door(
        self,
        name: str,
        leaf: MovableObject,
        closed: ConfigurationObject,
        opened: ConfigurationObject,
        button: ConfigurationObject,
    ) -> None:
        """Let any robot that stands at ``button`` open the door, once and in 1 unit of time.

        The door's configuration changes at the activity's end: a motion effect without a motion
        constraint. A door that is open cannot be opened again.
        """
        for robot in self.robots:
            a = self.problem.add_motion_activity(f"{name}_{robot.name}", 1, optional=True)
            a.add_motion_effect(leaf, opened)
            a.add_condition(at_start(a), Equals(self.door_at(leaf), closed))
            a.add_effect(a.end, self.door_at(leaf), opened)
            self._stand(robot, a, button)

    def exactly_one(self, activities: Sequence[Activity]) -> None:
        """Exactly one of the optional ``activities`` is present."""
        self.problem.add_constraint(Or([a.present for a in activities]))
        for a, b in itertools.combinations(activities, 2):
            self.problem.add_constraint(Or(Not(a.present), Not(b.present)))

    def in_order(self, first: Iterable[Activity], then: Iterable[Activity]) -> None:
        """Every present activity of ``first`` ends before every present one of ``then`` starts."""
        for a, b in itertools.product(first, then):
            self.problem.add_constraint(before(a, b), scope=scope_of(a, b))

    def one_at_a_time(self, activities: Sequence[Activity]) -> None:
        """Keep all ``activities`` that are present apart."""
        for a, b in itertools.combinations(activities, 2):
            self.problem.add_constraint(Or(before(a, b), before(b, a)), scope=scope_of(a, b))

    def finish(self) -> SchedulingMotionProblem:
        """State that each robot does one thing at a time; return the problem."""
        for activities in self.busy.values():
            self.one_at_a_time(activities)
        return self.problem
