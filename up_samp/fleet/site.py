"""The site of a problem before anything happens: objects, places, fluents and resources."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import cast

from shapely.geometry import Polygon
from unified_planning.model import (
    Fluent,
    FNode,
    GlobalEndTiming,
    Object,
    TimePointInterval,
    Type,
)
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
from unified_planning.shortcuts import (
    ConfigurationType,
    Equals,
    IntType,
    MovableType,
    Or,
    UserType,
)

from up_samp.fleet.batteries import above_reserve, first_level, level_fluent, usable
from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.fields import Outline, Pose, corners_of
from up_samp.fleet.floors import FloorMaps, floor_of, height_of, map_of, spots_of, way_between
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
from up_samp.fleet.meanings import Meaning
from up_samp.fleet.outlines import (
    area_of,
    convex_hull,
    front_of,
    lying,
    movable,
    placed,
    rules_for,
    swept,
)
from up_samp.fleet.records import GROUND, Attached, FleetRecords
from up_samp.fleet.spelled_out import stop_of
from up_samp.io.plan_dict import AREA
from up_samp.model import Placed

Passing = tuple[bool, bool] | None
"""What a drive has to do with a zone: whether it takes room there as it starts, and gives some back
as it ends; None: it goes around.
"""


class Crowd:
    """One zone with ``max_robots``."""

    def __init__(self, records: FleetRecords, floors: FloorMaps, zone: str) -> None:
        self.zone, self.floor = zone, records.zones[zone].floor
        self._records = records
        self._floors = floors
        self._polygon = Polygon(records.zones[zone].polygon)
        self.passing = cache(self._passing)

    def holds(self, place: str) -> bool:
        """Return whether robots of some type touch the zone at a place."""
        return any(self.inside(kind, place) for kind in self._records.robot_types)

    def _passing(self, kind: str, origin: str, to: str) -> Passing:
        """Return what the drive of a robot of a type from ``origin`` to ``to`` has to do with the
        zone, with the load that rides with it.
        """
        order = ridden(self._records, origin, to)
        load = None if order is None else load_of(self._records, order)
        # the drives to and from the ride are made without the load: so the count is of robots alone
        leaves, comes = self.inside(kind, origin), self.inside(kind, to)
        if leaves or comes:
            return comes and not leaves, leaves and not comes
        if load is not None and any(self.inside(kind, p, load) for p in (origin, to)):
            return True, True
        poses = way_between(self._records, origin, to)
        body = with_load(self._records.robot_types[kind], load)
        service = self._floors.service(self.floor)
        proof = service.certificate(body, poses, (area_of(self._records, self.zone),))
        return None if proof is None else (True, True)

    def inside(self, kind: str, place: str, load: Attached | None = None) -> bool:
        """Return whether a robot of a type touches the zone at a place."""
        if floor_of(self._records, place) != self.floor:
            return False
        mine, pose = self._records.robot_types[kind], self._records.places[place_of(place)].pose
        corners = placed(with_load(mine, load).footprint, pose)
        return bool(self._polygon.intersects(Polygon(corners)))


# ------------------ What there is before anything happens


class Site:
    """A UP problem with all that the records name, and nothing that happens yet.

    ``at`` holds the fluents that tell where robots and doors are, ``spots`` their values by place
    (the poses themselves, unless they are on several floors: UP has a type of poses for each, and
    one type of values for a fluent), ``lifts`` what a ride takes, by the place where it begins,
    ``stops`` by a lift's place how many more robots may be there or on the way, ``seats`` how many
    more may be at a place where there are lifts (who rides is, until the ride ends), ``stands``
    where a load is while its robot is at a stand, ``pallets`` the loads by the first order that
    carries each, ``rooms`` how many more robots fit into a zone. ``meanings`` fills as activities
    get names.
    """

    def __init__(self, records: FleetRecords, folder: Path) -> None:
        self.records = records
        self.folder = folder
        self.floors = FloorMaps(records, folder)
        self.problem = SchedulingMotionProblem(records.name)
        self._pose_types = {floor: self._pose_type(floor) for floor in (GROUND, *records.floors)}
        self._spot_type = UserType("spot") if records.floors else self._pose_types[GROUND]
        self.spots: dict[str, Object] = {}
        self.lifts: dict[str, Fluent] = {}
        self.stops: dict[str, FNode] = {}
        self.seats: dict[str, FNode] = {}
        self.metres: dict[str, float] = {}
        """How long drives are (by activity), where the objective asks for it."""
        self.places: dict[str, ConfigurationObject] = {}
        self.fronts: dict[str, ConfigurationObject] = {}
        """Where the straight ways to docks begin, by place."""
        self.resources: dict[str, Fluent] = {}
        self.robots: dict[str, MovableObject] = {}
        self.at: dict[str, FNode] = {}
        self.batteries: dict[str, FNode] = {}
        self.pallets: dict[str, MovableObject] = {}
        self.stands: dict[str, ConfigurationObject] = {}
        self.doors: dict[str, list[MovableObject]] = {}
        """By door, its leaves: each is named like the poses at which it is closed and open."""
        self.reaches: dict[str, tuple[MovableObject, Placed]] = {}
        """By door, all that its leaf sweeps: an area that never moves."""
        self.doorways: dict[str, MovableObject] = {}
        """By automatic door, its area."""
        self.keep_out: dict[tuple[str, str], list[MovableObject]] = {}
        """By robot type and floor."""
        self.crowds: list[Crowd] = []
        self.rooms: dict[str, tuple[MovableObject, FNode]] = {}
        self.meanings: dict[str, Meaning] = {}
        for name, pose in poses_of(records).items():
            self.places[name] = self._pose(name, pose, floor_of(records, name))
            self.spots[name] = self._spot(self.places[name])
        for name, place in records.places.items():
            front = front_of(place)
            if front is not None:
                self.fronts[name] = self._pose(f"front{MARK}{name}", front, place.floor)
        for name, resource in records.resources.items():
            self.resources[name] = self.problem.add_resource(name, resource.capacity)
        self._robots()
        self._lifts()
        self._pallets()
        self._doors()
        self._zones()

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

    def _pose_type(self, floor: str) -> Type:
        """Return the type of poses on a floor."""
        name, frame = "pose", SE2(0.0, 0.0, 0.0)
        if floor != GROUND:
            height = height_of(self.records, floor)
            name, frame = f"pose{MARK}{floor}", SE3(0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0)
        there = OccupancyMap(str(self.folder / map_of(self.records, floor)), frame)
        return ConfigurationType(name, there, ConfigurationKind.SE2)

    def _pose(self, name: str, pose: Pose, floor: str) -> ConfigurationObject:
        found = ConfigurationObject(name, self._pose_types[floor], SE2(*pose))
        self.problem.add_object(found)
        return found

    def _spot(self, place: ConfigurationObject) -> Object:
        """Return what stands for a place as a fluent's value."""
        if not self.records.floors:
            return place
        found = Object(f"spot{MARK}{place.name}", self._spot_type)
        self.problem.add_object(found)
        return found

    def _at_first(self, name: str, place: Object) -> None:
        """Add the fluent that tells where something is."""
        fluent = Fluent(f"{name}_at", self._spot_type)
        self.problem.add_fluent(fluent, default_initial_value=place)
        self.at[name] = fluent()

    def _robots(self) -> None:
        types = {name: MovableType(name) for name in self.records.robot_types}
        along = any(load.carriers for _, load in loads_of(self.records))
        for name, robot in self.records.robots.items():
            kind = self.records.kind_of(name)
            self.robots[name] = movable(
                name, types[robot.type], kind, rules_for(self.records, robot.type), along=along
            )
            self.problem.add_object(self.robots[name])
            self.problem.set_initial_configuration(self.robots[name], self.places[robot.start])
            self._at_first(name, self.spots[robot.start])
            if kind.battery is not None:
                level = Fluent(level_fluent(name), IntType(0, usable(kind.battery)))
                at_first = above_reserve(kind.battery, first_level(self.records, name))
                self.problem.add_fluent(level, default_initial_value=at_first)
                self.batteries[name] = level()
            if robot.end is not None:
                here = [p for n, p in self.spots.items() if place_of(n) == robot.end]
                ends = [Equals(self.at[name], p) for p in here]  # under a load it is there, too
                self.problem.add_condition(TimePointInterval(GlobalEndTiming()), Or(ends))

    def _lifts(self) -> None:
        """A spot in a lift takes one robot at a time, and nobody is brought to where another one
        stands.
        """
        starts = {robot.start for robot in self.records.robots.values()}
        for name, lift in self.records.lifts.items():
            for spot in range(spots_of(lift)):
                busy = self.problem.add_resource(f"busy{MARK}{name}.{spot + 1}", 1)
                for stop in (stop_of(name, floor, spot) for floor in lift.stops):
                    self.lifts[stop] = busy
                    self.stops[stop] = self._for_one(f"{stop}_room", stop not in starts)
        # whom a ride brings, too, nobody counts but here
        for place in self.records.places if self.lifts else ():
            self.seats[place] = self._for_one(f"{place}_free", place not in starts)

    def _for_one(self, name: str, free: bool) -> FNode:
        """Return the fluent that tells whether one more robot may come."""
        room = Fluent(name, IntType(0, 1))
        self.problem.add_fluent(room, default_initial_value=int(free))
        return cast(FNode, room())

    def _pallets(self) -> None:
        """Loads that travel with robots: they stand at their pickup at first."""
        for first, load in loads_of(self.records):
            carried = [o for o in self.records.orders if load_name(self.records, o) == first.id]
            ends = [end for o in carried for end in ends_of(self.records, o)]
            for place in dict.fromkeys(place for end in ends for place in end):
                pose = load_pose(load, self.records.places[place_of(place)].pose)
                floor = floor_of(self.records, place)
                self.stands[place] = self._pose(f"load{MARK}{place}", pose, floor)
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
            corners: list[tuple[float, float]] = []
            for leaf, ends in zip((name, f"second{MARK}{name}"), door.leaves, strict=False):
                for state, pose in zip(("closed", "open"), ends, strict=True):
                    place = self._pose(f"{leaf}.{state}", pose, door.floor)
                    self.places[place.name], self.spots[place.name] = place, self._spot(place)
                corners += swept(door.leaf, *ends)
                fixture = self._fixture(leaf, door.leaf, self.places[f"{leaf}.closed"])
                self.doors.setdefault(name, []).append(fixture)
            reach = convex_hull(corners)
            area = self._area(lying(f"reach{MARK}{name}", reach), door.floor)
            self.reaches[name] = area, lying(area.name, reach)
            self._at_first(name, self.spots[f"{name}.closed"])
        for name, automatic in self.records.automatic_doors.items():
            self.doorways[name] = self._area(area_of(self.records, name), automatic.floor)

    def _area(self, area: Placed, floor: str) -> MovableObject:
        x, y, heading = area.pose
        here = self._pose(f"{area.name}{MARK}here", (x, y, heading), floor)
        return self._fixture(area.name, area.body.footprint, here, AREA)

    def _zones(self) -> None:
        for name, zone in self.records.zones.items():
            area = self._area(area_of(self.records, name), zone.floor)
            for kind in zone.keep_out:
                self.keep_out.setdefault((kind, zone.floor), []).append(area)
            if zone.max_robots is not None:
                self.crowds.append(Crowd(self.records, self.floors, name))
                self._room(name, area, zone.max_robots)

    def _room(self, name: str, area: MovableObject, most: int) -> None:
        """How many more robots may come into a zone."""
        inside = sum(self.crowds[-1].inside(r.type, r.start) for r in self.records.robots.values())
        stop = next(filter(self.crowds[-1].holds, self.stops), None)
        if stop is not None:
            what = f"robots at the lift's stop '{stop}' would be in it: a ride is not counted"
            raise FleetError([Fault(("zones", name, "max_robots"), what)])
        if inside > most:
            what = f"{inside} robots start in it; it takes {most}"
            raise FleetError([Fault(("zones", name, "max_robots"), what)])
        room = Fluent(f"{name}_room", IntType(0, most))
        self.problem.add_fluent(room, default_initial_value=most - inside)
        self.rooms[name] = (area, room())
