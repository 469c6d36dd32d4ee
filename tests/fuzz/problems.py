"""Random problems as plain values, and the UP problems that they mean in several styles.

A robot has jobs, one after the other: to be at one of some places. How a job is said is the style:
one optional drive for each pair of places, or one drive with an object parameter; who is where by
fluents or by precedences; obstacles as nothing, lists or dictionaries.
"""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass, replace

from unified_planning.environment import get_environment
from unified_planning.model import Fluent, Timing
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.model.timing import TimePointInterval
from unified_planning.shortcuts import GE, LE, And, Equals, Not, Or, Plus

from tests.fuzz.floors import FLOORS, Floor

SECONDS = 2.0
"""Seconds per unit."""
BOX = ((-0.35, -0.25), (0.35, -0.25), (0.35, 0.25), (-0.35, 0.25))
LONG = ((-0.5, -0.2), (0.5, -0.2), (0.5, 0.2), (-0.5, 0.2))
SQUARE = ((-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3))
FOOTPRINTS = {"box": BOX, "long": LONG, "square": SQUARE}


@dataclass(frozen=True)
class Robot:
    """``goals``: for each job, the places of which it has to reach one. ``service``: units that it
    then stays there.
    """

    name: str
    car: bool
    shape: str
    start: str
    goals: tuple[tuple[str, ...], ...]
    service: int


@dataclass(frozen=True)
class Style:
    """How the problem is said. ``obstacles``: "all", "list", "dict"; ``state``: "fluents" or
    "order"; ``offset``: effects come so many units before the end; ``choice``: "optional" or
    "parameter"; ``one_at_a_time``: "pairs" or "uses".
    """

    obstacles: str
    state: str
    offset: int
    choice: str
    one_at_a_time: str


@dataclass(frozen=True)
class Case:
    """A problem. ``door``: None, "open", or how it is opened: "once" (at or after ``opens``).
    ``limit``: nothing may end later (units).
    """

    seed: int
    floor: Floor
    robots: tuple[Robot, ...]
    style: Style
    door: str | None = None
    opens: int = 0
    limit: int | None = None


def random_case(seed: int) -> Case:
    rng = random.Random(seed)
    floor = rng.choice(FLOORS)(rng)
    places = list(floor.places)
    count = min(rng.choice((1, 1, 2, 2, 3, 4)), len(places) - 1)
    starts = rng.sample(places[:-1] if floor.kind == "closed" else places, count)
    ends = rng.sample(places, count) if rng.random() < 0.8 else [None] * count
    robots = tuple(
        _robot(rng, k, start, end, places)
        for k, (start, end) in enumerate(zip(starts, ends, strict=True))
    )
    style = random_style(rng)
    door = rng.choice((None, "open", "once", "once", "once", "shut")) if floor.doorway else None
    limit = rng.choice((None, None, None, None, None, 6, 12, 25))
    return Case(seed, floor, robots, style, door, rng.choice((0, 3)), limit)


def _robot(rng: random.Random, k: int, start: str, end: str | None, places: list[str]) -> Robot:
    """Return a robot that ends at a place of its own, or (``end`` None) just anywhere."""
    goals: list[tuple[str, ...]] = []
    here = {start}
    for _ in range(rng.choice((0, 0, 0, 1))):
        free = [p for p in places if p not in here and p != end]
        goals.append(tuple(sorted(rng.sample(free, rng.choice((1, 1, 2))))))
        here = set(goals[-1])
    if end is None or end in here:
        end = rng.choice([p for p in places if p not in here])
    more = [p for p in places if p not in here and p != end]
    also = rng.sample(more, 1) if rng.random() < 0.25 else []
    goals.append(tuple(sorted((end, *also))))
    shape = rng.choice(("box", "long", "square"))
    return Robot(f"r{k}", rng.random() < 0.5, shape, start, tuple(goals), rng.choice((0, 0, 2)))


def random_style(rng: random.Random) -> Style:
    return Style(
        rng.choice(("all", "list", "dict")),
        rng.choice(("fluents", "order")),
        rng.choice((0, 0, 1)),
        rng.choice(("optional", "optional", "parameter")),
        rng.choice(("pairs", "uses")),
    )


def limited(case: Case, limit: int) -> Case:
    """Return the same problem in which nothing may end after ``limit``."""
    return replace(case, limit=limit if case.limit is None else min(limit, case.limit))


