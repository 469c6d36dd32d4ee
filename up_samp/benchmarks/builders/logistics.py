"""Logistics: robots fetch items from two shelves, one at a time, and bring them to their depots.

The shelves form a dead-end corridor behind a door. An item may be picked from its inner pose (in
the corridor) or, if ``sides="all"``, also from its outer one. Geometry and figures are the paper's
(Tosello et al., "Interleaving Scheduling and Motion Planning with Incremental Learning of Symbolic
Space-Time Motion Abstractions", Experimental Evaluation); what its text leaves open is fixed here.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable
from dataclasses import replace
from typing import Literal

from unified_planning.model import Fluent
from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import FALSE, LE, TRUE, And, BoolType, Or

from up_samp.benchmarks.instances import Encoding
from up_samp.benchmarks.places import (
    DOWN,
    UP,
    FamilyDoor,
    FamilyFloor,
    Pose,
    box,
    check_sizes,
    drawn_name,
    outer_wall,
)
from up_samp.benchmarks.published import HANDLING, Form, Manner, PublishedRobot
from up_samp.model import ProblemError
from up_samp.upio.expressions import at_start

MOST = {"robots": 10, "items": 16}
"""How large an instance may be."""

DoorState = Literal["closed", "open"]
Sides = Literal["all", "corridor"]

SIZE = (100.0, 65.0)
"""Width and height of the floor, m."""

_COLUMNS = (59.0, 71.0, 83.0, 95.0)
_EXTRA_COLUMNS = (65.0, 77.0, 89.0, 54.0)
_DEPOTS = {
    1: (25.0,),
    2: (20.0, 30.0),
    3: (15.0, 25.0, 35.0),
    4: (10.0, 20.0, 30.0, 40.0),
    5: (15.0, 20.0, 25.0, 30.0, 35.0),
}


def shelved_floor(
    left: float = 52.0,
    corridor: tuple[float, float] = (25.0, 35.0),
    depths: tuple[float, float] = (5.0, 5.0),
    button: tuple[float, float] = (46.0, 30.0),
    name: str = "logistics",
) -> FamilyFloor:
    """Return the floor with two shelves of some ``depths`` (m) from ``left`` (x) to the wall, a
    ``corridor`` between them (y), and a door at its end that slides up.
    """
    (low, high), right = corridor, SIZE[0]
    shelves = (left, high, right, high + depths[0]), (left, low - depths[1], right, low)
    closed = (left - 0.5, (low + high) / 2, 0.0)
    opened = (left - 0.5, closed[1] + high - low, 0.0)
    door = FamilyDoor("door", box(1, high - low), closed, opened, (*button, 0.0))
    return FamilyFloor(name, SIZE, [*outer_wall(*SIZE), *shelves], (door,))


Layout = tuple[FamilyFloor, dict[str, Pose]]
"""The floor, and where things are by name: ``robot0_depot``, ``item0_in``, ``item0_out``."""


def layout(robots: int, items: int, seed: int = 0) -> Layout:
    """Return the layout for so many robots (1 to 10) and items (1 to 16).

    Seed 0 is the paper's; any other one draws the floor, where along the shelves items stand, where
    depots are, and the robots' shape.
    """
    check_sizes("logistics", MOST, robots, items)
    if seed:
        return _drawn(robots, items, seed)
    columns = [(x, 0) for x in _COLUMNS] + [(x, 1) for x in _COLUMNS]
    if items > len(columns):
        columns += [(x, 0) for x in _EXTRA_COLUMNS] + [(x, 1) for x in _EXTRA_COLUMNS]
    if robots in _DEPOTS:
        depots: list[Pose] = [(x, 59.0, UP) for x in _DEPOTS[robots]]
    else:
        upper, lower = (robots + 1) // 2, robots // 2
        depots = [(x, 61.0, UP) for x in _DEPOTS[upper]]
        depots += [(x, 57.0, UP) for x in _DEPOTS[lower]]
    inner: list[Pose] = [(x, (32.0, 27.0)[row], 0.0) for x, row in columns[:items]]
    outer: list[Pose] = [(x, (42.0, 17.0)[row], 0.0) for x, row in columns[:items]]
    return shelved_floor(), _named(depots, inner, outer)


def _named(depots: Iterable[Pose], inner: Iterable[Pose], outer: Iterable[Pose]) -> dict[str, Pose]:
    spots = {f"robot{r}_depot": pose for r, pose in enumerate(depots)}
    for i, (one, other) in enumerate(zip(inner, outer, strict=True)):
        spots |= {f"item{i}_in": one, f"item{i}_out": other}
    return spots


def _drawn(robots: int, items: int, seed: int) -> Layout:
    own = f"logistics-{robots}-{items}-{seed}"
    rng = random.Random(own)
    left, low = rng.uniform(46, 56), rng.uniform(23, 27)
    left, low, high = round(left, 1), round(low, 1), round(low + rng.choice((9, 10, 12)), 1)
    depths = (rng.choice((3.0, 5.0, 7.0)), rng.choice((3.0, 5.0, 7.0)))
    button = round(left - rng.uniform(4, 12), 1), round(rng.uniform(low, high), 1)
    floor = shelved_floor(left, (low, high), depths, button, own).reshaped(rng)
    taken = [floor.doors[0].button]
    depots = [
        floor.spot(rng, (4, 46, left - 8, SIZE[1] - 4), (UP, DOWN), taken) for _ in range(robots)
    ]
    inner: list[Pose] = []
    outer: list[Pose] = []
    for _ in range(items):
        y, beyond = rng.choice(((high - 3, high + depths[0] + 2), (low + 2, low - depths[1] - 3)))
        inner.append(floor.spot(rng, (left + 4, y, SIZE[0] - 4, y), (0.0,), taken, 3.5))
        outer.append((inner[-1][0], beyond, 0.0))
    return floor, _named(depots, inner, outer)


Shelves = list[list[ConfigurationObject]]
"""The poses from which each item can be picked."""


def logistics(
    robots: int = 2,
    items: int = 4,
    *,
    door: DoorState = "closed",
    sides: Sides = "all",
    encoding: Encoding = "fluents",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a logistics problem.

    Each robot starts at its depot, drives to an item (by the button, if it is the one to open the
    door), picks it in 1 unit of time and drives home; every item is picked by exactly one robot (a
    pick per robot and item, whatever the number of poses), and in the end all are at home. Picks,
    door openings and moves are optional activities; each move happens at most once.

    :param door: ``"open"`` leaves door and button away.
    :param sides: ``"corridor"`` allows the items' inner poses only.
    :param encoding: one of the forms in which the authors publish it
        (:mod:`up_samp.benchmarks.published`).
    :param metric: minimise the makespan.
    :param seed: 0 is the paper's layout.
    """
    if door not in ("closed", "open") or sides not in ("all", "corridor"):
        raise ProblemError(f"no such logistics setting: door={door!r}, sides={sides!r}")
    floor, spots = layout(robots, items, seed)
    floor.check(spots | {f"{leaf.name}_button": leaf.button for leaf in floor.doors})
    if door == "open":
        floor = replace(floor, doors=())
    side = "all" if sides == "all" else "oc"
    title = drawn_name(f"logistics-d{door[0]}-{side}-r{robots}-i{items}", seed)
    form = Form(title, Manner(floor, guess=0.5), encoding, metric)
    _fetches(form, spots, sides)
    return form.finish()


