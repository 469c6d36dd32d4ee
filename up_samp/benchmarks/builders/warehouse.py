"""Warehouse: a mixed fleet carries orders from shelves to stations at the rim.

Blocks of shelves stand in rows; between two blocks is an aisle, by turns for one robot and for two,
and between two rows of blocks, and around them all, are ways for two. Robots start at docks along
the lower rim, stations stand along the upper one. An order waits at a place in an aisle; one robot
drives there, loads it, brings it to a station and unloads it. Some orders have a latest end, and of
each pair of optional orders one has to be done. Everything is drawn from a seed.

After unloading a robot may go back to its dock: there are fewer stations than robots. It does one
thing at a time because each activity uses it; a variable tells who takes an order.

There are two encodings. ``compact``: five activities for each robot and order; an empty drive
starts wherever the robot's fluent says that it is. ``moves``: an empty drive for each order and
each place where a robot may come from (its dock, the stations).
"""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass
from typing import Literal

from unified_planning.model import Fluent
from unified_planning.model.motion import (
    ActivityWaypoints,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import LE, LT, Equals, IntType, MovableType, Or

from up_samp.benchmarks.places import (
    Pose,
    ProblemOnMap,
    Rectangle,
    drawn_map,
    drawn_name,
    outer_wall,
)
from up_samp.model import ProblemError
from up_samp.upio.expressions import at_start, present

SHELF = (1.4, 6.0)
"""Width and length (m) of a block of shelves."""
NARROW, WIDE = 2.0, 3.4
"""Widths (m) of aisles for one robot and for two, and of the ways between rows of blocks."""
RIM = 4.0
"""Width (m) of the way around the blocks, where docks and stations are."""
FOOTPRINT = ((-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4))
V_MAX, A_MAX, OMEGA_MAX = 1.5, 1.0, 1.5
RADII: tuple[float | None, ...] = (1.0, 0.0, None)
"""Turning radii of the fleet's robots in turn: a car, one that turns on the spot, one that moves in
any direction."""
SERVICE = (2, 3, 5)
"""Units that loading and unloading may take."""
HORIZON = 10_000
WarehouseEncoding = Literal["moves", "compact"]
WAREHOUSE_ENCODINGS: tuple[WarehouseEncoding, ...] = ("moves", "compact")


@dataclass(frozen=True)
class WarehouseLayout:
    """A floor plan: size (m), walls and shelves, and where robots can stand (x, y, theta)."""

    size: tuple[float, float]
    walls: tuple[Rectangle, ...]
    docks: tuple[Pose, ...]
    stations: tuple[Pose, ...]
    slots: tuple[Pose, ...]


@dataclass(frozen=True)
class TransportOrder:
    """From a slot to a station (indices); ``service``: units of loading and unloading; ``due``:
    latest end (units), if there is one; ``optional``: see the module.
    """

    slot: int
    station: int
    service: tuple[int, int]
    due: int | None
    optional: bool


def store(robots: int) -> WarehouseLayout:
    """Return the floor plan for that many robots: about three aisles for four of them."""
    rows = max(2, round(math.sqrt(robots / 5)) + 1)
    columns = max(3, math.ceil(1.5 * robots / rows) + 1)
    aisles = [NARROW if i % 2 == 0 else WIDE for i in range(columns - 1)]
    lefts = [RIM + i * SHELF[0] + sum(aisles[:i]) for i in range(columns)]
    lows = [RIM + j * (SHELF[1] + WIDE) for j in range(rows)]
    width, height = lefts[-1] + SHELF[0] + RIM, lows[-1] + SHELF[1] + RIM
    width = max(width, 2.2 * robots + 4.0)
    blocks = [(x, y, x + SHELF[0], y + SHELF[1]) for x, y in itertools.product(lefts, lows)]
    slots = [
        (round(x + SHELF[0] + aisle / 2, 2), round(y + share * SHELF[1], 2), math.pi / 2)
        for (x, aisle), y, share in itertools.product(
            zip(lefts[:-1], aisles, strict=True), lows, (0.25, 0.75)
        )
    ]
    stands = max(2, robots // 2)
    return WarehouseLayout(
        (round(width, 1), round(height, 1)),
        (*outer_wall(width, height), *blocks),
        tuple((2.0 + 2.2 * i, 1.2, math.pi / 2) for i in range(robots)),
        tuple(
            (round(width * (i + 1) / (stands + 1), 2), round(height - 1.2, 2), math.pi / 2)
            for i in range(stands)
        ),
        tuple(slots),
    )


def draw_orders(plan: WarehouseLayout, orders: int, seed: int) -> list[TransportOrder]:
    """Draw orders: every fifth has a latest end, which leaves time for long ways, of the
    rest every fourth is optional.
    """
    rng = random.Random(1000 * orders + seed)
    free: list[int] = []
    found = []
    for k in range(orders):
        if not free:
            free = rng.sample(range(len(plan.slots)), len(plan.slots))
        service = rng.choice(SERVICE), rng.choice(SERVICE)
        station, slot, due = rng.randrange(len(plan.stations)), free.pop(), None
        if k % 5 == 4:
            alone = _least(plan, slot, station) + sum(service)
            due = max(120 + 60 * (k // max(1, len(plan.docks))), math.ceil(1.25 * alone))
        found.append(TransportOrder(slot, station, service, due, due is None and k % 4 == 3))
    return found


def _least(plan: WarehouseLayout, slot: int, station: int) -> float:
    """Return about what the drives of an order take whoever begins the nearest (s)."""
    x, y, _ = plan.slots[slot]
    to_x, to_y, _ = plan.stations[station]
    coming = min(abs(x - a) + abs(y - b) for a, b, _ in plan.docks)
    return (coming + abs(x - to_x) + abs(y - to_y)) / V_MAX


def warehouse(
    robots: int = 5,
    orders: int = 10,
    *,
    encoding: WarehouseEncoding = "moves",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a warehouse problem (``encoding``: see the module)."""
    if encoding not in WAREHOUSE_ENCODINGS:
        raise ProblemError(f"encoding must be one of {WAREHOUSE_ENCODINGS}, not {encoding!r}")
    if min(robots, orders) < 1:
        raise ProblemError(f"a warehouse needs robots and orders, not {robots} and {orders}")
    plan = store(robots)
    form = "compact-" if encoding == "compact" else ""
    title = drawn_name(f"warehouse-{form}r{robots}-o{orders}", seed)
    work = _Work(title, plan, compact=bool(form), metric=metric)
    drawn = draw_orders(plan, orders, seed)
    works = list(itertools.starmap(work.order, enumerate(drawn)))
    pending: list[Activity] = []
    for order, loads in zip(drawn, works, strict=True):
        if not order.optional:
            work.problem.add_constraint(Or([a.present for a in loads]))
            continue
        pending = [*pending, *loads]
        if len(pending) > len(loads):
            work.problem.add_constraint(Or([a.present for a in pending]))
            pending = []
    return work.problem


class _Work(ProblemOnMap):
    """A warehouse problem under construction."""

    def __init__(
        self, title: str, plan: WarehouseLayout, *, compact: bool, metric: bool = True
    ) -> None:
        file = drawn_map(f"warehouse-{len(plan.docks)}", plan.size, plan.walls)
        super().__init__(title, str(file), metric=metric)
        self.plan, self.compact = plan, compact
        robot_type = MovableType("robot")
        self.robot_at = Fluent("robot_at", self.pose_type, robot=robot_type)
        self.problem.add_fluent(self.robot_at)
        self.slots = [self.place(f"slot{i}", pose) for i, pose in enumerate(plan.slots)]
        self.stations = [self.place(f"station{i}", pose) for i, pose in enumerate(plan.stations)]
        self.docks: list[ConfigurationObject] = []
        self.robots = [self._robot(r, pose, robot_type) for r, pose in enumerate(plan.docks)]
        self.hands = [self.problem.add_resource(f"hands{r}", 1) for r in range(len(plan.docks))]

    def _robot(self, r: int, dock: Pose, kind: MovableType) -> MovableObject:
        radius = RADII[r % len(RADII)]
        parameters = {"v_max": V_MAX, "a_max": A_MAX, "omega_max": OMEGA_MAX}
        if radius is not None:
            parameters["turning_radius"] = radius
        start = self.place(f"dock{r}", dock)
        self.docks.append(start)
        model = MotionModels.SE2 if radius is None else MotionModels.REEDSSHEPP
        robot = self.body(f"robot{r}", kind, FOOTPRINT, start, model, motion_parameters=parameters)
        self.problem.set_initial_value(self.robot_at(robot), start)
        return robot

    def order(self, k: int, order: TransportOrder) -> list[Activity]:
        """Add what each robot can do for an order; return all robots' loading."""
        who = self.problem.add_variable(f"robot_of_order{k}", IntType(0, len(self.robots) - 1))
        loads = [self._job(r, k, order) for r in range(len(self.robots))]
        for r, load in enumerate(loads):
            self.problem.add_constraint(Equals(who, r), scope=[load.present])
        return loads

    def _job(self, r: int, k: int, order: TransportOrder) -> Activity:
        robot, at = self.robots[r], self.robot_at(self.robots[r])
        slot, station = self.slots[order.slot], self.stations[order.station]
        title = f"{robot.name}_order{k}"
        load = self._serve(f"load_{title}", order.service[0])
        carry = self._move(f"carry_{title}", robot, slot, station)
        unload = self._serve(f"unload_{title}", order.service[1])
        leave = self._move(f"leave_{title}", robot, station, self.docks[r])
        leave.add_condition(at_start(leave), Equals(at, station))
        self.problem.add_constraint(unload.present, scope=[leave.present])
        self.problem.add_constraint(LT(unload.end, leave.start), scope=present(unload, leave))
        fetches = self._fetches(r, title, slot)
        for a in (*fetches, load, carry, unload, leave):
            a.uses(self.hands[r])
        for a, b in itertools.pairwise((load, carry, unload)):
            self.problem.add_constraint(b.present, scope=[a.present])
            self.problem.add_constraint(a.present, scope=[b.present])
            self.problem.add_constraint(LT(a.end, b.start), scope=present(a, b))
        for fetch in fetches:
            self.problem.add_constraint(load.present, scope=[fetch.present])
            self.problem.add_constraint(LT(fetch.end, load.start), scope=present(fetch, load))
        self.problem.add_constraint(Or([f.present for f in fetches]), scope=[load.present])
        load.add_condition(at_start(load), Equals(at, slot))
        carry.add_condition(at_start(carry), Equals(at, slot))
        unload.add_condition(at_start(unload), Equals(at, station))
        if order.due is not None:
            self.problem.add_constraint(LE(unload.end, order.due), scope=present(unload))
        return load

    def _fetches(self, r: int, title: str, slot: ConfigurationObject) -> list[Activity]:
        """Return the empty drives of a robot to an order's slot."""
        robot, at = self.robots[r], self.robot_at(self.robots[r])
        if self.compact:
            return [self._move(f"fetch_{title}", robot, at, slot)]
        found = []
        for origin in (self.docks[r], *self.stations):
            move = self._move(f"fetch_{title}_from_{origin.name}", robot, origin, slot)
            move.add_condition(at_start(move), Equals(at, origin))
            found.append(move)
        return found

    def _move(self, name: str, robot: MovableObject, origin: object, to: object) -> Activity:
        a = self.problem.add_motion_activity(name, optional=True)
        a.set_duration_bounds(1, HORIZON)
        a.add_motion_constraint(ActivityWaypoints(robot, origin, [to]))
        a.add_effect(a.end, self.robot_at(robot), to)
        return a

    def _serve(self, name: str, duration: int) -> Activity:
        # names are told apart by robot and order; add_activity compares each with all before it
        activity = Activity(name=name, duration=duration, optional=True)
        self.problem._activities.append(activity)
        return activity
