"""Transport: robots carry items from their pallets from machine to machine and back.

The job shop with transportation as the paper's text tells it: items wait on pallets in the hall, a
robot loads an item, carries it to its next machine and unloads it there; the machine works on it by
itself; in the end every item is back on its pallet. The floor plan is the job shop's. Job data are
drawn from a seed, or the classic ft06 (Fisher and Thompson 1963; optimum without transport: 55).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

from unified_planning.model import Fluent, Object
from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, Equals, Iff, UserType

from up_samp.benchmarks import jobshop
from up_samp.benchmarks.logistics import DoorState
from up_samp.benchmarks.places import Pose, scope_of
from up_samp.benchmarks.published import ENCODINGS, Encoding, Form, check_encoding
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


WITH_FLUENTS = tuple(e for e in ENCODINGS if e.startswith("fluents"))
"""What robots carry is told by fluents, whatever else is not."""


def transport(
    robots: int = 2,
    jobs: int = 2,
    machines: int = 2,
    *,
    data: str | None = None,
    door: DoorState = "closed",
    encoding: Encoding = "fluents",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a transport problem.

    Per item and leg (from its pallet to its first machine, on to each next one, and back) exactly
    one robot loads (2 units), carries and unloads (2 units), and does nothing else in between.
    Carrying and empty moves are optional motions; each empty move (from the robot's start and
    between machines, pallets and buttons) happens at most once.
    Machines work on one item at a time, without a robot.

    :param data: ``"ft06"`` takes that job shop's 6 jobs and 6 machines.
    :param door: ``"open"`` leaves doors and buttons away.
    :param encoding: one of ``WITH_FLUENTS``.
    """
    check_encoding(encoding, WITH_FLUENTS)
    if data not in (None, "ft06") or door not in ("closed", "open"):
        raise ProblemError(f"no such transport setting: data={data!r}, door={door!r}")
    if data == "ft06":
        jobs, machines = len(FT06), len(FT06[0])
    shop = jobshop.draw_shop(robots, jobs, machines, seed)
    if door == "open":
        shop = replace(shop, floor=replace(shop.floor, doors=()))
    sizes = "" if data else f"-j{jobs}-m{machines}"
    title = f"transport{f'-{data}' if data else ''}-d{door[0]}-r{robots}{sizes}"
    title += f"-s{seed}" if seed else ""
    spots = {f"pallet{j}": p for j, p in enumerate(pallet_poses(jobs, shop.floor.size[0]))}
    shop.floor.check({**jobshop.shop_poses(shop), **spots})
    form, _, stands, buttons = jobshop.shop_form(title, shop, encoding, metric)
    pallets = list(itertools.starmap(form.place, spots.items()))
    hands = Hands(form, pallets)
    stops = [*stands, *pallets, *buttons]
    for robot in form.robots:
        for origin, to in itertools.product([robot.start, *stops], stops):
            if origin is not to:
                move = form.move(robot, origin, to)
                form.needs_at_start(move, Equals(hands.carries[robot.name], hands.nothing))
    form.openings()
    _jobs(form, hands, FT06 if data == "ft06" else shop.jobs, stands, pallets)
    return form.finish()


def pallet_poses(jobs: int, width: float) -> list[Pose]:
    """Return where robots stand at the items' pallets: a row along the hall at y = 8."""
    return [(round(width * (j + 1) / (jobs + 1), 2), 8.0, math.pi / 2) for j in range(jobs)]


class Hands:
    """What robots carry (``carries``, by robot) and where items are (``item_at``)."""

    def __init__(self, form: Form, pallets: Sequence[ConfigurationObject]) -> None:
        self.form, item_type = form, UserType("item")
        self.nothing = Object("nothing", item_type)
        self.items = [Object(f"item{j}", item_type) for j in range(len(pallets))]
        form.problem.add_objects([self.nothing, *self.items])
        self.carries = {r.name: Fluent(f"{r.name}_carries", item_type) for r in form.robots}
        self.item_at = [Fluent(f"{item.name}_at", form.pose_type) for item in self.items]
        for carries in self.carries.values():
            form.problem.add_fluent(carries, default_initial_value=self.nothing)
        for item_at, pallet in zip(self.item_at, pallets, strict=True):
            form.problem.add_fluent(item_at, default_initial_value=pallet)

    def leg(
        self, j: int, k: int, origin: ConfigurationObject, to: ConfigurationObject
    ) -> tuple[list[Activity], list[Activity]]:
        """Add leg ``k`` of item ``j``, one alternative per robot (it loads, carries, and unloads);
        return all loads and unloads.
        """
        form, item, item_at = self.form, self.items[j], self.item_at[j]
        loads, unloads = [], []
        for robot in form.robots:
            carries = self.carries[robot.name]
            load = form.work(robot, f"load_{robot.name}_i{j}_{k}", [origin], HANDLING)
            carry = form.move(robot, origin, to, f"carry_{robot.name}_i{j}_{k}_to_{to.name}")
            unload = form.work(robot, f"unload_{robot.name}_i{j}_{k}", [to], HANDLING)
            for a, b in itertools.pairwise((load, carry, unload)):
                form.problem.add_constraint(Iff(a.present, b.present))
                _in_order(form, [a], [b])
            for a, needs in ((load, self.nothing), (carry, item), (unload, item)):
                form.needs_at_start(a, Equals(carries, needs))
            form.needs_at_start(load, Equals(item_at, origin))
            load.add_effect(form.done(load), carries, item)
            unload.add_effect(form.done(unload), carries, self.nothing)
            unload.add_effect(form.done(unload), item_at, to)
            loads.append(load)
            unloads.append(unload)
        form.exactly_one(loads, inside=False)
        return loads, unloads


def _in_order(form: Form, first: Sequence[Activity], then: Sequence[Activity]) -> None:
    """Every present activity of ``first`` ends before every present one of ``then`` starts."""
    for a, b in itertools.product(first, then):
        form.problem.add_constraint(GE(b.start, a.end), scope=scope_of(a, b))


def _jobs(
    form: Form,
    hands: Hands,
    routes: Sequence[Sequence[tuple[int, int]]],
    stands: Sequence[ConfigurationObject],
    pallets: Sequence[ConfigurationObject],
) -> None:
    """Add every item's legs and operations, in order, and one operation a time per machine."""
    by_machine: list[list[Activity]] = [[] for _ in stands]
    for j, route in enumerate(routes):
        stops = [pallets[j], *(stands[m] for m, _ in route), pallets[j]]
        previous: list[Activity] = []
        for k, (origin, to) in enumerate(itertools.pairwise(stops)):
            loads, unloads = hands.leg(j, k, origin, to)
            _in_order(form, previous, loads)
            if k < len(route):
                m, duration = route[k]
                treat = form.problem.add_activity(f"treat_i{j}_m{m}", duration=duration)
                _in_order(form, unloads, [treat])
                by_machine[m].append(treat)
                previous = [treat]
    for operations in by_machine:
        form.one_at_a_time(operations)
