"""Building blocks of the families: who is where, said with fluents or with precedences.

What a schedule means, in both encodings and for every family:

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
from dataclasses import dataclass, field
from typing import Literal, Protocol

from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    FNode,
    GlobalEndTiming,
    TimePointInterval,
    Timing,
)
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionActivity,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import (
    LT,
    And,
    ConfigurationType,
    Equals,
    MinimizeMakespan,
    MovableType,
    Not,
    Or,
)

from up_samp.benchmarks.places import (
    ROBOT_FOOTPRINT,
    TURNING_RADIUS,
    V_MAX,
    Door,
    Pose,
    duration_bounds,
)
from up_samp.model import ProblemError

Encoding = Literal["fluents", "no-fluents"]
ENCODINGS: tuple[Encoding, ...] = ("fluents", "no-fluents")


def before(a: Activity, b: Activity) -> FNode:
    """Return that ``a`` ends strictly before ``b`` starts."""
    return LT(a.end, b.start)


def apart(a: Activity, b: Activity) -> FNode:
    """Return that ``a`` and ``b`` do not share even an instant."""
    return Or(before(a, b), before(b, a))


def at_start(a: Activity) -> TimePointInterval:
    """Return the instant at which ``a`` starts, as the time of a condition."""
    return TimePointInterval(Timing(0, a.start))


def throughout(a: Activity) -> ClosedTimeInterval:
    """Return ``[start, end]`` of ``a``, as the time of a condition."""
    return ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))


def scope_of(*activities: Activity) -> list[FNode]:
    """Return the scope "all these activities are present"."""
    return [a.present for a in activities if a.optional]


class Routes(Protocol):
    """Where robots are: one of the two encodings. Call ``finish`` after everything was told."""

    def start(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """``robot`` starts at ``place``."""

    def move(
        self,
        robot: MovableObject,
        a: Activity,
        origin: ConfigurationObject,
        to: ConfigurationObject,
    ) -> None:
        """``a`` takes ``robot`` from ``origin`` to ``to``."""

    def stand(self, robot: MovableObject, a: Activity, place: ConfigurationObject) -> None:
        """``robot`` stands at ``place`` throughout ``a``."""

    def end(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """``robot`` is at ``place`` when everything is over."""

    def finish(self) -> None:
        """State what could not be stated before all activities were known."""


class FluentRoutes:
    """``robot_at(robot)`` holds the place; moves change it at their end."""

    def __init__(self, problem: SchedulingMotionProblem, family: Family) -> None:
        self.problem = problem
        self.robot_at = Fluent("robot_at", family.pose_type, robot=family.robot_type)
        problem.add_fluent(self.robot_at)

    def start(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """See :class:`Routes`."""
        self.problem.set_initial_value(self.robot_at(robot), place)

    def move(
        self,
        robot: MovableObject,
        a: Activity,
        origin: ConfigurationObject,
        to: ConfigurationObject,
    ) -> None:
        """See :class:`Routes`."""
        a.add_condition(at_start(a), Equals(self.robot_at(robot), origin))
        a.add_effect(a.end, self.robot_at(robot), to)

    def stand(self, robot: MovableObject, a: Activity, place: ConfigurationObject) -> None:
        """See :class:`Routes`."""
        a.add_condition(throughout(a), Equals(self.robot_at(robot), place))

    def end(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """See :class:`Routes`."""
        self.problem.add_condition(
            TimePointInterval(GlobalEndTiming()), Equals(self.robot_at(robot), place)
        )

    def finish(self) -> None:
        """See :class:`Routes`."""


@dataclass
class _Itinerary:
    """What is known of one robot: arrivals and departures by place, and who needs a place."""

    start: str = ""
    end: str | None = None
    arrivals: dict[str, list[Activity]] = field(default_factory=dict)
    departures: dict[str, list[Activity]] = field(default_factory=dict)
    needs: list[tuple[Activity, str]] = field(default_factory=list)


class PrecedenceRoutes:
    """Places said with precedences alone (the paper's helper and deleter activities).

    Activity a of a robot needs place L at its start. Given that the robot's activities never
    overlap, either of these says so, and the shorter one is written:

    - *helpers and deleters*: the last helper (a move to L) before a is followed by no deleter (a
      move away from L) before a ends; at the robot's start, no deleter before a;
    - *nowhere else*: every move to another place that ends before a starts is followed by a move
      away from there that also ends before a starts.

    Why naming only the moves from L as deleters is enough: order the robot's moves in time. By
    induction the moves before a form a walk. If it has left L after the helper, one of them is a
    move from L; if it is elsewhere, its last arrival there has no later departure.
    """

    def __init__(self, problem: SchedulingMotionProblem, family: Family) -> None:
        self.problem = problem
        self.itineraries: dict[str, _Itinerary] = {}

    def _of(self, robot: MovableObject) -> _Itinerary:
        return self.itineraries.setdefault(robot.name, _Itinerary())

    def start(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """See :class:`Routes`."""
        self._of(robot).start = place.name

    def move(
        self,
        robot: MovableObject,
        a: Activity,
        origin: ConfigurationObject,
        to: ConfigurationObject,
    ) -> None:
        """See :class:`Routes`."""
        itinerary = self._of(robot)
        itinerary.departures.setdefault(origin.name, []).append(a)
        itinerary.arrivals.setdefault(to.name, []).append(a)
        itinerary.needs.append((a, origin.name))

    def stand(self, robot: MovableObject, a: Activity, place: ConfigurationObject) -> None:
        """See :class:`Routes`."""
        self._of(robot).needs.append((a, place.name))

    def end(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """See :class:`Routes`."""
        self._of(robot).end = place.name

    def finish(self) -> None:
        """See :class:`Routes`."""
        for itinerary in self.itineraries.values():
            for a, place in itinerary.needs:
                if self._helpers_are_shorter(itinerary, place):
                    formula = self._helped(itinerary, a, place)
                    self.problem.add_constraint(formula, scope=scope_of(a))
                else:
                    self._nowhere_else(itinerary, place, a)
            if itinerary.end is not None:
                self._nowhere_else(itinerary, itinerary.end, None)

    @staticmethod
    def _helpers_are_shorter(itinerary: _Itinerary, place: str) -> bool:
        def pairs(at: str) -> int:
            return len(itinerary.arrivals.get(at, ())) * len(itinerary.departures.get(at, ()))

        return pairs(place) <= sum(pairs(other) for other in itinerary.arrivals if other != place)

    @staticmethod
    def _helped(itinerary: _Itinerary, a: Activity, place: str) -> FNode:
        deleters = [x for x in itinerary.departures.get(place, ()) if x is not a]
        ways = []
        if place == itinerary.start:
            ways.append(And([Or(Not(x.present), before(a, x)) for x in deleters]))
        for h in itinerary.arrivals.get(place, ()):
            undisturbed = [Or(Not(x.present), before(x, h), before(a, x)) for x in deleters]
            ways.append(And([h.present, before(h, a), *undisturbed]))
        return Or(ways)

    def _nowhere_else(self, itinerary: _Itinerary, place: str, a: Activity | None) -> None:
        """State that the robot is at ``place`` at the start of ``a`` (``None``: in the end)."""

        def left_again(other: str, since: Activity | None) -> list[FNode]:
            ways = []
            for x in itinerary.departures.get(other, ()):
                after = [before(since, x)] if since is not None else []
                in_time = [before(x, a)] if a is not None else []
                ways.append(And([x.present, *after, *in_time]))
            return ways

        scope = scope_of(a) if a is not None else []
        if place != itinerary.start:
            self.problem.add_constraint(Or(left_again(itinerary.start, None)), scope=scope)
        for other, arrivals in itinerary.arrivals.items():
            for h in arrivals:
                if other != place and h is not a:
                    later = [before(a, h)] if a is not None else []
                    self.problem.add_constraint(
                        Or([*later, *left_again(other, h)]), scope=[*scope, *scope_of(h)]
                    )


class Family:
    """A problem under construction: map, robots, doors, moves, and the rules they share."""

    def __init__(
        self,
        name: str,
        map_yaml: str,
        *,
        a_max: float,
        encoding: Encoding,
        metric: bool,
    ) -> None:
        if encoding not in ENCODINGS:
            raise ProblemError(f"encoding must be one of {ENCODINGS}, not {encoding!r}")
        self.problem = SchedulingMotionProblem(name)
        self.a_max = a_max
        self.with_fluents = encoding == "fluents"
        occupancy = OccupancyMap(map_yaml, SE2(0.0, 0.0, 0.0))
        self.pose_type = ConfigurationType("pose", occupancy, ConfigurationKind.SE2)
        self.robot_type = MovableType("robot")
        self.door_type = MovableType("door")
        self.robots: list[MovableObject] = []
        self.doors: list[MovableObject] = []
        self.busy: dict[str, list[Activity]] = {}
        self._poses: dict[str, Pose] = {}
        self._door_at: Fluent | None = None
        self.routes: Routes = (FluentRoutes if self.with_fluents else PrecedenceRoutes)(
            self.problem, self
        )
        if metric:
            self.problem.add_quality_metric(MinimizeMakespan())

    def place(self, name: str, pose: Pose) -> ConfigurationObject:
        """Add a named configuration at ``pose`` (x, y, theta; m, rad; world frame)."""
        place = ConfigurationObject(name, self.pose_type, SE2(*pose))
        self.problem.add_object(place)
        self._poses[name] = pose
        return place

    def robot(self, name: str, start: ConfigurationObject) -> MovableObject:
        """Add a car that stands at ``start``."""
        robot = MovableObject(
            name,
            self.robot_type,
            footprint=list(ROBOT_FOOTPRINT),
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters={
                "turning_radius": TURNING_RADIUS,
                "v_max": V_MAX,
                "a_max": self.a_max,
            },
        )
        self.problem.add_object(robot)
        self.problem.set_initial_configuration(robot, start)
        self.routes.start(robot, start)
        self.robots.append(robot)
        self.busy[name] = []
        return robot

    def door(
        self, door: Door, *, prefix: str
    ) -> tuple[MovableObject, ConfigurationObject, ConfigurationObject]:
        """Add a closed door; return it with its closed and its open configuration."""
        leaf = MovableObject(
            door.name,
            self.door_type,
            footprint=list(door.footprint),
            motion_model=MotionModels.SE2,
        )
        closed = self.place(f"{prefix}_closed", door.closed)
        opened = self.place(f"{prefix}_open", door.open)
        self.problem.add_object(leaf)
        self.problem.set_initial_configuration(leaf, closed)
        self.doors.append(leaf)
        if self.with_fluents:
            if self._door_at is None:
                self._door_at = Fluent("door_at", self.pose_type, door=self.door_type)
                self.problem.add_fluent(self._door_at)
            self.problem.set_initial_value(self._door_at(leaf), closed)
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
            *duration_bounds(self._poses[origin.name], self._poses[to.name], self.a_max)
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
        self.routes.move(robot, a, origin, to)
        self.busy[robot.name].append(a)
        return a

    def work(
        self, robot: MovableObject, name: str, place: ConfigurationObject, duration: int
    ) -> Activity:
        """Add something optional that ``robot`` does while it stands at ``place``."""
        a = self.problem.add_activity(name, duration=duration, optional=True)
        self.routes.stand(robot, a, place)
        self.busy[robot.name].append(a)
        return a

    def open_door(
        self,
        name: str,
        leaf: MovableObject,
        closed: ConfigurationObject,
        opened: ConfigurationObject,
        button: ConfigurationObject,
    ) -> list[MotionActivity]:
        """Let any robot that stands at ``button`` open the door, once and in 1 unit of time.

        The door's configuration changes at the activity's end: a motion effect without a motion
        constraint. A door that is open cannot be opened again.
        """
        openings = []
        for robot in self.robots:
            a = self.problem.add_motion_activity(f"{name}_{robot.name}", 1, optional=True)
            a.add_motion_effect(leaf, opened)
            if self._door_at is not None:
                a.add_condition(at_start(a), Equals(self._door_at(leaf), closed))
                a.add_effect(a.end, self._door_at(leaf), opened)
            self.routes.stand(robot, a, button)
            self.busy[robot.name].append(a)
            openings.append(a)
        if not self.with_fluents:
            self.at_most_one(openings)
        return openings

    def at_most_one(self, activities: Sequence[Activity]) -> None:
        """At most one of the optional ``activities`` is present."""
        for a, b in itertools.combinations(activities, 2):
            self.problem.add_constraint(Or(Not(a.present), Not(b.present)))

    def exactly_one(self, activities: Sequence[Activity]) -> None:
        """Exactly one of the optional ``activities`` is present."""
        self.problem.add_constraint(Or([a.present for a in activities]))
        self.at_most_one(activities)

    def in_order(self, first: Iterable[Activity], then: Iterable[Activity]) -> None:
        """Every present activity of ``first`` ends before every present one of ``then`` starts."""
        for a, b in itertools.product(first, then):
            self.problem.add_constraint(before(a, b), scope=scope_of(a, b))

    def one_at_a_time(self, activities: Sequence[Activity]) -> None:
        """Keep all ``activities`` that are present apart."""
        for a, b in itertools.combinations(activities, 2):
            self.problem.add_constraint(apart(a, b), scope=scope_of(a, b))

    def finish(self) -> SchedulingMotionProblem:
        """State the routes and that each robot does one thing at a time; return the problem."""
        self.routes.finish()
        for activities in self.busy.values():
            self.one_at_a_time(activities)
        return self.problem
