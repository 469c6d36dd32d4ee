"""The doorways of doors that open as robots come: who would stand in one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shapely.geometry import Polygon

from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.floors import floor_of
from up_samp.fleet.loads import MARK, load_of, place_of, with_load
from up_samp.fleet.outlines import placed
from up_samp.fleet.records import FleetRecords
from up_samp.fleet.visits import Visit


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