# -------------------------------------------------------------------------------- UP problems
class Writer:
    """Writes a case as a UP problem. Places are as the map's own frame has them; the frame lies at
    ``frame`` in the world.
    """

    frame: tuple[float, ...] = (0, 0)

    def __init__(self, case: Case, map_file) -> None:
        self.case, self.style = case, case.style
        self.types = get_environment().type_manager
        self.problem = SchedulingMotionProblem(f"fuzz{case.seed}")
        floor = OccupancyMap(str(map_file), self.frame)
        self.kind = self.types.ConfigurationType(
            f"place_{case.floor.kind}_{map_file.parent.name}", floor, ConfigurationKind.SE2
        )
        self.places = {n: self._place(n, p) for n, p in case.floor.places.items()}
        self.movable = {r.name: self._movable(r) for r in case.robots}
        self.at = {}
        self.door = None
        if case.door is not None:
            self._add_door()
        if self.style.state == "fluents" or self.style.obstacles == "dict":
            for robot in case.robots:
                self.at[robot.name] = self._fluent(robot.name, self.places[robot.start])

    def write(self) -> SchedulingMotionProblem:
        doing = {r.name: self._jobs(r) for r in self.case.robots}
        for robot in self.case.robots:
            self._one_at_a_time(robot.name, doing[robot.name])
        if self.case.limit is not None:
            for activity in self.problem.activities:
                activity.add_deadline(self.case.limit)
        self.problem.add_quality_metric(MinimizeMakespan())
        return self.problem

    def _place(self, name, pose):
        place = ConfigurationObject(name, self.kind, SE2(*pose))
        self.problem.add_object(place)
        return place

    def _movable(self, robot: Robot):
        limits = {"v_max": 1.0, "a_max": 0.5}
        if robot.car:
            limits["turning_radius"] = 0.6
        model = MotionModels.REEDSSHEPP if robot.car else MotionModels.SE2
        item = MovableObject(
            robot.name,
            self.types.MovableType(f"type_{robot.name}"),
            footprint=list(FOOTPRINTS[robot.shape]),
            motion_model=model,
            motion_parameters=limits,
        )
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.places[robot.start])
        return item

    def _fluent(self, name, place):
        fluent = Fluent(f"{name}_at", self.kind)
        self.problem.add_fluent(fluent, default_initial_value=place)
        return fluent

    def _add_door(self) -> None:
        shut, away, length = self.case.floor.doorway
        half = length / 2
        self.door = MovableObject(
            "door",
            self.types.MovableType("type_door"),
            footprint=[(-0.1, -half), (0.1, -half), (0.1, half), (-0.1, half)],
            motion_model=MotionModels.SE2,
        )
        self.problem.add_object(self.door)
        self.places |= {"shut": self._place("shut", shut), "away": self._place("away", away)}
        first = "away" if self.case.door == "open" else "shut"
        self.problem.set_initial_configuration(self.door, self.places[first])
        if self.style.obstacles == "dict":
            self.at["door"] = self._fluent("door", self.places[first])
        if self.case.door == "once":
            opening = self.problem.add_motion_activity("open_door", 1)
            opening.add_release_date(self.case.opens)
            opening.add_motion_effect(self.door, self.places["away"])
            if "door" in self.at:
                self._sets(opening, self.at["door"], self.places["away"])

    def _sets(self, activity, fluent, value) -> None:
        activity.add_effect(Timing(-self.style.offset, activity.end), fluent, value)

    def _obstacles(self, robot: Robot) -> dict:
        others = [r.name for r in self.case.robots if r.name != robot.name]
        if self.style.obstacles == "all":
            return {}
        if self.style.obstacles == "list":
            static = [self.door] if self.door is not None else []
            return {
                "static_obstacles": static,
                "dynamic_obstacles_at_start": [self.movable[n] for n in others],
            }
        static = {self.door: self.at["door"]} if self.door is not None else {}
        moving = {self.movable[n]: self.at[n] for n in others}
        return {"static_obstacles": static, "dynamic_obstacles_at_start": moving}

    def _jobs(self, robot: Robot) -> list:
        """Write a robot's drives and services; return its activities."""
        activities, arrivals = [], [(robot.start, None)]
        for number, goals in enumerate(robot.goals):
            by_parameter = self.style.choice == "parameter" and len(arrivals) == 1
            drive = self._one_drive if by_parameter else self._drives
            arrivals, drives, done = drive(robot, number, arrivals, goals)
            activities += drives
            if robot.service:
                activities.append(self._service(robot, number, done))
        return activities

    def _drive(self, robot: Robot, name: str, start, goal, *, optional: bool):
        drive = self.problem.add_motion_activity(name, 1, optional)
        drive.set_duration_bounds(1, 60)
        if callable(goal):
            goal = goal(drive)
        drive.add_motion_constraint(
            ActivityWaypoints(
                self.movable[robot.name], self.places[start], [goal], **self._obstacles(robot)
            )
        )
        drive.add_motion_effect(self.movable[robot.name], goal)
        if robot.name in self.at:
            at = self.at[robot.name]
            if self.style.state == "fluents":
                drive.add_condition(
                    TimePointInterval(Timing(0, drive.start)), Equals(at, self.places[start])
                )
            self._sets(drive, at, goal)
        return drive

    def _drives(self, robot, number, arrivals, goals):
        """Write an optional drive for each pair of places, one of which is there."""
        drives = []
        reached: dict[str, list] = {}
        for (start, before), goal in itertools.product(arrivals, goals):
            single = len(arrivals) * len(goals) == 1
            name = f"{robot.name}_{number}_{start}_{goal}"
            drive = self._drive(robot, name, start, self.places[goal], optional=not single)
            self._after(drive, before, optional=not single)
            drives.append(drive)
            reached.setdefault(goal, []).append(drive)
        if len(drives) > 1:
            self.problem.add_constraint(Or(*(d.present for d in drives)))
            for a, b in itertools.combinations(drives, 2):
                self.problem.add_constraint(Not(And(a.present, b.present)))
        return [(g, (d, len(drives) > 1)) for g, d in reached.items()], drives, drives

    def _after(self, drive, before, *, optional: bool) -> None:
        """Say that one of the drives that lead here comes before, a unit or more."""
        if before is None:
            return
        leading, choice = before
        apart = [LE(Plus(d.end, 1), drive.start) for d in leading]
        if choice:
            apart = [And(d.present, c) for d, c in zip(leading, apart, strict=True)]
        self.problem.add_constraint(Or(*apart), [drive.present] if optional else [])

    def _one_drive(self, robot, number, arrivals, goals):
        """Write one drive whose goal is a parameter."""
        ((start, before),) = arrivals

        def goal_of(drive):
            to = drive.add_parameter("to", self.kind)
            drive.add_constraint(Or(*(Equals(to, self.places[g]) for g in goals)))
            return to

        name = f"{robot.name}_{number}"
        drive = self._drive(robot, name, start, goal_of, optional=False)
        self._after(drive, before, optional=False)
        if number + 1 < len(robot.goals) and len(goals) > 1:
            # the next drive has to know where from: the choice is told by bool variables
            drive.add_constraint(Equals(drive.get_parameter("to"), self.places[goals[0]]))
            goals = goals[:1]
        return [(g, ([drive], False)) for g in goals], [drive], [drive]

    def _service(self, robot: Robot, number: int, drives):
        service = self.problem.add_activity(f"serve_{robot.name}_{number}", robot.service)
        ready = [LE(Plus(d.end, 1), service.start) for d in drives]
        if len(drives) > 1:
            ready = [And(d.present, c) for d, c in zip(drives, ready, strict=True)]
        self.problem.add_constraint(Or(*ready))
        return service

    def _one_at_a_time(self, name: str, activities: list) -> None:
        if len(activities) < 2:
            return
        if self.style.one_at_a_time == "uses":
            resource = self.problem.add_resource(f"{name}_busy", 1)
            for activity in activities:
                activity.uses(resource)
            return
        for a, b in itertools.combinations(activities, 2):
            scope = [x.present for x in (a, b) if x.optional]
            self.problem.add_constraint(Or(LE(a.end, b.start), GE(a.start, b.end)), scope)


def build(case: Case, folder):
    """Return the UP problem of a case; its map is written into ``folder``."""
    return Writer(case, case.floor.write(folder)).write()


__all__ = ["SECONDS", "Case", "build", "limited", "random_case"]
