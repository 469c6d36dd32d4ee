"""Transport: robots carry items from their pallets from machine to machine and back.

The job shop with transportation as the paper's text tells it: items wait on pallets in the hall, a
robot loads an item, carries it to its next machine and unloads it there; the machine works on it by
itself; in the end every item is back on its pallet. The floor plan is the job shop's. Job data are
drawn from a seed, or the classic ft06 (Fisher and Thompson 1963; optimum without transport: 55).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

from unified_planning.model import Fluent, Object
from unified_planning.model.motion import (
    ConfigurationObject,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import Equals, Iff, UserType

from up_samp.benchmarks import jobshop
from up_samp.benchmarks.builder import Encoding, Family, at_start, check_encoding
from up_samp.benchmarks.logistics import DoorState
from up_samp.benchmarks.places import Pose
from up_samp.model import ProblemError

HANDLING = 2
"""Units that loading and unloading take."""

FT06: tuple[tuple[tuple[int, int], ...], ...] = (
    ((2, 1), (0, 3), (1, 6), (3, 7), (5, 3), (4, 6)),
    ((1, 8), (2, 5), (4, 10), (5, 10), (0, 10), (3, 4)),
    ((2, 5), (3, 4), (5, 8), (0, 9), (1, 1), (4, 7)),
    ((1, 5), (0, 5), (2, 5), (3, 3), (4, 8), (5, 9)),
    ((2, 9), (1, 3), (4, 5), (5, 4), (0, 3), (3, 1)),
    ((1, 3), (3, 3), (5, 9), (0, 10), (4, 4), (2, 1)),
)
"""Routes (machine, duration) of Fisher and Thompson's 6 x 6 job shop."""


