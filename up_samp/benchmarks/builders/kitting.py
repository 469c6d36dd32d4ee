"""Kitting: robots collect the parts of kits from rooms with doors and unload them at their starts.

Published beside the paper's families. Rooms stand in a row, one above and one below an aisle, each
pair 9.2 m wide; doors come in pairs, slide open by 7 m to the left, and have their buttons in the
aisle, 1.5 m before them (robots stand along the wall there). A kit's parts are loaded in order by
one robot (a bool variable of the problem says by which); unloading happens while the kit's
unloading is being prepared. Where parts lie in the rooms, and where robots start, is this package's
own choice, and drawn from seeds other than 0, as are how wide the aisle is and the robots' shape.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence

from unified_planning.model import Parameter
from unified_planning.model.motion import ConfigurationObject, MotionModels, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, BoolType, Iff, Implies, Not, Or, Plus

from up_samp.benchmarks.instances import Encoding
from up_samp.benchmarks.places import (
    DOWN,
    UP,
    FamilyDoor,
    FamilyFloor,
    Pose,
    box,
    check_sizes,
    drawing,
    drawn_name,
    outer_wall,
)
from up_samp.benchmarks.published import Form, Manner
from up_samp.model import ProblemError

HALL = (30.0, 30.0)


ROOM, LOWER, UPPER = 9.2, 11.0, 19.8
"""Width of a room, and where the doors below and above the aisle are (y), m."""
SLIDE, BEFORE = 7.0, 1.5
"""How far doors slide open, and how far before its door a button is (m)."""
MOST_ROBOTS, MOST_PARTS = 4, 6
"""How many robots it takes, and how many parts in a room."""
LOADING, UNLOADING, PREPARING = 5, 5, 30
"""Units that loading a part, unloading and preparing an unloading take."""
UNLOAD_WITHIN = (10, 20)
"""When to unload: units after the preparation's start."""


