"""Kitting: robots collect the parts of kits from rooms with doors and unload them at their starts.

Published beside the paper's families. Rooms stand in a row, one above and one below an aisle, each
pair 9.2 m wide; doors come in pairs, slide open by 7 m to the left, and have their buttons in the
aisle, 1.5 m before them (robots stand along the wall there). A kit's parts are loaded in order by
one robot (a bool variable of the problem says by which); unloading happens while the kit's
unloading is being prepared. Where parts lie in the rooms, and where robots start, is this package's
own choice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from unified_planning.model import Parameter
from unified_planning.model.motion import ConfigurationObject, MotionModels, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, BoolType, Iff, Implies, Not, Or, Plus

from up_samp.benchmarks.maps import Rectangle, drawn_map, outer_wall
from up_samp.benchmarks.places import FamilyDoor, Pose, box, check_poses
from up_samp.benchmarks.published.form import Form, Manner, Published
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
_UP = math.pi / 2


def kitting_doors(doors: int) -> list[FamilyDoor]:
    """Return the doors: even ones below the aisle, odd ones above it."""
    found = []
    for i in range(doors):
        x = 25.0 + ROOM * (i // 2)
        y, inward = (LOWER, 1.0) if i % 2 == 0 else (UPPER, -1.0)
        button = (x, round(y + inward * BEFORE, 3), 0.0)
        found.append(FamilyDoor(f"door{i}", box(1, 4.2), (x, y, _UP), (x - SLIDE, y, _UP), button))
    return found


def kitting_size(doors: int) -> tuple[float, float]:
    """Return width and height of the building, m."""
    return HALL[0] + ROOM * (doors // 2 - 1), HALL[1]


def kitting_walls(doors: int) -> list[Rectangle]:
    """Return what is occupied: walls 0.6 m thick with gaps of 4.4 m at the doors."""
    width, height = kitting_size(doors)
    walls = outer_wall(width, height)
    for y in (LOWER, UPPER):
        left = 25.0 - ROOM / 2
        for pair in range(doors // 2):
            x = 25.0 + ROOM * pair
            walls.append((round(left, 1), y - 0.3, x - 2.2, y + 0.3))
            left = x + 2.2
        walls.append((round(left, 1), y - 0.3, width, y + 0.3))
    for pair in range(doors // 2 + 1):
        x = round(25.0 - ROOM / 2 + ROOM * pair, 1)
        walls += [
            (x - 0.2, 0.0, x + 0.2, LOWER),
            (x - 0.2, UPPER, x + 0.2, height),
        ]
    return walls


def kitting(
    robots: int = 2,
    kits: int = 2,
    parts: int = 3,
    doors: int = 2,
    *,
    encoding: Published = "fluents",
    operator: bool = False,
    metric: bool = True,
    name: str | None = None,
) -> SchedulingMotionProblem:
    """Build a kitting problem.

    :param doors: 2, 4 or 6; one room behind each.
    :param operator: loading and unloading need the one operator, too.
    """
    _check_sizes(robots, kits, parts, doors)
    size, walls, leaves = kitting_size(doors), kitting_walls(doors), kitting_doors(doors)
    starts = {f"robot{r}_start": (4.0, 6.0 + 6.0 * r, 0.0) for r in range(robots)}
    spots = _spots(kits, parts, doors)
    buttons = {f"{leaf.name}_button": leaf.button for leaf in leaves}
    check_poses(size, walls, {**starts, **spots, **buttons}, doors=leaves)
    manner = Manner(
        str(drawn_map(f"kitting-{doors}", size, walls)),
        guess=1.0,
        early=0,
        model=MotionModels.SE2,
    )
    title = name or f"kitting-r{robots}-k{kits}-p{parts}-d{doors}"
    form = Form(title, manner, encoding, metric)
    homes = [form.place(key, pose) for key, pose in starts.items()]
    for home in homes:
        form.robot(home)
    places = {key: form.place(key, pose) for key, pose in spots.items()}
    stops = [form.door(leaf).button for leaf in leaves]
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
    if not 1 <= robots <= MOST_ROBOTS:
        raise ProblemError(f"kitting takes 1 to {MOST_ROBOTS} robots, not {robots}")
    if doors not in (2, 4, 6):
        raise ProblemError(f"kitting takes 2, 4 or 6 doors, not {doors}")
    if kits < 1 or parts < 1 or kits * parts > MOST_PARTS * doors:
        raise ProblemError(
            f"kitting takes 1 to {MOST_PARTS * doors} parts in all, not {kits} x {parts}"
        )


def _spots(kits: int, parts: int, doors: int) -> dict[str, Pose]:
    """Deal the parts to the rooms in turn: up to 3 in a row, 2 rows."""
    spots: dict[str, Pose] = {}
    for n, (k, s) in enumerate(itertools.product(range(kits), range(parts))):
        room, slot = n % doors, n // doors
        x = round(25.0 + ROOM * (room // 2) + (-3.0, 0.0, 3.0)[slot % 3], 2)
        row = 4.0 * (slot // 3)
        y, heading = (6.0 - row, -_UP) if room % 2 == 0 else (24.0 + row, _UP)
        spots[f"kit{k}_part{s}"] = (x, y, heading)
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