def _fetches(form: Form, spots: dict[str, Pose], sides: Sides) -> None:
    """Add robots, items and doors, and all that may be done with them."""
    depots = [form.place(n, pose) for n, pose in spots.items() if n.endswith("_depot")]
    for depot in depots:
        form.robot(depot)
    shelves: Shelves = []
    for i in range((len(spots) - len(depots)) // 2):
        ends = ("in", "out") if sides == "all" else ("in",)
        names = [f"item{i}_{end}" for end in ends]
        shelves.append([form.place(name, spots[name]) for name in names])
    buttons = [form.door(leaf).button for leaf in form.manner.floor.doors]
    picks: list[list[Activity]] = [[] for _ in shelves]
    for robot in form.robots:
        stands = [p for poses in shelves for p in poses]
        out = [(robot.start, place) for place in (*stands, *buttons)]
        back = [(place, home) for home, place in out]
        for origin, to in (*out, *itertools.product(buttons, stands), *back):
            form.move(robot, origin, to)
        for i, pick in enumerate(_picks(form, robot, shelves)):
            picks[i].append(pick)
    form.openings()
    for choices in picks:
        form.exactly_one(choices)
    form.end_at(dict(enumerate(depots)))


def _picks(form: Form, robot: PublishedRobot, shelves: Shelves) -> list[Activity]:
    """Add the robot's picks; its hands must be free, and are so again when it comes home."""
    picks = [
        form.work(robot, f"pick_{robot.name}_item{i}", poses, HANDLING)
        for i, poses in enumerate(shelves)
    ]
    homeward = robot.moves_to([robot.start])
    if form.with_fluents:
        free = Fluent(f"{robot.name}_is_free", BoolType())
        form.problem.add_fluent(free, default_initial_value=True)
        for pick in picks:
            pick.add_condition(at_start(pick), free)
            pick.add_effect(form.done(pick), free, FALSE())
        for move in homeward:
            move.add_effect(form.done(move), free, TRUE())
        return picks
    leaving = robot.moves_from(robot.start)
    for pick in picks:
        form.needs.append((pick, leaving, picks, False))
        home = Or([And(m.present, LE(pick.end, m.start)) for m in homeward])
        form.problem.add_constraint(home, scope=[pick.present])
    return picks