def kitting_floor(doors: int, rng: random.Random | None, name: str) -> FamilyFloor:
    """Return the building, with walls 0.6 m thick and gaps of 4.4 m at the doors (even ones below
    the aisle, odd ones above it): the usual one, or one drawn from ``rng``.
    """
    lines = [LOWER, UPPER]
    if rng is not None:
        lines = [round(LOWER - rng.uniform(0, 2), 1), round(UPPER + rng.uniform(0, 2), 1)]
    size = (HALL[0] + ROOM * (doors // 2 - 1), HALL[1])
    leaves = []
    for i in range(doors):
        x, y, inward = 25.0 + ROOM * (i // 2), lines[i % 2], (1.0, -1.0)[i % 2]
        button = (x, round(y + inward * BEFORE, 3), 0.0)
        leaves.append(FamilyDoor(f"door{i}", box(1, 4.2), (x, y, UP), (x - SLIDE, y, UP), button))
    walls = outer_wall(*size)
    for y in lines:
        left = 25.0 - ROOM / 2
        for pair in range(doors // 2):
            x = 25.0 + ROOM * pair
            walls.append((round(left, 1), y - 0.3, x - 2.2, y + 0.3))
            left = x + 2.2
        walls.append((round(left, 1), y - 0.3, size[0], y + 0.3))
    for pair in range(doors // 2 + 1):
        x = round(25.0 - ROOM / 2 + ROOM * pair, 1)
        walls += [(x - 0.2, 0.0, x + 0.2, lines[0]), (x - 0.2, lines[1], x + 0.2, size[1])]
    floor = FamilyFloor(name, size, walls, leaves)
    return floor.reshaped(rng)


def kitting(
    robots: int = 2,
    kits: int = 2,
    parts: int = 3,
    doors: int = 2,
    *,
    encoding: Encoding = "fluents",
    operator: bool = False,
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a kitting problem.

    :param doors: 2, 4 or 6; one room behind each.
    :param operator: loading and unloading need the one operator, too.
    """
    _check_sizes(robots, kits, parts, doors)
    sizes = f"kitting-r{robots}-k{kits}-p{parts}-d{doors}"
    title = drawn_name(sizes, seed)
    rng = drawing(title, seed)
    floor = kitting_floor(doors, rng, title)
    starts, spots = _places(floor, robots, [*itertools.product(range(kits), range(parts))], rng)
    floor.check(starts | spots | {f"{leaf.name}_button": leaf.button for leaf in floor.doors})
    manner = Manner(floor, guess=1.0, early=0, model=MotionModels.SE2)
    name = drawn_name(f"{sizes}-op", seed) if operator else title
    form = Form(name, manner, encoding, metric)
    homes = list(itertools.starmap(form.place, starts.items()))
    for home in homes:
        form.robot(home)
    places = {key: form.place(key, pose) for key, pose in spots.items()}
    stops = [form.door(leaf).button for leaf in floor.doors]
    for robot in form.robots:
        for origin, to in itertools.permutations([robot.start, *places.values(), *stops], 2):
            form.move(robot, origin, to)
    form.openings()
    shared = form.problem.add_resource("operator", 1) if operator else None
    prepared = []
    for k in range(kits):
        order = [places[f"kit{k}_part{s}"] for s in range(parts)]
        prepare, handled = _kit(form, k, order)
        prepared.append(prepare)
        if shared is not None:
            for a in handled:
                a.uses(shared)
    form.one_at_a_time(prepared)
    return form.finish()


def _check_sizes(robots: int, kits: int, parts: int, doors: int) -> None:
    check_sizes("kitting", {"robots": MOST_ROBOTS}, robots)
    if doors not in (2, 4, 6):
        raise ProblemError(f"kitting takes 2, 4 or 6 doors, not {doors}")
    if kits < 1 or parts < 1 or kits * parts > MOST_PARTS * doors:
        raise ProblemError(
            f"kitting takes 1 to {MOST_PARTS * doors} parts in all, not {kits} x {parts}"
        )


def _places(
    floor: FamilyFloor, robots: int, parts: Sequence[tuple[int, int]], rng: random.Random | None
) -> tuple[dict[str, Pose], dict[str, Pose]]:
    """Return where robots start, and where the ``parts`` (kit, number) lie."""
    starts = {f"robot{r}_start": (4.0, 6.0 + 6.0 * r, 0.0) for r in range(robots)}
    spots = _spots(len(parts), len(floor.doors))
    if rng is not None:
        taken = [leaf.button for leaf in floor.doors]
        starts = {n: floor.spot(rng, (3, 3, 14, HALL[1] - 3), (0.0, UP), taken) for n in starts}
        spots = _drawn_spots(floor, len(parts), rng, taken)
    return starts, {f"kit{k}_part{s}": spot for (k, s), spot in zip(parts, spots, strict=True)}


def _spots(count: int, doors: int) -> list[Pose]:
    """Deal the parts to the rooms in turn: up to 3 in a row, 2 rows."""
    spots: list[Pose] = []
    for n in range(count):
        room, slot = n % doors, n // doors
        x = round(25.0 + ROOM * (room // 2) + (-3.0, 0.0, 3.0)[slot % 3], 2)
        row = 4.0 * (slot // 3)
        y, heading = (6.0 - row, DOWN) if room % 2 == 0 else (24.0 + row, UP)
        spots.append((x, y, heading))
    return spots


def _drawn_spots(
    floor: FamilyFloor, count: int, rng: random.Random, taken: list[Pose]
) -> list[Pose]:
    """Draw where the parts lie: anywhere in the rooms, which have as many as each other."""
    rooms = list(range(len(floor.doors)))
    rng.shuffle(rooms)
    spots = []
    for n in range(count):
        x, y, _ = floor.doors[rooms[n % len(rooms)]].closed
        low, high = (1.5, y - 2.5) if y < HALL[1] / 2 else (y + 2.5, HALL[1] - 1.5)
        region = (x - ROOM / 2 + 1, low, x + ROOM / 2 - 1, high)
        spots.append(floor.spot(rng, region, (UP, DOWN), taken, 3.0))
    return spots


def _kit(
    form: Form, k: int, order: Sequence[ConfigurationObject]
) -> tuple[Activity, list[Activity]]:
    """Add what a kit asks for; return its preparation, and all loads and unloads."""
    problem = form.problem
    prepare = problem.add_activity(f"prepare_unload_kit{k}", duration=PREPARING)
    builders: list[Parameter] = []
    handled: list[Activity] = []
    for robot in form.robots:
        builds = problem.add_variable(f"{robot.name}_builds_kit{k}", BoolType())
        builders.append(builds)
        chain = [
            form.work(robot, f"load_{robot.name}_kit{k}_part{s}", [place], LOADING)
            for s, place in enumerate(order)
        ]
        unload = form.work(robot, f"unload_{robot.name}_kit{k}", [robot.start], UNLOADING)
        chain.append(unload)
        for a in chain:
            problem.add_constraint(Iff(builds, a.present))
        for a, b in itertools.pairwise(chain):
            b.add_constraint(GE(b.start, a.end))
        early, late = UNLOAD_WITHIN
        unload.add_constraint(GE(unload.start, Plus(prepare.start, early)))
        unload.add_constraint(LE(unload.end, Plus(prepare.start, late)))
        handled += chain
    problem.add_constraint(Or(builders))
    for one, other in itertools.combinations(builders, 2):
        problem.add_constraint(Implies(one, Not(other)))
    return prepare, handled
