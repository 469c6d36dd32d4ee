"""What there is in the UP problem of a case: places, robots, loads, a door, and where they are."""

from __future__ import annotations

import math

from unified_planning.environment import get_environment
from unified_planning.model import Fluent, Timing
from unified_planning.model.motion import (
    SE2,
    SE3,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)

from tests.fuzz.bodies import CRATE, FOOTPRINTS, flyer, planar_body
from tests.fuzz.cases import Case, Load, Robot


class Scene:
    """Writes all but the robots' jobs. Places are as the map's own frame has them; the frame lies
    at ``frame`` in the world.
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
        self.places = {n: self._place(n, p) for n, p in case.floor.places.items()}
        self.movable = {r.name: self._movable(r) for r in case.robots}
        self.loads = {load.name: self._box(load) for load in case.loads}
        self.at: dict[str, Fluent] = {}
        self.door = None
        if case.door is not None:
            self._add_door()
        if self.style.state == "fluents" or self.style.obstacles == "dict":
            for robot in case.robots:
                self.at[robot.name] = self._fluent(robot.name, self.places[robot.start])

    def _place(self, name, pose):
        x, y, theta = pose
        turned = (0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
        value = SE3(x, y, 2.0, *turned) if self.flying else SE2(*pose)
        place = ConfigurationObject(name, self.kind, value)
        self.problem.add_object(place)
        return place

    def _movable(self, robot: Robot):
        flies = robot.moves == "flyer"
        body = flyer(self.folder, robot.shape) if flies else planar_body(robot.moves, robot.shape)
        item = MovableObject(robot.name, self.types.MovableType(f"type_{robot.name}"), **body)
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.places[robot.start])
        return item

    def _box(self, load: Load):
        """Put a box where its first carrier takes it from."""
        box = MovableObject(
            load.name,
            self.types.MovableType("type_load"),
            footprint=list(CRATE),
            motion_model=MotionModels.SE2,
        )
        self.problem.add_object(box)
        carrier, job = load.carried[0]
        robot = next(r for r in self.case.robots if r.name == carrier)
        start = robot.goals[job - 1][0] if job else robot.start
        self.problem.set_initial_configuration(box, self._beside(load, start))
        return box

    def _beside(self, load: Load, place: str, *, turned: bool = False):
        """Return where a load is while its carrier is at a place."""
        if load.side == "on" and not turned:
            return self.places[place]
        key = f"{load.name}_{place}{'_turned' * turned}"
        if key not in self.places:
            x, y, theta = self.case.floor.places[place]
            long, wide = (max(axis) for axis in zip(*FOOTPRINTS[load.shape], strict=True))
            u, v = {"ahead": (long + 0.2, 0.0), "left": (0.0, wide + 0.25), "on": (0.0, 0.0)}[
                load.side
            ]
            c, s = math.cos(theta), math.sin(theta)
            pose = (x + c * u - s * v, y + s * u + c * v, theta + math.pi / 2 * turned)
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
            for load in self.case.loads:
                if all(carrier != robot.name for carrier, _ in load.carried):
                    moving.append(self.loads[load.name])
            return {"static_obstacles": static, "dynamic_obstacles_at_start": moving}
        static = {self.door: self.at["door"]} if self.door is not None else {}
        moving = {self.movable[n]: self.at[n] for n in others}
        return {"static_obstacles": static, "dynamic_obstacles_at_start": moving}
