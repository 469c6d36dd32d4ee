"""What there is before anything happens: objects, places, fluents and resources of a problem."""

from __future__ import annotations

import enum
import math
from functools import cached_property
from pathlib import Path

from shapely.geometry import Polygon
from unified_planning.model import Fluent, FNode, GlobalEndTiming, TimePointInterval
from unified_planning.model.motion import (
    SE2,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import ConfigurationType, Equals, IntType, MovableType, Or

from up_samp.fleet.batteries import above_reserve, first_level, usable
from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.loads import (
    MARK,
    ends_of,
    load_name,
    load_of,
    load_pose,
    loads_of,
    place_of,
    poses_of,
    ridden,
    with_load,
)
from up_samp.fleet.outlines import area_of, movable, placed
from up_samp.fleet.records import Attached, FleetRecords, Outline, Pose, RobotType, corners_of
from up_samp.fleet.statements import Meaning
from up_samp.geometry import load_map
from up_samp.motion import MotionService


class Passing(enum.Enum):
    """What a drive has to do with a zone."""

    AROUND = "around"
    IN = "in"
    OUT = "out"
    WITHIN = "within"
    THROUGH = "through"


class Crowd:
    """One zone with ``max_robots``."""

    def __init__(self, records: FleetRecords, folder: Path, zone: str) -> None:
        self.zone = zone
        self._records = records
        self._folder = folder
        self._polygon = Polygon(records.zones[zone].polygon)
        self._known: dict[tuple[str, str, str], Passing] = {}

    def starts_inside(self, robot: str) -> bool:
        """Return whether a robot touches the zone where it starts."""
        mine = self._records.robots[robot]
        return self._inside(mine.type, mine.start)

    def passing(self, robot: str, origin: str, to: str) -> Passing:
        """Return what the drive of ``robot`` from ``origin`` to ``to`` has to do with the zone,
        with the load that rides with it.
        """
        kind = self._records.robots[robot].type
        key = (kind, origin, to)
        if key not in self._known:
            self._known[key] = self._passing(*key)
        return self._known[key]

    def _passing(self, kind: str, origin: str, to: str) -> Passing:
        order = ridden(self._records, origin, to)
        load = None if order is None else load_of(self._records, order)
        # the drives to and from the ride are made without the load: so the count is of robots alone
        leaves, comes = self._inside(kind, origin), self._inside(kind, to)
        if leaves or comes:
            return {(True, True): Passing.WITHIN, (False, True): Passing.IN}.get(
                (leaves, comes), Passing.OUT
            )
        if load is not None and any(self._inside(kind, p, load) for p in (origin, to)):
            return Passing.THROUGH
        poses = [self._records.places[place_of(p)].pose for p in (origin, to)]
        body = with_load(self._records.robot_types[kind], load)
        proof = self._service.certificate(body, poses, (area_of(self._records, self.zone),))
        return Passing.AROUND if proof is None else Passing.THROUGH

    def _inside(self, kind: str, place: str, load: Attached | None = None) -> bool:
        mine, pose = self._records.robot_types[kind], self._records.places[place_of(place)].pose
        corners = placed(with_load(mine, load).footprint, pose)
        return bool(self._polygon.intersects(Polygon(corners)))

    @cached_property
    def _service(self) -> MotionService:
        grid = load_map(self._folder / self._records.map)
        return MotionService(grid, margin=self._records.margin)


# ------------------ What there is before anything happens


class Site:
    """A UP problem with all that the records name, and nothing that happens yet.

    ``at`` holds the fluents that tell where robots and doors are, ``stands`` where a load
    is while its robot is at a stand, ``pallets`` the loads by the first order that carries each,
    ``rooms`` how many more robots fit into a zone. ``meanings`` fills as activities get names.
    """

    def __init__(self, records: FleetRecords, folder: Path) -> None:
        self.records = records
        self.folder = folder
        self.map = str(folder / records.map)
        self.problem = SchedulingMotionProblem(records.name)
        ground = OccupancyMap(self.map, SE2(0.0, 0.0, 0.0))
        self._pose_type = ConfigurationType("pose", ground, ConfigurationKind.SE2)
        self.places: dict[str, ConfigurationObject] = {}
        self.resources: dict[str, Fluent] = {}
        self.robots: dict[str, MovableObject] = {}
        self.at: dict[str, FNode] = {}
        self.batteries: dict[str, FNode] = {}
        self.pallets: dict[str, MovableObject] = {}
        self.stands: dict[str, ConfigurationObject] = {}
        self.doors: dict[str, MovableObject] = {}
        self.keep_out: dict[str, list[MovableObject]] = {}
        self.crowds: list[Crowd] = []
        self.rooms: dict[str, tuple[MovableObject, FNode]] = {}
        self.meanings: dict[str, Meaning] = {}
        for name, pose in poses_of(records).items():
            self.places[name] = self._pose(name, pose)
        for name, resource in records.resources.items():
            self.resources[name] = self.problem.add_resource(name, resource.capacity)
        self._robots()
        self._pallets()
        self._doors()
        self._zones()

    def kind_of(self, robot: str) -> RobotType:
        """Return the type of a robot."""
        return self.records.robot_types[self.records.robots[robot].type]

    def fresh(self, name: str, meaning: Meaning) -> str:
        """Return a name for an activity: ``name``, or one with a number that no other has. Names
        of robots and places may hold underscores, and so two activities may want the same. What
        it stands for is told by its ``meaning`` alone.
        """
        number, found = 1, name
        while found in self.meanings:
            number += 1
            found = f"{name}~{number}"
        self.meanings[found] = meaning
        return found

    def up(self, seconds: float) -> int:
        """Return seconds as whole units, rounded up, at least one."""
        return max(1, math.ceil(seconds / self.records.seconds_per_unit - 1e-9))

    def down(self, seconds: float) -> int:
        """Return seconds as whole units, rounded down."""
        return math.floor(seconds / self.records.seconds_per_unit + 1e-9)

    def _pose(self, name: str, pose: Pose) -> ConfigurationObject:
        found = ConfigurationObject(name, self._pose_type, SE2(*pose))
        self.problem.add_object(found)
        return found

    def _at_first(self, name: str, place: ConfigurationObject) -> None:
        """Add the fluent that tells where something is."""
        fluent = Fluent(f"{name}_at", self._pose_type)
        self.problem.add_fluent(fluent, default_initial_value=place)
        self.at[name] = fluent()

    def _robots(self) -> None:
        types = {name: MovableType(name) for name in self.records.robot_types}
        for name, robot in self.records.robots.items():
            kind = self.kind_of(name)
            self.robots[name] = movable(name, types[robot.type], kind)
            self.problem.add_object(self.robots[name])
            self.problem.set_initial_configuration(self.robots[name], self.places[robot.start])
            self._at_first(name, self.places[robot.start])
            if kind.battery is not None:
                level = Fluent(f"{name}_battery", IntType(0, usable(kind.battery)))
                at_first = above_reserve(kind.battery, first_level(self.records, name))
                self.problem.add_fluent(level, default_initial_value=at_first)
                self.batteries[name] = level()
            if robot.end is not None:
                here = [p for n, p in self.places.items() if place_of(n) == robot.end]
                ends = [Equals(self.at[name], p) for p in here]  # under a load it is there, too
                self.problem.add_condition(TimePointInterval(GlobalEndTiming()), Or(ends))

    def _pallets(self) -> None:
        """Loads that travel with robots: they stand at their pickup at first."""
        for first, load in loads_of(self.records):
            carried = [o for o in self.records.orders if load_name(self.records, o) == first.id]
            ends = [end for o in carried for end in ends_of(self.records, o)]
            for place in dict.fromkeys(place for end in ends for place in end):
                pose = load_pose(load, self.records.places[place_of(place)].pose)
                self.stands[place] = self._pose(f"load{MARK}{place}", pose)
            at = self.stands[ends_of(self.records, first)[0][0]]
            name = f"load{MARK}{first.id}"
            self.pallets[first.id] = self._fixture(name, load.footprint, at, "load")

    def _fixture(
        self, name: str, outline: Outline, pose: ConfigurationObject, kind: str = "fixture"
    ) -> MovableObject:
        fixture = MovableObject(
            name, MovableType(kind), footprint=corners_of(outline), motion_model=MotionModels.SE2
        )
        self.problem.add_object(fixture)
        self.problem.set_initial_configuration(fixture, pose)
        return fixture

    def _doors(self) -> None:
        for name, door in self.records.doors.items():
            closed = self._pose(f"{name}.closed", door.closed)
            opened = self._pose(f"{name}.open", door.open)
            self.doors[name] = self._fixture(name, door.leaf, closed)
            self.places[closed.name], self.places[opened.name] = closed, opened
            self._at_first(name, closed)

    def _zones(self) -> None:
        for name, zone in self.records.zones.items():
            here = self._pose(f"{name}.here", (0.0, 0.0, 0.0))
            area = self._fixture(name, zone.polygon, here)
            for kind in zone.keep_out:
                self.keep_out.setdefault(kind, []).append(area)
            if zone.max_robots is not None:
                self.crowds.append(Crowd(self.records, self.folder, name))
                self._room(name, area, zone.max_robots)

    def _room(self, name: str, area: MovableObject, most: int) -> None:
        """How many more robots may come into a zone."""
        inside = sum(self.crowds[-1].starts_inside(r) for r in self.records.robots)
        if inside > most:
            what = f"{inside} robots start in it; it takes {most}"
            raise FleetError([Fault(("zones", name, "max_robots"), what)])
        room = Fluent(f"{name}_room", IntType(0, most))
        self.problem.add_fluent(room, default_initial_value=most - inside)
        self.rooms[name] = (area, room())
