"""Buildings: a few robots carry orders between places in rooms along a corridor, or among shelves.

Stated in the words of :class:`up_samp.fleet.Fleet`, as sites state it. In ``rooms`` a corridor runs
through the middle, and each room has one door to it; in ``aisles`` shelves stand in a hall. All
robots are of one kind: cars, differential drives, or ones that move in any direction; each carries
``loads`` orders at once and ends where it began. Everything is drawn from a seed.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from typing import Literal

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.benchmarks.places import Rectangle, drawn_map, drawn_name, outer_wall
from up_samp.fleet import Fleet
from up_samp.model import ProblemError

BuildingKind = Literal["rooms", "aisles"]
BUILDING_KINDS: tuple[BuildingKind, ...] = ("rooms", "aisles")
Pair = tuple[float, float]
"""Where a robot may stand (x, y), or a width and a height; m."""

SIZE, LIMITS = (0.8, 0.5), {"v_max": 1.2, "a_max": 0.6}
"""Length and width of a robot (m); speed (m/s) and acceleration (m/s²)."""
MODELS = (
    {"model": "diff", "omega_max": 1.0, "reverse_cost": 1},
    {"model": "car", "turning_radius": 0.6, "reverse_cost": 1},
    {"model": "omni", "omega_max": 1.0},
)
"""What robots of a building are: one of these."""
CORRIDOR, DOOR, SHELF, PARTITION = 3.2, 1.8, 1.2, 0.2
"""Widths of the corridor, of doors and of shelves, and thickness of inner walls (m)."""
APART = 1.6
"""Metres that places are apart at least, so that robots may stand at all of them."""


def building(
    robots: int = 2,
    orders: int = 6,
    loads: int = 1,
    *,
    kind: BuildingKind = "rooms",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a problem in a building: robots that carry ``loads`` orders at once.

    :raises ProblemError: for an unknown kind, or without robots, orders or loads.
    """
    if kind not in BUILDING_KINDS or min(robots, orders, loads) < 1:
        known = ", ".join(BUILDING_KINDS)
        raise ProblemError(
            f"a building is one of {known} and needs robots, orders and loads, not {kind!r}, "
            f"{robots}, {orders} and {loads}"
        )
    several = f"-c{loads}" if loads > 1 else ""
    title = drawn_name(f"building-{kind}-r{robots}-o{orders}{several}", seed)
    rng = random.Random(title)
    places = rng.randint(4, 5) + orders // 2
    size, walls, spots = building_floor(kind, robots + places, rng)
    fleet = Fleet(drawn_map(title, size, walls), name=title, objective=_OBJECTIVE[metric])
    capacity = {"capacity": {"item": loads}} if loads > 1 else {}
    fleet.add_robot_type("agv", SIZE, **LIMITS, **rng.choice(MODELS), **capacity)
    for r in range(robots):
        fleet.add_place(f"home{r}", *spots.pop())
        fleet.add_robot(f"robot{r}", "agv", f"home{r}", end=f"home{r}")
    names = [f"place{i}" for i in range(places)]
    for name, spot in zip(names, spots, strict=False):  # spots may be more
        fleet.add_place(name, *spot)
    for k in range(orders):
        pickup, delivery = rng.sample(names, 2)
        at = {"pickup": pickup, "delivery": delivery}
        work = {stop: {"at": [place], "service": rng.randint(2, 6)} for stop, place in at.items()}
        fleet.add_order(f"order{k}", **work)
    return fleet.problem


def building_floor(
    kind: BuildingKind, needed: int, rng: random.Random
) -> tuple[Pair, list[Rectangle], list[Pair]]:
    """Return the size (m), the walls, and where ``needed`` robots or more may stand."""
    wide = 12 + 0.8 * needed
    size = round(wide + rng.uniform(0, 6), 1), round(rng.uniform(12, 17), 1)
    walls, spots = (_rooms if kind == "rooms" else _aisles)(rng, size, needed)
    return size, walls, spots


_OBJECTIVE = {True: "makespan", False: "none"}


def _rooms(rng: random.Random, size: Pair, needed: int) -> tuple[list[Rectangle], list[Pair]]:
    """Return walls and spots of rooms on both sides of a corridor, three in each room."""
    width, height = size
    middle, walls = height / 2, outer_wall(width, height)
    rooms = max(rng.randint(2, 4), math.ceil(needed / 6))
    spots: list[Pair] = []
    for side in (-1, 1):
        wall = middle + side * CORRIDOR / 2
        far = height if side > 0 else 0.0
        doors = [width * (i + rng.uniform(0.3, 0.7)) / rooms for i in range(rooms)]
        ends = [0.0, *itertools.chain(*((d - DOOR / 2, d + DOOR / 2) for d in doors)), width]
        walls += [
            (a, wall - PARTITION / 2, b, wall + PARTITION / 2)
            for a, b in zip(ends[::2], ends[1::2], strict=True)
        ]
        for i in range(1, rooms):
            x = width * i / rooms
            walls.append((x - PARTITION / 2, min(wall, far), x + PARTITION / 2, max(wall, far)))
        for i, (share, y) in itertools.product(
            range(rooms),
            ((0.22, far - 1.2 * side), (0.5, (wall + far) / 2), (0.78, far - 1.2 * side)),
        ):
            spots.append((width * (i + share) / rooms, y))
    return walls, _apart(rng, spots)


def _aisles(rng: random.Random, size: Pair, needed: int) -> tuple[list[Rectangle], list[Pair]]:
    """Return walls of a hall with shelves, and spots: beside them, and along one side."""
    width, height = size
    walls, spots = outer_wall(width, height), list[Pair]()
    levels = 1 + int((height - 8.0) / APART)
    shelves = max(rng.randint(3, 5), math.ceil((needed - 5) / levels))
    for i in range(shelves):
        x = width * (i + 1) / (shelves + 1)
        walls.append((x - SHELF / 2, 3.2, x + SHELF / 2, height - 3.2))
        step = (height - 8.0) / (levels - 1)
        spots += [(x + SHELF / 2 + 0.9, 4.0 + step * level) for level in range(levels)]
    spots += [(2.0 + i * (width - 4.0) / 4, 1.4) for i in range(5)]
    return walls, _apart(rng, spots)


def _apart(rng: random.Random, spots: list[Pair]) -> list[Pair]:
    """Return spots in random order, none close to one before it."""

    def kept() -> Iterator[Pair]:
        found: list[Pair] = []
        for spot in rng.sample(spots, len(spots)):
            if all(math.dist(spot, other) >= APART for other in found):
                found.append(spot)
                yield spot

    return list(kept())
