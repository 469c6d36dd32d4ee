"""Random problems as plain values, and the UP problems that they mean in several styles.

A robot has jobs, one after the other: to be at one of some places. How a job is said is the style:
one optional drive for each pair of places, or one drive with an object parameter; who is where by
fluents or by precedences; obstacles as nothing, lists or dictionaries.
"""

from __future__ import annotations

import functools
import itertools
import math
import random
from dataclasses import dataclass, replace

from unified_planning.environment import get_environment
from unified_planning.model import Fluent, Timing
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import (
    SE2,
    SE3,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.model.timing import TimePointInterval
from unified_planning.shortcuts import GE, LE, And, Equals, Implies, Not, Or, Plus

from tests.fuzz.floors import FLOORS, Floor

SECONDS = 2.0
"""Seconds per unit."""
BOX = ((-0.35, -0.25), (0.35, -0.25), (0.35, 0.25), (-0.35, 0.25))
LONG = ((-0.5, -0.2), (0.5, -0.2), (0.5, 0.2), (-0.5, 0.2))
SQUARE = ((-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3))
FOOTPRINTS = {"box": BOX, "long": LONG, "square": SQUARE}
CRATE = ((-0.15, -0.2), (0.15, -0.2), (0.15, 0.2), (-0.15, 0.2))
LIMITS = {"v_max": 1.0, "a_max": 0.5}
BODIES = {
    "car": {
        "motion_model": MotionModels.REEDSSHEPP,
        "motion_parameters": LIMITS | {"turning_radius": 0.6},
    },
    "pivot": {
        "motion_model": MotionModels.REEDSSHEPP,
        "motion_parameters": LIMITS | {"turning_radius": 0.0},
    },
    "omni": {"motion_model": MotionModels.SE2, "motion_parameters": LIMITS},
    "bicycle": {
        "motion_model": MotionModels.REEDSSHEPP,
        "motion_parameters": LIMITS,
        "control_parameters": {"v_min": -1.0, "v_max": 1.0, "phi_min": -0.8, "phi_max": 0.8},
    },
}
"""How robots move; flyers (see :func:`flyer`) are in the air, all of them."""


def _bicycle(length: float, q, u, qdot) -> None:
    qdot[0], qdot[1] = u[0] * math.cos(q[2]), u[0] * math.sin(q[2])
    qdot[2] = u[0] * math.tan(u[1]) / length


def flyer(folder, shape: str) -> dict:
    """Return the body of a flyer as large as a footprint; its mesh is written into ``folder``."""
    import trimesh

    corners = FOOTPRINTS[shape]
    size = (2 * corners[1][0], 2 * corners[2][1], 0.3)
    file = folder / f"{shape}.stl"
    if not file.exists():
        trimesh.creation.box(size).export(file)
    return {
        "geometric_model": str(file),
        "motion_model": MotionModels.SE3,
        "motion_parameters": LIMITS | {"omega_max": 1.0},
    }


@dataclass(frozen=True)
class Robot:
    """``goals``: for each job, the places of which it has to reach one. ``service``: units that it
    then stays there. ``body``: how it moves (see :data:`BODIES`), "" as ``car`` says.
    """

    name: str
    car: bool
    shape: str
    start: str
    goals: tuple[tuple[str, ...], ...]
    service: int
    body: str = ""

    @property
    def moves(self) -> str:
        """How it moves."""
        return self.body or ("car" if self.car else "omni")


@dataclass(frozen=True)
class Style:
    """How the problem is said. ``obstacles``: "all", "list", "dict"; ``state``: "fluents" or
    "order"; ``offset``: effects come so many units before the end; ``choice``: "optional",
    "parameter" or "variable"; ``one_at_a_time``: "pairs", "uses" or "all" (and all robots take
    turns); ``limit``: "deadline" or "constraint"; ``order``: "or" or "implies"; ``durations``:
    "wide" or "close" to the straight line's.
    """

    obstacles: str
    state: str
    offset: int
    choice: str
    one_at_a_time: str
    limit: str = "deadline"
    order: str = "or"
    durations: str = "wide"


@dataclass(frozen=True)
class Case:
    """A problem. ``door``: None, "open", or how it is opened: "once" (at or after ``opens``),
    "shut", "twice" or "closing" (open at first). ``limit``: nothing may end later (units).
    ``loads``: robots that take a box along on their first drive. ``idle``: robots that may drive
    out and back at any time.
    """

    seed: int
    floor: Floor
    robots: tuple[Robot, ...]
    style: Style
    door: str | None = None
    opens: int = 0
    limit: int | None = None
    loads: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()


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
        self.flying = any(r.moves == "flyer" for r in case.robots)
        self.kind = self.types.ConfigurationType(
            f"place_{case.floor.kind}_{map_file.parent.name}",
            floor,
            ConfigurationKind.SE3 if self.flying else ConfigurationKind.SE2,
        )
        self.folder = map_file.parent
        self.loads: dict[str, MovableObject] = {}
        self.places = {n: self._place(n, p) for n, p in case.floor.places.items()}
        self.movable = {r.name: self._movable(r) for r in case.robots}
        for robot in case.robots:
            if robot.name in case.loads:
                self._add_load(robot)
        self.at = {}
        self.door = None
        if case.door is not None:
            self._add_door()
        if self.style.state == "fluents" or self.style.obstacles == "dict":
            for robot in case.robots:
                self.at[robot.name] = self._fluent(robot.name, self.places[robot.start])

    def write(self) -> SchedulingMotionProblem:
        doing = {r.name: self._jobs(r) for r in self.case.robots}
        if self.style.one_at_a_time == "all":
            self._one_at_a_time("all", [a for own in doing.values() for a in own])
        else:
            for robot in self.case.robots:
                self._one_at_a_time(robot.name, doing[robot.name])
        if self.case.limit is not None:
            for activity in self.problem.activities:
                self._limit(activity)
        self.problem.add_quality_metric(MinimizeMakespan())
        return self.problem

    def _limit(self, activity) -> None:
        if self.style.limit == "deadline":
            activity.add_deadline(self.case.limit)
            return
        scope = [activity.present] if activity.optional else []
        self.problem.add_constraint(LE(activity.end, self.case.limit), scope)

    def _place(self, name, pose):
        x, y, theta = pose
        turned = (0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
        value = SE3(x, y, 2.0, *turned) if self.flying else SE2(*pose)
        place = ConfigurationObject(name, self.kind, value)
        self.problem.add_object(place)
        return place

    def _movable(self, robot: Robot):
        item = MovableObject(
            robot.name, self.types.MovableType(f"type_{robot.name}"), **self._body(robot)
        )
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.places[robot.start])
        return item

    def _body(self, robot: Robot) -> dict:
        corners = list(FOOTPRINTS[robot.shape])
        if robot.moves == "flyer":
            return flyer(self.folder, robot.shape)
        given = {"footprint": corners, **BODIES[robot.moves]}
        if robot.moves == "bicycle":
            length = max(x for x, _ in corners) - min(x for x, _ in corners)
            given["control_model"] = functools.partial(_bicycle, length)
        return given

    def _add_load(self, robot: Robot) -> None:
        """Put a box in front of a robot, and say where it is when the robot is elsewhere."""
        name = f"load_{robot.name}"
        box = MovableObject(
            name,
            self.types.MovableType("type_load"),
            footprint=list(CRATE),
            motion_model=MotionModels.SE2,
        )
        self.loads[robot.name] = box
        self.problem.add_object(box)
        here = self._ahead(name, robot, robot.start)
        self.problem.set_initial_configuration(box, here)

    def _ahead(self, name: str, robot: Robot, place: str):
        """Return where a robot's load is while the robot is at a place."""
        key = f"{name}_{place}"
        if key not in self.places:
            x, y, theta = self.case.floor.places[place]
            reach = max(u for u, _ in FOOTPRINTS[robot.shape]) + 0.2
            pose = (x + reach * math.cos(theta), y + reach * math.sin(theta), theta)
            self.places[key] = self._place(key, pose)
        return self.places[key]

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
        first = "away" if self.case.door in ("open", "closing") else "shut"
        self.problem.set_initial_configuration(self.door, self.places[first])
        if self.style.obstacles == "dict":
            self.at["door"] = self._fluent("door", self.places[first])
        if self.case.door in ("once", "twice"):
            self._swing("open_door", "away", self.case.opens)
        if self.case.door in ("twice", "closing"):
            self._swing("close_door", "shut", self.case.opens + 2)

    def _swing(self, name: str, place: str, release: int) -> None:
        swing = self.problem.add_motion_activity(name, 1)
        swing.add_release_date(release)
        swing.add_motion_effect(self.door, self.places[place])
        if "door" in self.at:
            self._sets(swing, self.at["door"], self.places[place])

    def _sets(self, activity, fluent, value) -> None:
        activity.add_effect(Timing(-self.style.offset, activity.end), fluent, value)

    def _obstacles(self, robot: Robot) -> dict:
        others = [r.name for r in self.case.robots if r.name != robot.name]
        if self.style.obstacles == "all":
            return {}
        if self.style.obstacles == "list":
            static = [self.door] if self.door is not None else []
            moving = [self.movable[n] for n in others]
            moving += [self.loads[n] for n in others if n in self.loads]
            return {"static_obstacles": static, "dynamic_obstacles_at_start": moving}
        static = {self.door: self.at["door"]} if self.door is not None else {}
        moving = {self.movable[n]: self.at[n] for n in others}
        return {"static_obstacles": static, "dynamic_obstacles_at_start": moving}

    def _jobs(self, robot: Robot) -> list:
        """Write a robot's drives and services; return its activities."""
        activities, arrivals = [], [(robot.start, None)]
        for number, goals in enumerate(robot.goals):
            told = self.style.choice != "optional" and len(arrivals) == 1
            by_parameter = told and not (number == 0 and robot.name in self.loads)
            drive = self._one_drive if by_parameter else self._drives
            arrivals, drives, done = drive(robot, number, arrivals, goals)
            activities += drives
            if robot.service:
                activities.append(self._service(robot, number, done))
        if robot.name in self.case.idle:
            activities += self._idle(robot, arrivals)
        return activities

    def _idle(self, robot: Robot, arrivals) -> list:
        """Write an optional drive from where the robot ends to where it began, which none needs."""
        drives = []
        for place, before in arrivals[:1]:
            if place != robot.start:
                name = f"{robot.name}_idle_{place}"
                drive = self._drive(robot, name, place, self.places[robot.start], optional=True)
                self._after(drive, before, optional=True)
                drives.append(drive)
        return drives

    def _drive(self, robot: Robot, name: str, start, goal, *, optional: bool):
        drive = self.problem.add_motion_activity(name, 1, optional)
        drive.set_duration_bounds(self._shortest(start, goal), 60)
        if callable(goal):
            goal = goal(drive)
        drive.add_motion_constraint(
            ActivityWaypoints(
                self.movable[robot.name], self.places[start], [goal], **self._obstacles(robot)
            )
        )
        drive.add_motion_effect(self.movable[robot.name], goal)
        if robot.name in self.loads and name.startswith(f"{robot.name}_0_"):
            load = self.loads[robot.name]
            drive.add_motion_effect(load, self._ahead(load.name, robot, name.rpartition("_")[2]))
        if robot.name in self.at:
            at = self.at[robot.name]
            if self.style.state == "fluents":
                drive.add_condition(
                    TimePointInterval(Timing(0, drive.start)), Equals(at, self.places[start])
                )
            self._sets(drive, at, goal)
        return drive

    def _shortest(self, start: str, goal) -> int:
        """Return units below which no drive is allowed: what a straight line takes, or one."""
        if self.style.durations == "wide" or callable(goal):
            return 1
        x, y, _ = self.case.floor.places[start]
        u, v, _ = self.case.floor.places[goal.name]
        far = math.hypot(u - x, v - y)
        seconds = far + 2.0 if far > 2.0 else 2.0 * math.sqrt(2.0 * far)
        return max(1, math.floor(seconds / SECONDS))

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
        if choice and self.style.order == "implies":
            scope = [drive.present] if optional else []
            for d, c in zip(leading, apart, strict=True):
                self.problem.add_constraint(Implies(d.present, c), scope)
            self.problem.add_constraint(Or(*(d.present for d in leading)), scope)
            return
        if choice:
            apart = [And(d.present, c) for d, c in zip(leading, apart, strict=True)]
        self.problem.add_constraint(Or(*apart), [drive.present] if optional else [])

    def _one_drive(self, robot, number, arrivals, goals):
        """Write one drive whose goal is a parameter."""
        ((start, before),) = arrivals

        chosen = []
        by_variable = self.style.choice == "variable"

        def goal_of(drive):
            if by_variable:
                to = self.problem.add_variable(f"goal_{robot.name}_{number}", self.kind)
                self.problem.add_constraint(Or(*(Equals(to, self.places[g]) for g in goals)))
            else:
                to = drive.add_parameter("to", self.kind)
                drive.add_constraint(Or(*(Equals(to, self.places[g]) for g in goals)))
            chosen.append(to)
            return to

        name = f"{robot.name}_{number}"
        drive = self._drive(robot, name, start, goal_of, optional=False)
        self._after(drive, before, optional=False)
        if number + 1 < len(robot.goals) and len(goals) > 1:
            # the next drive has to know where from
            where = self.problem if by_variable else drive
            where.add_constraint(Equals(chosen[0], self.places[goals[0]]))
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
        if self.style.one_at_a_time in ("uses", "all"):
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
