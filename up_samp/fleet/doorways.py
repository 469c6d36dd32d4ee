"""Doors that open as robots come: which drives lead through them, and what that asks of a drive.

Which way a drive takes is known before any schedule: that which the robot takes when nobody is in
it. A drive whose way touches a doorway leads through it; any other keeps clear of it. So a door is
no thing that moves, and nobody waits for it from afar.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shapely.geometry import Polygon
from unified_planning.model import Fluent
from unified_planning.model.motion import MovableObject
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, Or

from up_samp.fleet.batteries import Meter
from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.floors import floor_of
from up_samp.fleet.loads import MARK, load_of, place_of, with_load
from up_samp.fleet.outlines import doorway_of, placed
from up_samp.fleet.records import AutomaticDoor, FleetRecords
from up_samp.fleet.site import Site
from up_samp.fleet.statements import present
from up_samp.fleet.visits import Visit
from up_samp.model import Placed


class Doorways:
    """States what drives through automatic doors have to keep, in a site's problem."""

    def __init__(self, site: Site, meter: Meter) -> None:
        self._site = site
        self._meter = meter
        self._airlocks: dict[str, Fluent] = {}

    def heed(
        self, a: Activity, robot: str, origin: str, to: str, around: Iterable[Placed]
    ) -> list[MovableObject]:
        """State for a drive ``a`` what the doors that it leads through ask; return the doorways
        that it keeps clear of. ``around``: what else it keeps clear of.
        """
        site, through, clear = self._site, [], []
        others = [*around]
        for name, door in site.records.automatic_doors.items():
            if door.floor != floor_of(site.records, origin):
                continue
            area = doorway_of(site.records, name)
            if self._meter.clears(robot, origin, to, (area, *others)):
                clear.append(site.doorways[name])
            else:
                through.append(door)
        if through:
            _, driven = self._meter.length(robot, origin, to)
            longer = sum(d.opens_in + d.closes_in for d in through)
            longest = a.duration.upper.constant_value() + site.up(longer)
            a.set_duration_bounds(site.up(driven + longer), longest)
        for door in through:
            self._only_open(a, door)
        for lock in sorted({d.airlock for d in through if d.airlock is not None}):
            a.uses(self._airlock(lock))
        return clear

    def _only_open(self, a: Activity, door: AutomaticDoor) -> None:
        """Nobody drives through a door while it is shut."""
        site = self._site
        for closes, opens in door.shut:
            before, after = LE(a.end, site.down(closes)), GE(a.start, site.up(opens))
            site.problem.add_constraint(Or(before, after), present(a))

    def _airlock(self, name: str) -> Fluent:
        """Return the resource whose one unit a drive through any door of an airlock takes."""
        if name not in self._airlocks:
            self._airlocks[name] = self._site.problem.add_resource(f"airlock{MARK}{name}", 1)
        return self._airlocks[name]


def in_doorways(records: FleetRecords, kind: str, name: str) -> Iterator[str]:
    """Yield the automatic doors in whose doorway a robot of a type would be at a pose (a place, or
    a stand of the load that it then has).
    """
    at, _, first = name.partition(MARK)
    load = load_of(records, records.order_of[first]) if first else None
    body = with_load(records.robot_types[kind], load)
    here = Polygon(placed(body.footprint, records.places[at].pose))
    for door, told in records.automatic_doors.items():
        if told.floor == floor_of(records, at) and here.intersects(Polygon(told.polygon)):
            yield door


def check_visits(records: FleetRecords, robot: str, visits: Iterable[Visit]) -> None:
    """Refuse visits at places in a doorway: nobody stands where a door shuts.

    :raises FleetError: that names place and door.
    """
    kind = records.robots[robot].type
    for name in dict.fromkeys(p for visit in visits for p in visit.places):
        for door in in_doorways(records, kind, name):
            what = f"a robot of type '{kind}' would stand in the doorway of '{door}', which it can "
            raise FleetError([Fault(("places", place_of(name)), f"{what}only drive through")])
