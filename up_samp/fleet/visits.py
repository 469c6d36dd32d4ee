"""Visits: what each robot may do where, which moves that takes, and where nobody may stand.

A *visit* is something a robot does at one of several places. How often a robot may have to drive
from one place to another follows from which visits can come right after each other: a move is an
activity that happens once at most, so there are as many of it as may be needed, and no more.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from shapely.geometry import Polygon

from up_samp.fleet.faults import Fault, FleetError, earlier_than
from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.floors import floor_of, legs_between, lift_between
from up_samp.fleet.loads import MARK, follows, load_of, options_of, place_of, ridden, with_load
from up_samp.fleet.meanings import Kind
from up_samp.fleet.outlines import placed
from up_samp.fleet.records import (
    AutomaticDoor,
    FleetRecords,
    Order,
    Task,
    Zone,
    can_do,
    needs_robot,
    seats_of,
    visited,
)


@dataclass(frozen=True)
class Visit:
    """``what`` (an order, a task, a door) is done by ``robot`` at one of ``places``.

    ``number`` tells visits apart that are alike (parking), ``option`` those of which others depend.
    """

    robot: str
    kind: Kind
    what: str
    places: tuple[str, ...]
    number: int = 0
    option: str = ""

    @property
    def name(self) -> str:
        """The name of its activity."""
        name = f"{self.kind.value}_{self.what}_{self.robot}"
        match self.kind:
            case Kind.CHARGE:
                return f"charge_{self.robot}_at_{self.what}_{self.number + 1}"
            case Kind.OPEN if self.number:
                return f"{name}_{self.number + 1}"
            case Kind.TASK:
                name = f"{self.what}_{self.robot}"
        return f"{name}_at_{self.option}" if self.option else name


WORK = (Kind.PICKUP, Kind.DELIVERY, Kind.TASK, Kind.OPEN, Kind.CHARGE)
"""Kinds that are activities; at the others a robot only is."""

ENDS = (Kind.PICKUP, Kind.DELIVERY)
JOBS = (*ENDS, Kind.TASK)


def visits_of(records: FleetRecords, robot: str) -> list[Visit]:
    """Return all visits that ``robot`` may make, its start first."""
    mine = records.robots[robot]
    visits = [Visit(robot, Kind.START, mine.start, (mine.start,))]
    for order in records.orders:
        if can_do(records, robot, order):
            for kind_, options in zip(ENDS, options_of(records, order), strict=True):
                for name, poses in options.items():
                    visits.append(Visit(robot, kind_, order.id, poses, 0, name))
    visits += [
        Visit(robot, Kind.TASK, task.id, places, 0, seat)
        for task in filter(needs_robot, records.tasks)
        if can_do(records, robot, task)
        for seat, places in seats_of(task).items()
    ]
    visits += [
        Visit(robot, Kind.OPEN, name, door.opened_from, i)
        for name, door in records.doors.items()
        if set(door.skills) <= set(mine.skills)
        for i in range(door.times)
    ]
    charges = records.robot_types[mine.type].battery is not None
    for name, place in records.places.items() if charges else ():
        times = 0 if place.charger is None else place.charger.times
        visits += [Visit(robot, Kind.CHARGE, name, (name,), i) for i in range(times)]
    # where it may rest, and how often
    parking = {p: place.park for p, place in records.places.items() if place.park is not None}
    for name, times in ({mine.start: rests_at_start(records, robot)} | parking).items():
        visits += [Visit(robot, Kind.PARK, name, (name,), i) for i in range(times)]
    if mine.end is not None:
        visits.append(Visit(robot, Kind.END, mine.end, (mine.end,)))
    return visits


def rests_at_start(records: FleetRecords, robot: str) -> int:
    """Return how often a robot may come back to where it starts, to rest there, if that place says
    nothing of it: once, and once more for each one of its share of the jobs that have to wait for
    their time.
    """
    mine = (job for job in records.jobs if needs_robot(job) and can_do(records, robot, job))
    share = math.ceil(sum(map(_waits, mine)) / len(records.robots))
    return min(1 + share, FILE_LIMITS.visits)


def _waits(job: Order | Task) -> bool:
    """Return whether a job cannot be done at once: it is released later, or its windows open
    later.
    """
    parts = visited(job)
    return job.release > 0.0 or any(p.window and p.window[0][0] > 0.0 for p in parts)


NEVER = frozenset(
    {
        *((kind, Kind.START) for kind in Kind),
        *((Kind.END, kind) for kind in Kind),
        (Kind.START, Kind.DELIVERY),
        (Kind.PICKUP, Kind.END),
        (Kind.PARK, Kind.PARK),
    }
)
"""Kinds of visits of which the second never comes right after the first."""


class Successions:
    """Which visits of a robot can come right after each other."""

    def __init__(self, records: FleetRecords, robot: str) -> None:
        self._records = records
        self._skills = set(records.robots[robot].skills)
        kind = records.kind_of(robot)
        self._orders = records.order_of
        self._after = {j.id: set(earlier_than(records, j)) for j in records.jobs}
        self._capacity = kind.capacity
        others = records.robots.keys() - {robot}
        alone = (
            not any(can_do(records, other, job) for other in others)
            for job in filter(needs_robot, records.jobs)
            if not job.optional and can_do(records, robot, job)
        )
        # who has work that nobody else may do does not end its day first
        self._never = NEVER | ({(Kind.START, Kind.END)} if any(alone) else frozenset())
        self._on_board = {order.id for order in records.on_board(robot)}

    def possible(self, a: Visit, b: Visit) -> bool:
        """Return whether ``b`` may be the next visit after ``a``."""
        if (a.kind, b.kind) == (Kind.START, Kind.DELIVERY) and b.what in self._on_board:
            return True
        if a == b or (a.kind, b.kind) in self._never:
            return False
        if a.kind is b.kind is Kind.TASK and a.what == b.what:
            return False
        if a.what in self._orders and a.what == b.what:
            return (a.kind, b.kind) == ENDS
        if self._rides(a, Kind.PICKUP) or self._rides(b, Kind.DELIVERY):
            return False  # from the one to the other, and nowhere else
        if a.kind in WORK and b.what in self._after.get(a.what, ()):
            return False
        if a.what in self._orders and b.what in self._orders:
            apart = a.kind is Kind.DELIVERY and b.kind is Kind.PICKUP
            return apart or self.together(a.what, b.what)
        return True

    def legs(self, a: Visit, origin: str, b: Visit, to: str) -> Iterator[tuple[str, str]]:
        """Yield the drives and rides of a robot from the one to the other at these poses; where a
        load rides from pose to pose, nobody drives without it.
        """
        if origin != to and (a.what == b.what or ridden(self._records, origin, to) is None):
            for way in legs_between(self._records, origin, to):
                if all(itertools.starmap(self._may_ride, way)):
                    yield from way

    def _may_ride(self, origin: str, to: str) -> bool:
        lift = lift_between(self._records, origin, to)
        return lift is None or set(self._records.lifts[lift].skills) <= self._skills

    def _rides(self, visit: Visit, kind: Kind) -> bool:
        """Return whether a visit is of that kind, of an order whose load travels with the robot, or
        of a further carrier of one.
        """
        order = self._orders.get(visit.what)
        travels = order is not None and (order.attached is not None or follows(order))
        return visit.kind is kind and travels

    def together(self, a: str, b: str) -> bool:
        """Return whether the robot can carry both orders' loads at the same time."""
        return fit(self._records, (self._orders[a], self._orders[b]), self._capacity)