def transport(
    robots: int = 2,
    jobs: int = 2,
    machines: int = 2,
    *,
    data: str | None = None,
    door: DoorState = "closed",
    encoding: Encoding = "lean",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a transport problem.

    Per item and leg (from its pallet to its first machine, on to each next one, and back) exactly
    one robot loads (2 units), carries and unloads (2 units), and does nothing else in between.
    Carrying and empty moves are optional motions; each empty move (from the robot's start and
    between machines, pallets and buttons) happens at most once.
    Machines work on one item at a time, without a robot. What a schedule means is told in
    :mod:`up_samp.benchmarks.builder`.

    :param data: ``"ft06"`` takes that job shop's 6 jobs and 6 machines.
    :param door: ``"open"`` leaves doors and buttons away.
    :param encoding: ``lean``: this family has no published form.
    """
    check_encoding(encoding, ("lean",))
    if data not in (None, "ft06") or door not in ("closed", "open"):
        raise ProblemError(f"no such transport setting: data={data!r}, door={door!r}")
    if data == "ft06":
        jobs, machines = len(FT06), len(FT06[0])
    shop = jobshop.draw_shop(robots, jobs, machines, seed)
    floor = shop.floor if door == "closed" else replace(shop.floor, doors=())
    sizes = "" if data else f"-j{jobs}-m{machines}"
    title = f"transport{f'-{data}' if data else ''}-d{door[0]}-r{robots}{sizes}"
    title += f"-s{seed}" if seed else ""
    family = Family(title, floor, a_max=jobshop.ACCELERATION, metric=metric)
    starts = jobshop.add_robots(family, shop)
    stands = [family.place(f"machine{m}", pose) for m, pose in enumerate(shop.machines)]
    spots = pallet_poses(jobs, floor.size[0])
    pallets = [family.place(f"pallet{j}", pose) for j, pose in enumerate(spots)]
    floor.check({**jobshop.shop_poses(shop), **{f"pallet{j}": p for j, p in enumerate(spots)}})
    buttons = jobshop.add_doors(family)
    hands = Loads(family, pallets)
    stops = [*stands, *pallets, *buttons]
    for robot, start in zip(family.robots, starts, strict=True):
        for origin, to in itertools.product([start, *stops], stops):
            if origin is not to:
                hands.empty(robot, family.move(robot, origin, to))
    _jobs(family, hands, FT06 if data == "ft06" else shop.jobs, stands, pallets)
    return family.finish()


def pallet_poses(jobs: int, width: float) -> list[Pose]:
    """Return where robots stand at the items' pallets: a row along the hall at y = 8."""
    return [(round(width * (j + 1) / (jobs + 1), 2), 8.0, math.pi / 2) for j in range(jobs)]


class Loads:
    """What robots carry and where items are: ``carries(robot)`` and ``item_at(item)``."""

    def __init__(self, family: Family, pallets: list[ConfigurationObject]) -> None:
        self.family, item_type = family, UserType("item")
        self.nothing = Object("nothing", item_type)
        self.items = [Object(f"item{j}", item_type) for j in range(len(pallets))]
        self.carries = Fluent("carries", item_type, robot=family.robot_type)
        self.item_at = Fluent("item_at", family.pose_type, item=item_type)
        family.problem.add_objects([self.nothing, *self.items])
        family.problem.add_fluent(self.carries, default_initial_value=self.nothing)
        family.problem.add_fluent(self.item_at, default_initial_value=pallets[0])
        for item, pallet in zip(self.items, pallets, strict=True):
            family.problem.set_initial_value(self.item_at(item), pallet)

    def empty(self, robot: MovableObject, move: Activity) -> None:
        """``move`` is made without a load."""
        move.add_condition(at_start(move), Equals(self.carries(robot), self.nothing))

    def leg(
        self,
        robot: MovableObject,
        trip: tuple[Activity, Activity, Activity],
        item: Object,
        ends: tuple[ConfigurationObject, ConfigurationObject],
    ) -> None:
        """A ``trip`` of ``robot`` (load, carry, unload) takes an item from one place to another."""
        (load, carry, unload), (origin, to) = trip, ends
        for a, b in itertools.pairwise(trip):
            self.family.problem.add_constraint(Iff(a.present, b.present))
            self.family.in_order([a], [b])
        carries, item_at = self.carries(robot), self.item_at
        for a, needs in ((load, self.nothing), (carry, item), (unload, item)):
            a.add_condition(at_start(a), Equals(carries, needs))
        load.add_condition(at_start(load), Equals(item_at(item), origin))
        load.add_effect(load.end, carries, item)
        unload.add_effect(unload.end, carries, self.nothing)
        unload.add_effect(unload.end, item_at(item), to)


def _jobs(
    family: Family,
    hands: Loads,
    routes: tuple[tuple[tuple[int, int], ...], ...],
    stands: list[ConfigurationObject],
    pallets: list[ConfigurationObject],
) -> None:
    """Add every item's legs and operations, in order, and one operation a time per machine."""
    by_machine: list[list[Activity]] = [[] for _ in stands]
    for j, route in enumerate(routes):
        stops = [pallets[j], *(stands[m] for m, _ in route), pallets[j]]
        previous: list[Activity] = []
        for k, (origin, to) in enumerate(itertools.pairwise(stops)):
            loads, unloads = _legs(family, hands, j, k, origin, to)
            family.in_order(previous, loads)
            if k < len(route):
                m, duration = route[k]
                treat = family.problem.add_activity(f"treat_i{j}_m{m}", duration=duration)
                family.in_order(unloads, [treat])
                by_machine[m].append(treat)
                previous = [treat]
    for operations in by_machine:
        family.one_at_a_time(operations)


def _legs(
    family: Family,
    hands: Loads,
    j: int,
    k: int,
    origin: ConfigurationObject,
    to: ConfigurationObject,
) -> tuple[list[Activity], list[Activity]]:
    """Add leg ``k`` of item ``j``, one alternative per robot; return all loads and unloads."""
    loads, unloads = [], []
    for robot in family.robots:
        load = family.work(robot, f"load_{robot.name}_i{j}_{k}", origin, HANDLING)
        carry = family.move(robot, origin, to, f"carry_{robot.name}_i{j}_{k}_to_{to.name}")
        unload = family.work(robot, f"unload_{robot.name}_i{j}_{k}", to, HANDLING)
        hands.leg(robot, (load, carry, unload), hands.items[j], (origin, to))
        loads.append(load)
        unloads.append(unload)
    family.exactly_one(loads)
    return loads, unloads
