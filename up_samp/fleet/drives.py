"""How robots get from place to place: drives, what is in their way, and what they take along.

Which way a drive takes is known before any schedule: that which the robot takes when nobody is in
it. A drive whose way touches the doorway of a door that opens as robots come leads through it; any
other keeps clear of it. So such a door is no thing that moves, and nobody waits for it from afar.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from unified_planning.model import Fluent
from unified_planning.model.motion import ActivityWaypoints, ConfigurationObject, MovableObject
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, Equals, Or

from up_samp.fleet.batteries import Meter, usable
from up_samp.fleet.fields import corners_of
from up_samp.fleet.floors import floor_of, lift_between, ride_seconds, way_between
from up_samp.fleet.loads import (
    MARK,
    is_under,
    load_name,
    load_of,
    loads_of,
    place_of,
    ridden,
    seat_of,
    seats_of_carriers,
)
from up_samp.fleet.meanings import Kind, Meaning
from up_samp.fleet.outlines import area_of
from up_samp.fleet.records import GROUND, Order, RobotType, can_do
from up_samp.fleet.site import Site
from up_samp.fleet.visits import Successions, check_visits, moves_needed
from up_samp.fleet.work import Work
from up_samp.model import Placed
from up_samp.upio.expressions import at_start, present


@dataclass(frozen=True, eq=False)
class _Ride:
    """A ride of ``robot``, on a ``spot`` of a lift (what it takes), between two floors."""

    activity: Activity
    robot: str
    spot: Fluent
    floors: tuple[str, str]


class Drives:
    """Writes the drives of robots into a site's problem."""

    def __init__(self, site: Site, work: Work) -> None:
        self._site = site
        self._work = work
        self._meter = Meter(site.records, site.folder)
        self._airlocks: dict[str, Fluent] = {}
        corners = (c for k in site.records.robot_types.values() for c in corners_of(k.footprint))
        self._cabin = 2 * max(itertools.starmap(math.hypot, corners), default=0.0)
        self._rides: dict[str, list[_Ride]] = {}
        self._seats = seats_of_carriers(site.records)

    def add(self, robot: str) -> None:
        """Add the drives that a robot may need, as many of each as any schedule could."""
        records, kind = self._site.records, self._site.records.kind_of(robot)
        check_visits(records, robot, self._work.visits[robot])
        needed = moves_needed(self._work.visits[robot], Successions(records, robot))
        longest = self._longest(kind)
        for (origin, to), copies in needed.items():
            lift = lift_between(records, origin, to)
            if lift is not None:
                for _ in range(copies):
                    self._work.busy[robot].append(self._ride(robot, lift, origin, to))
                continue
            battery, amount = kind.battery, self._meter.drive(robot, origin, to)
            if battery is not None and amount > usable(battery):
                continue  # more than a full one has above its reserve
            if origin in self._seats and to in self._seats:
                continue  # with the load, which its first carrier drives
            order = ridden(records, origin, to)
            verbs: dict[str, tuple[str, ...]] = {f"move_{robot}_{origin}_to_{to}": ()}
            if order is not None:
                verb = f"carry_{order.id}_{robot}_{place_of(origin)}_to_{place_of(to)}"
                verbs = {"_with_".join((verb, *o)): o for o in self._others(robot, order)}
            for (verb, others), number in itertools.product(verbs.items(), range(1, copies + 1)):
                name = verb + (f"_{number}" if number > 1 else "")
                a = self._drive(robot, origin, to, name, longest)
                self._work.busy[robot].append(a)
                self._along(a, others, (origin, to))

    def _others(self, robot: str, order: Order) -> Iterator[tuple[str, ...]]:
        """Return who may carry an order's load with ``robot``: in the order of their places, nobody
        where it carries it alone.
        """
        records, kind = self._site.records, self._site.records.kind_of(robot)
        alike = [
            name
            for name in records.robots
            if name != robot and kind.model == "omni" and self._site.records.kind_of(name) is kind
            if can_do(records, name, order)
        ]
        load = load_of(records, order)
        assert load is not None
        return itertools.permutations(alike, len(load.carriers))

    def _along(self, a: Activity, others: Sequence[str], way: tuple[str, str]) -> None:
        """State that ``others`` keep formation in a drive between two stands of a load."""
        site, load = self._site, way[0].partition(MARK)[2]
        for number, other in enumerate(others, 2):
            here, there = (seat_of(end, load, number) for end in way)
            a.add_motion_effect(site.robots[other], site.places[there])
            a.add_condition(at_start(a), Equals(site.at[other], site.spots[here]))
            a.add_effect(a.end, site.at[other], site.spots[there])
            amount = self._meter.drive(other, *way)
            if amount:
                a.add_decrease_effect(a.start, site.batteries[other], amount)
            self._work.busy[other].append(a)

    def _ride(self, robot: str, lift: str, origin: str, to: str) -> Activity:
        """Add a ride: the robot stands at the stop where it entered until it is at the other."""
        site = self._site
        name = site.fresh(f"ride_{robot}_{origin}_to_{to}", Meaning(Kind.RIDE, lift, robot))
        floors = floor_of(site.records, origin), floor_of(site.records, to)
        seconds = ride_seconds(site.records, lift, *floors)
        a = site.problem.add_motion_activity(name, site.up(seconds), optional=True)
        a.add_motion_effect(site.robots[robot], site.places[to])
        a.uses(site.lifts[origin])
        a.add_decrease_effect(a.start, site.stops[to], 1)
        a.add_increase_effect(a.start, site.stops[origin], 1)  # who comes next may drive up
        a.add_increase_effect(a.end, site.seats[origin], 1)
        a.add_decrease_effect(a.end, site.seats[to], 1)
        a.add_condition(at_start(a), Equals(site.at[robot], site.spots[origin]))
        a.add_effect(a.end, site.at[robot], site.spots[to])
        self._share(_Ride(a, robot, site.lifts[origin], floors), self._rides.setdefault(lift, []))
        return a

    def _share(self, mine: _Ride, others: list[_Ride]) -> None:
        """State that a lift's rides from different spots in it begin together, or are one after
        another. (From one spot they are, as they take it.)
        """
        for other in others:
            if other.spot != mine.spot and other.robot != mine.robot:
                a, b = mine.activity, other.activity
                ways = [LE(a.end, b.start), LE(b.end, a.start)]
                if other.floors == mine.floors:
                    ways.append(Equals(a.start, b.start))
                self._site.problem.add_constraint(Or(ways), present(a, b))
        others.append(mine)

    def _drive(self, robot: str, origin: str, to: str, name: str, longest: int) -> Activity:
        site = self._site
        mover = site.robots[robot]
        order = ridden(site.records, origin, to)
        meaning = Meaning(Kind.MOVE, "", robot)
        if order is not None:
            meaning = Meaning(Kind.CARRY, order.id, robot)
        a = site.problem.add_motion_activity(site.fresh(name, meaning), optional=True)
        a.set_duration_bounds(1, longest)
        floor = floor_of(site.records, origin)
        areas = self._zones(a, robot, origin, to)
        around = [area_of(site.records, area.name) for area in areas]
        a.add_motion_constraint(
            ActivityWaypoints(
                mover,
                site.places[origin],
                self._waypoints(origin, to),
                static_obstacles=[
                    *self._doors(robot, origin, to, around),
                    *self._doorways(a, robot, origin, to, around),
                    *site.keep_out.get((mover.type.name, floor), ()),
                    *areas,
                ],
                dynamic_obstacles_at_start=self._moving(robot, origin, to),
            )
        )
        a.add_motion_effect(mover, site.places[to])
        if any(told.distance or told.cost for told in site.records.weighed):
            site.metres[a.name], _ = self._meter.length(robot, origin, to)
        amount = self._meter.drive(robot, origin, to)
        if amount:
            a.add_decrease_effect(a.start, site.batteries[robot], amount)
        if origin in site.stops:
            a.add_increase_effect(a.start, site.stops[origin], 1)
        if to in site.stops:
            a.add_decrease_effect(a.start, site.stops[to], 1)
        leaves, comes = place_of(origin), place_of(to)
        if site.seats and leaves != comes:
            a.add_increase_effect(a.start + 1, site.seats[leaves], 1)
            a.add_decrease_effect(a.end - self._inside(a, robot, to), site.seats[comes], 1)
        if order is not None:
            a.add_motion_effect(site.pallets[load_name(site.records, order)], site.stands[to])
        a.add_condition(at_start(a), Equals(site.at[robot], site.spots[origin]))
        a.add_effect(a.end, site.at[robot], site.spots[to])
        return a

    def _waypoints(self, origin: str, to: str) -> list[ConfigurationObject]:
        """Return where a drive leads: to docks straight, from in front of them."""
        inner = way_between(self._site.records, origin, to)[1:-1]
        return [*(self._site.fronts[place_of(to)] for _ in inner), self._site.places[to]]

    def _inside(self, a: Activity, robot: str, to: str) -> int:
        """Return how long (units) before its end a drive into a lift is where ``robot`` would touch
        whoever stands in it; the whole drive lasts no less. (0 where it leads elsewhere.)
        """
        if to not in self._site.stops:
            return 0
        kind = self._site.records.kind_of(robot)
        units = self._site.up(math.sqrt(2 * self._cabin / kind.a_max))
        a.set_duration_bounds(
            max(units, a.duration.lower.constant_value()), a.duration.upper.constant_value()
        )
        return units

    def _zones(self, a: Activity, robot: str, origin: str, to: str) -> list[MovableObject]:
        """Count a drive in the zones that it visits; return those that it goes around."""
        around = []
        for crowd in (c for c in self._site.crowds if c.floor == floor_of(self._site.records, to)):
            area, room = self._site.rooms[crowd.zone]
            passing = crowd.passing(self._site.records.robots[robot].type, origin, to)
            if passing is None:
                around.append(area)
                continue
            takes, gives = passing
            if takes:
                a.add_decrease_effect(a.start, room, 1)
            if gives:
                a.add_increase_effect(a.end, room, 1)
        return around

    def _doors(self, robot: str, origin: str, to: str, around: list[Placed]) -> list[MovableObject]:
        """Return a floor's doors as a drive heeds them: where its way leads past all that a leaf
        sweeps anyway, that area, which never moves, so that it waits for no door.
        """
        site, found = self._site, list[MovableObject]()
        for name, door in site.records.doors.items():
            if door.floor == floor_of(site.records, origin):
                area, reach = site.reaches[name]
                past = self._meter.clears(robot, origin, to, (reach, *around))
                found += [area] if past else site.doors[name]
        return found

    def _doorways(
        self, a: Activity, robot: str, origin: str, to: str, around: Iterable[Placed]
    ) -> list[MovableObject]:
        """State for a drive ``a`` what the automatic doors that it leads through ask: time to open
        and close, that they are not shut, and the one unit of each airlock; return the doorways
        that it keeps clear of. ``around``: what else it keeps clear of.
        """
        site, through, clear = self._site, [], []
        for name, door in site.records.automatic_doors.items():
            if door.floor == floor_of(site.records, origin):
                area = area_of(site.records, name)
                if self._meter.clears(robot, origin, to, (area, *around)):
                    clear.append(site.doorways[name])
                else:
                    through.append(door)
        if through:
            _, driven = self._meter.length(robot, origin, to)
            longer = sum(d.opens_in + d.closes_in for d in through)
            longest = a.duration.upper.constant_value() + site.up(longer)
            a.set_duration_bounds(site.up(driven + longer), longest)
        for closes, opens in (span for door in through for span in door.shut):
            before, after = LE(a.end, site.down(closes)), GE(a.start, site.up(opens))
            site.problem.add_constraint(Or(before, after), present(a))
        for lock in sorted({d.airlock for d in through if d.airlock is not None}):
            if lock not in self._airlocks:
                self._airlocks[lock] = site.problem.add_resource(f"airlock{MARK}{lock}", 1)
            a.uses(self._airlocks[lock])
        return clear

    def _moving(self, robot: str, origin: str, to: str) -> list[MovableObject]:
        """Return what else moves and is in the way of a drive: other robots, and all loads on the
        floor but for those that it takes along, or stands under when it begins or ends.
        """
        site = self._site
        kind = site.records.kind_of(robot)
        found = [r for name, r in site.robots.items() if name != robot]
        for first, load in loads_of(site.records):
            mine = [name for name in (origin, to) if name.partition(MARK)[2] == first.id]
            seats = {self._seats[name] for name in (origin, to) if name in self._seats}
            under = [is_under(kind, load)] * len(mine)
            under += [is_under(kind, load, load.carriers[k]) for one, k in seats if one == first.id]
            if not (len(mine) == 2 or any(under)):
                found.append(site.pallets[first.id])
        return found

    def _longest(self, kind: RobotType) -> int:
        """Return how long a drive may take (units): four times along the map's edges, and a
        quarter of an hour, in which others can get out of the way, or what twenty stops and turns
        take of a robot that is very slow at them.
        """
        sizes = [
            self._site.floors.grid(floor).size for floor in (GROUND, *self._site.records.floors)
        ]
        width, height = max(sizes, key=sum)
        stops = 20 * (kind.v_max / kind.a_max + 2 * math.pi / kind.omega_max)
        return self._site.up(8 * (width + height) / kind.v_max + max(900.0, stops))