def fit(records: FleetRecords, some: tuple[Order, Order], capacity: Mapping[str, int]) -> bool:
    """Return whether a robot can carry two orders' loads at the same time: they have room, and none
    of them is carried together with other robots.
    """
    total = Counter[str]()
    for order in some:
        total.update(order.load)
    alone = records.crews.isdisjoint(order.id for order in some)
    return alone and all(amount <= capacity.get(kind, 0) for kind, amount in total.items())


def moves_needed(visits: list[Visit], successions: Successions) -> dict[tuple[str, str], int]:
    """Return how often a robot may have to drive from one place to another.

    No schedule needs more: each drive leads from one visit to the next one, and each visit is made
    once.
    """
    pairs = itertools.product(visits, repeat=2)
    follows = [pair for pair in pairs if successions.possible(*pair)]
    leave: dict[tuple[str, str], set[Visit]] = {}
    reach: dict[tuple[str, str], set[Visit]] = {}
    for a, b in follows:
        for p, q in itertools.product(a.places, b.places):
            for leg in successions.legs(a, p, b, q):
                leave.setdefault(leg, set()).add(a)
                reach.setdefault(leg, set()).add(b)
    return {pair: min(len(leave[pair]), len(reach[pair])) for pair in leave}


# ------------------ Where nobody may stand: doorways that open as robots come, zones without stops


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
