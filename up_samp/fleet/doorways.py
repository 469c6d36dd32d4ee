"""Where nobody may stand: doorways of doors that open as robots come, zones without stops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shapely.geometry import Polygon

from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.floors import floor_of
from up_samp.fleet.loads import MARK, load_of, place_of, with_load
from up_samp.fleet.outlines import placed
from up_samp.fleet.records import AutomaticDoor, FleetRecords, Zone
from up_samp.fleet.visits import Visit


def in_doorways(records: FleetRecords, kind: str, name: str) -> Iterator[str]:
    """Yield the automatic doors in whose doorway, and the zones without stops in which, a robot of
    a type would be at a pose (a place, or a stand of the load that it then has).
    """
    at, _, first = name.partition(MARK)
    load = load_of(records, records.order_of[first]) if first else None
    body = with_load(records.robot_types[kind], load)
    here = Polygon(placed(body.footprint, records.places[at].pose))
    zones = {
        n: z for n, z in records.zones.items() if (z.stopping, z.heeded_by(kind)) == ("never", True)
    }
    areas: dict[str, AutomaticDoor | Zone] = {**records.automatic_doors, **zones}
    for area, told in areas.items():
        if told.floor == floor_of(records, at) and here.intersects(Polygon(told.polygon)):
            yield area


def check_visits(records: FleetRecords, robot: str, visits: Iterable[Visit]) -> None:
    """Refuse visits at places where nobody may stand.

    :raises FleetError: that names the place, and the door or zone.
    """
    kind = records.robots[robot].type
    for name in dict.fromkeys(p for visit in visits for p in visit.places):
        for area in in_doorways(records, kind, name):
            what = f"a robot of type '{kind}' would stand in '{area}', which it can only "
            raise FleetError([Fault(("places", place_of(name)), f"{what}drive through")])
