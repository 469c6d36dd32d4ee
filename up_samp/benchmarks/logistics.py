"""Logistics: robots fetch items from two shelves, one at a time, and bring them to their depots.

The shelves form a dead-end corridor behind a door. An item may be picked from its inner pose (in
the corridor) or, if ``sides="all"``, also from its outer one. Geometry and figures are the paper's
(Tosello et al., "Interleaving Scheduling and Motion Planning with Incremental Learning of Symbolic
Space-Time Motion Abstractions", Experimental Evaluation); what its text leaves open is fixed here.
"""

from __future__ import annotations

import itertools
import math
import random
from typing import Literal

from unified_planning.model import Fluent
from unified_planning.model.motion import (
    ConfigurationObject,
    MotionActivity,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import FALSE, TRUE, BoolType

from up_samp.benchmarks.builder import Encoding, Family, is_published
from up_samp.benchmarks.maps import LOGISTICS_SIZE, logistics_map, logistics_walls
from up_samp.benchmarks.places import FamilyDoor, Layout, Pose, box, check_poses
from up_samp.benchmarks.published.logistics import published_logistics
from up_samp.benchmarks.routes import at_start
from up_samp.model import ProblemError

MOST = {"robots": 10, "items": 16}
"""How large an instance may be."""
ACCELERATION = 0.5
"""What the robots can do at most, m/s^2."""

DoorState = Literal["closed", "open"]
Sides = Literal["all", "corridor"]

DOOR = FamilyDoor("door", box(1, 10), (51.5, 30.0, 0.0), (51.5, 40.0, 0.0), (46.0, 30.0, 0.0))

_COLUMNS = (59.0, 71.0, 83.0, 95.0)
_EXTRA_COLUMNS = (65.0, 77.0, 89.0, 54.0)
_UP = math.pi / 2
_DEPOTS = {
    1: (25.0,),
    2: (20.0, 30.0),
    3: (15.0, 25.0, 35.0),
    4: (10.0, 20.0, 30.0, 40.0),
    5: (15.0, 20.0, 25.0, 30.0, 35.0),
}


def layout(robots: int, items: int, seed: int = 0) -> Layout:
    """Return the layout for so many robots (1 to 10) and items (1 to 16).

    Seed 0 is the paper's order of items; any other seed deals the slots of the shelves (8 for up
    to 8 items, else 16) and the depots at random.
    """
    for (what, most), n in zip(MOST.items(), (robots, items), strict=True):
        if not 1 <= n <= most:
            raise ProblemError(f"logistics takes 1 to {most} {what}, not {n}")
    columns = [(x, 0) for x in _COLUMNS] + [(x, 1) for x in _COLUMNS]
    if items > len(columns):
        columns += [(x, 0) for x in _EXTRA_COLUMNS] + [(x, 1) for x in _EXTRA_COLUMNS]
    if robots in _DEPOTS:
        depots: list[Pose] = [(x, 59.0, _UP) for x in _DEPOTS[robots]]
    else:
        upper, lower = (robots + 1) // 2, robots // 2
        depots = [(x, 61.0, _UP) for x in _DEPOTS[upper]]
        depots += [(x, 57.0, _UP) for x in _DEPOTS[lower]]
    if seed:
        rng = random.Random(f"logistics-{robots}-{items}-{seed}")
        rng.shuffle(columns)
        rng.shuffle(depots)
    inner: list[Pose] = [(x, (32.0, 27.0)[row], 0.0) for x, row in columns[:items]]
    outer: list[Pose] = [(x, (42.0, 17.0)[row], 0.0) for x, row in columns[:items]]
    return Layout(tuple(depots), tuple(inner), tuple(outer))


def instance_name(robots: int, items: int, door: DoorState, sides: Sides) -> str:
    """Return the name of an instance, such as ``logistics-dc-all-r2-i4``."""
    return f"logistics-d{door[0]}-{'all' if sides == 'all' else 'oc'}-r{robots}-i{items}"


def logistics(
    robots: int = 2,
    items: int = 4,
    *,
    door: DoorState = "closed",
    sides: Sides = "all",
    encoding: Encoding = "lean",
    metric: bool = True,
    seed: int = 0,
    name: str | None = None,
) -> SchedulingMotionProblem:
    """Build a logistics problem.

    Each robot starts at its depot, drives to an item (by the button, if it is the one to open the
    door), picks it in 1 unit of time and drives home; every item is picked by exactly one robot,
    and in the end all are at home. Picks, door openings and moves are optional activities; each
    move happens at most once. What a schedule means is told in :mod:`up_samp.benchmarks.builder`.

    :param door: ``"open"`` leaves door and button away.
    :param sides: ``"corridor"`` allows the items' inner poses only.
    :param encoding: ``lean`` (object fluents, effects at the end, a pick per pose),
        ``lean-no-fluents`` (precedences), or one of the forms in which the authors publish it
        (:mod:`up_samp.benchmarks.published.form`).
    :param metric: minimise the makespan.
    :param seed: 0 is the paper's layout.
    """
    if door not in ("closed", "open") or sides not in ("all", "corridor"):
        raise ProblemError(f"no such logistics setting: door={door!r}, sides={sides!r}")
    spots = layout(robots, items, seed)
    _check(spots)
    title = name or instance_name(robots, items, door, sides) + (f"-s{seed}" if seed else "")
    if is_published(encoding):
        leaf = DOOR if door == "closed" else None
        return published_logistics(title, spots, leaf, sides == "all", encoding, metric)
    family = Family(
        title, str(logistics_map()), a_max=ACCELERATION, encoding=encoding, metric=metric
    )
    shelves = _shelf_places(family, spots, sides)
    depots = [family.place(f"depot{r}", pose) for r, pose in enumerate(spots.depots)]
    for r, depot in enumerate(depots):
        family.robot(f"r{r}", depot)
    button = None
    if door == "closed":
        body, closed, opened = family.door(DOOR, prefix="door")
        button = family.place("button", DOOR.button)
        family.open_door("open_door", body, closed, opened, button)
    _picks(family, depots, shelves, button, items)
    return family.finish()


def _picks(
    family: Family,
    depots: list[ConfigurationObject],
    shelves: dict[tuple[int, str], ConfigurationObject],
    button: ConfigurationObject | None,
    items: int,
) -> None:
    """Add who picks what: every item is picked by exactly one robot.

    With fluents a pick needs free hands and fills them, and every move home ends with free hands.
    Without them nothing has to be said of hands: from a pose at the shelf a robot can only drive
    home, and there it can pick only what stands there.
    """
    free = Fluent("robot_is_free", BoolType(), robot=family.robot_type)
    if family.with_fluents:
        family.problem.add_fluent(free, default_initial_value=True)
    picks: list[list[Activity]] = [[] for _ in range(items)]
    for robot, depot in zip(family.robots, depots, strict=True):
        homeward = _moves(family, robot, depot, shelves, button)
        for move in homeward if family.with_fluents else ():
            move.add_effect(move.end, free(robot), TRUE())
        for (item, side), shelf in shelves.items():
            pick = family.work(robot, f"pick_{robot.name}_i{item}_{side}", shelf, 1)
            if family.with_fluents:
                pick.add_condition(at_start(pick), free(robot))
                pick.add_effect(pick.end, free(robot), FALSE())
            picks[item].append(pick)
        family.routes.end(robot, depot)
    for choices in picks:
        family.exactly_one(choices)


def _shelf_places(
    family: Family, spots: Layout, sides: Sides
) -> dict[tuple[int, str], ConfigurationObject]:
    """Add the poses from which items may be picked: (item, side) -> place."""
    shelves = {}
    for i, pose in enumerate(spots.inner):
        shelves[i, "in"] = family.place(f"item{i}in", pose)
        if sides == "all":
            shelves[i, "out"] = family.place(f"item{i}out", spots.outer[i])
    return shelves


def _moves(
    family: Family,
    robot: MovableObject,
    depot: ConfigurationObject,
    shelves: dict[tuple[int, str], ConfigurationObject],
    button: ConfigurationObject | None,
) -> list[MotionActivity]:
    """Add all moves of ``robot``; return those that bring it home."""
    stops = [*shelves.values(), *([button] if button is not None else [])]
    for stop in stops:
        family.move(robot, depot, stop)
    if button is not None:
        for shelf in shelves.values():
            family.move(robot, button, shelf)
    return [family.move(robot, stop, depot) for stop in stops]


def _check(spots: Layout) -> None:
    named = itertools.chain(
        ((f"depot{r}", pose) for r, pose in enumerate(spots.depots)),
        ((f"item{i}in", pose) for i, pose in enumerate(spots.inner)),
        ((f"item{i}out", pose) for i, pose in enumerate(spots.outer)),
        (("button", DOOR.button),),
    )
    check_poses(LOGISTICS_SIZE, logistics_walls(), dict(named), doors=[DOOR])
