"""Loads that travel with robots: where they stand, and where robots stand to take them.

A robot that is about to take a load stands at the order's place, but not as any other robot may
stand there: it may be under the load, and leaves with it. So that pose has a name of its own, a
*stand*: only drives to take the load lead to the one at the pickup, only its ride leads from there
to one at a delivery, and from there the robot drives away alone.
"""

from __future__ import annotations

import math

from shapely.geometry import Polygon

from up_samp.fleet.outlines import body_of, placed, still
from up_samp.fleet.records import Attached, FleetRecords, Order, Pose, RobotType
from up_samp.model import Body
from up_samp.upio.rides import laden_body

MARK = "@"
"""In no name that a user gives."""


def stand(place: str, order: Order) -> str:
    """Return the name of the pose at ``place`` of a robot that takes or puts an order's load."""
    return place if order.attached is None else f"{place}{MARK}{order.id}"


def place_of(name: str) -> str:
    """Return the place that a pose belongs to: a stand's, or itself."""
    return name.partition(MARK)[0]


def ends_of(order: Order) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of an order's poses: at its pickups and at its deliveries."""
    pickups = tuple(stand(p, order) for p in order.pickup.at)
    return pickups, tuple(stand(p, order) for p in order.delivery.at)


def poses_of(records: FleetRecords) -> dict[str, Pose]:
    """Return the poses of all places and stands."""
    poses = {name: place.pose for name, place in records.places.items()}
    for order in attached_of(records):
        for name in (name for end in ends_of(order) for name in end):
            poses[name] = poses[place_of(name)]
    return poses


def attached_of(records: FleetRecords) -> list[Order]:
    """Return the orders whose loads travel with their robots."""
    return [o for o in records.orders if o.attached is not None]


def ridden(records: FleetRecords, origin: str, to: str) -> Order | None:
    """Return the order whose load rides from one pose to another, if that is what the drive is."""
    for order in attached_of(records):
        pickups, deliveries = ends_of(order)
        if origin in pickups and to in deliveries:
            return order
    return None


def load_pose(attached: Attached, robot: Pose) -> Pose:
    """Return where a load is while its robot is at a pose."""
    c, s = math.cos(robot[2]), math.sin(robot[2])
    x, y, turned = attached.offset
    return robot[0] + c * x - s * y, robot[1] + s * x + c * y, robot[2] + turned


NEAR = 0.02
"""Robots come no nearer (m) to what they must keep clear of: who is, drives under its load."""


def is_under(kind: RobotType, attached: Attached) -> bool:
    """Return whether a robot is under (or in) the load that it takes, as seen from above, or
    touches it: then the load is no obstacle on the way to it and away from it.
    """
    load = Polygon(placed(attached.footprint, attached.offset))
    robot = Polygon(placed(kind.footprint, (0.0, 0.0, 0.0)))
    return bool(load.distance(robot) < NEAR)


def with_load(kind: RobotType, attached: Attached) -> Body:
    """Return a robot with a load on it, as one body."""
    return laden_body(body_of(kind), [(still(attached.footprint), attached.offset)])
