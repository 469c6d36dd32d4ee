"""Loads that travel with robots: where they stand, and where robots stand to take them.

A robot that is about to take a load stands at the order's place, but not as any other robot may
stand there: it may be under the load, and leaves with it. So that pose has a name of its own, a
*stand*: only drives to take the load lead to the one at the pickup, only its ride leads from there
to one at a delivery, and from there the robot drives away alone, or it or another one takes the
load on. Orders that carry one load on share its stands.
"""

from __future__ import annotations

from dataclasses import replace

from shapely.geometry import Polygon

from up_samp.fleet.fields import Pose
from up_samp.fleet.outlines import body_of, placed, still
from up_samp.fleet.records import Attached, FleetRecords, Order, RobotType, Stop
from up_samp.model import Body
from up_samp.model.frames import Frame
from up_samp.upio.rides import laden_body

MARK, FURTHER = "@", "+"
"""In no name that a user gives: a stand (or what else belongs to a name), a further carrier."""


def load_name(records: FleetRecords, order: Order) -> str:
    """Return the id of the order that is the first to carry the load of ``order``."""
    while isinstance(order.attached, str):
        order = records.order_of[order.attached]
    return order.id


def load_of(records: FleetRecords, order: Order) -> Attached | None:
    """Return the load of an order that travels with its robot, if it has one."""
    first = records.order_of[load_name(records, order)]
    return None if isinstance(first.attached, str) else first.attached


def place_of(name: str) -> str:
    """Return the place that a pose belongs to: a stand's, or itself."""
    return name.partition(MARK)[0]


Options = dict[str, tuple[str, ...]]
"""Poses at one of which an order's pickup or delivery may be, by a name that tells options apart of
which something else hangs: a mode, or where a load is taken on.
"""


def options_of(records: FleetRecords, order: Order) -> tuple[Options, Options]:
    """Return what an order's pickup and delivery may be."""
    return _options(records, order, order.pickup, False), _options(
        records, order, order.delivery, True
    )


def _options(records: FleetRecords, order: Order, stop: Stop, into: bool) -> Options:
    if stop.task is not None:
        modes = records.task_of[stop.task].modes
        return {n: mode.input if into else (mode.output or mode.input) for n, mode in modes.items()}
    if stop.on is not None:
        return {}
    if order.attached is None:
        return {"": stop.at}
    load = load_name(records, order)
    stands = tuple(f"{p}{MARK}{load}" for p in stop.at)
    taken_on = order.id in records.takers
    chosen = taken_on if into else isinstance(order.attached, str)
    if chosen:
        return {place_of(p): (p,) for p in stands}
    return {"": stands}


def ends_of(records: FleetRecords, order: Order) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of an order's poses: at its pickups and at its deliveries."""
    pickups, deliveries = options_of(records, order)
    return _once(pickups), _once(deliveries)


def _once(options: Options) -> tuple[str, ...]:
    return tuple(dict.fromkeys(p for poses in options.values() for p in poses))


def poses_of(records: FleetRecords) -> dict[str, Pose]:
    """Return the poses of all places and stands."""
    poses = {name: place.pose for name, place in records.places.items()}
    for order in attached_of(records):
        for name in (name for end in ends_of(records, order) for name in end):
            poses[name] = poses[place_of(name)]
    return poses


def attached_of(records: FleetRecords) -> list[Order]:
    """Return the orders whose loads travel with their robots."""
    return [o for o in records.orders if o.attached is not None]


def loads_of(records: FleetRecords) -> list[tuple[Order, Attached]]:
    """Return all loads that travel with robots, each with the first order that carries it."""
    return [(o, o.attached) for o in records.orders if isinstance(o.attached, Attached)]


def ridden(records: FleetRecords, origin: str, to: str) -> Order | None:
    """Return the order whose load rides from one pose to another, if that is what the drive is."""
    for order in attached_of(records):
        pickups, deliveries = ends_of(records, order)
        if origin in pickups and to in deliveries:
            return order
    return None


def seat_of(place: str, order: str, number: int) -> str:
    """Return where an order's carrier of a ``number``, from 2 on, is while the first one is at
    ``place`` (or its stand there).
    """
    return f"{place_of(place)}{FURTHER}{order}{FURTHER}{number}"


def seats_of_carriers(records: FleetRecords) -> dict[str, tuple[str, int]]:
    """Return the places of further carriers: whose load they carry (the order's id), and the how
    many-th of its ``carriers`` they are.
    """
    return {
        seat_of(at, order.id, k + 2): (order.id, k)
        for order, load in loads_of(records)
        for k in range(len(load.carriers))
        for at in (*order.pickup.at, *order.delivery.at)
    }


def follows(order: Order) -> bool:
    """Return whether an order is what a further carrier of a load does, beside the first one."""
    return FURTHER in order.id


def load_pose(attached: Attached, robot: Pose) -> Pose:
    """Return where a load is while its robot is at a pose."""
    return Frame(*robot).of(attached.offset)


NEAR = 0.02
"""Robots come no nearer (m) to what they must keep clear of: who is, drives under its load."""


def is_under(kind: RobotType, attached: Attached, carrier: Pose = (0.0, 0.0, 0.0)) -> bool:
    """Return whether a robot is under (or in) the load that it takes, as seen from above, or
    touches it: then the load is no obstacle on the way to it and away from it. ``carrier``: where
    it is in the frame of the load's first one.
    """
    load = Polygon(placed(attached.footprint, attached.offset))
    robot = Polygon(placed(kind.footprint, carrier))
    return bool(load.distance(robot) < NEAR)


def with_load(kind: RobotType, attached: Attached | None) -> Body:
    """Return a robot with a load on it (if there is one), and with those of its type that carry
    that, too, as one body.
    """
    body = body_of(kind)
    if attached is None:
        return body
    limits = replace(body.kinematics, drives_along=body.mobility.sideways)
    others = [(replace(body, kinematics=limits), pose) for pose in attached.carriers]
    return laden_body(body, [(still(attached.footprint), attached.offset), *others])
