"""Small SAMP problems with known optima, for Unified Planning's engine report:
``PYTHONPATH=. python benchmarks/scheduling/up_report.py ENGINES -p tests.benchmarks.cases``.

Each function tells why its optimum is what it is.

A robot drives straight over d >= 4 m, rest to rest, in d / 2 + 2 s (v_max 2 m/s, a_max 1 m/s^2);
no motion is faster. Where the optimum should not hang on how good a planner is, the duration's
lower bound exceeds what any sensible motion takes.
"""

from __future__ import annotations

import math

from unified_planning.model import Fluent, TimePointInterval, Timing
from unified_planning.model.motion import MotionModels
from unified_planning.shortcuts import LT, Equals, Not, Or
from unified_planning.test import TestCase

from tests.benchmarks.scene import SceneBuilder, plan, straight

WEST = (5.0, 10.0, 0.0)
EAST = (22.0, 10.0, 0.0)
FAR_EAST = (35.0, 10.0, 0.0)


def drive() -> TestCase:
    """17 m straight ahead take 10.5 s, so 11 units: the optimum. The plans that are wrong end
    before the robot can be there, leave the mandatory drive out, or end elsewhere.
    """
    scene = SceneBuilder("drive")
    west, east = scene.place("west", WEST), scene.place("east", EAST)
    scene.drive("go", scene.robot("r0", west), [west, east], (1, 100))
    right = {"go": straight(WEST, EAST)}
    hasty = {"go": straight(WEST, EAST, v_max=4.0)}
    short = {"go": straight(WEST, (20.0, 10.0, 0.0))}
    return TestCase(
        scene.problem,
        True,
        11,
        valid_plans=[plan(scene, {"go": (0, 11)}, right), plan(scene, {"go": (3, 20)}, right)],
        invalid_plans=[
            plan(scene, {"go": (0, 10)}, right),
            plan(scene, {"go": (0, 11)}, hasty),
            plan(scene, {"go": (0, 11)}, short),
            plan(scene, {"go": (0, 11)}, {}),
            plan(scene, {}, {}),
        ],
    )


def side_by_side() -> TestCase:
    """Two robots drive 17 m on lanes 4 m apart at the same time: 11 units. On lanes 0.5 m apart
    they would touch, so the plan that sends r1 over r0's lane is wrong.
    """
    scene = SceneBuilder("side-by-side")
    robots = []
    for i, y in enumerate((8.0, 12.0)):
        west = scene.place(f"west{i}", (5.0, y, 0.0))
        east = scene.place(f"east{i}", (22.0, y, 0.0))
        robots.append((scene.robot(f"r{i}", west), west, east))
    for i, (robot, west, east) in enumerate(robots):
        scene.drive(f"go{i}", robot, [west, east], (1, 100))
    lanes = [straight((5.0, y, 0.0), (22.0, y, 0.0)) for y in (8.0, 12.0, 8.5)]
    together = {"go0": (0, 11), "go1": (0, 11)}
    return TestCase(
        scene.problem,
        True,
        11,
        valid_plans=[
            plan(scene, together, {"go0": lanes[0], "go1": lanes[1]}),
            plan(scene, {"go0": (0, 11), "go1": (5, 16)}, {"go0": lanes[0], "go1": lanes[1]}),
        ],
        invalid_plans=[
            plan(scene, together, {"go0": lanes[0], "go1": lanes[2]}),
            plan(scene, {"go0": (0, 11)}, {"go0": lanes[0]}),
        ],
    )


def in_the_way() -> TestCase:
    """r1 stands on r0's straight way, with 9 m of room beside it. r0 drives around it well within
    its 30 units: optimum 30. Driving through r1 is wrong; so is r1 starting elsewhere.
    """
    scene = SceneBuilder("in-the-way")
    west, east = scene.place("west", WEST), scene.place("east", EAST)
    middle = scene.place("middle", (13.0, 10.0, math.pi / 2))
    r0 = scene.robot("r0", west)
    scene.robot("r1", middle)
    scene.drive("go", r0, [west, east], (30, 100))
    through = plan(scene, {"go": (0, 30)}, {"go": straight(WEST, EAST)})
    return TestCase(scene.problem, True, 30, invalid_plans=[through])


def swap() -> TestCase:
    """Two robots in the open hall change places at the same time, with more than enough time in
    their 40 units each: optimum 40. Straight through each other is wrong.
    """
    scene = SceneBuilder("swap")
    west, east = scene.place("west", (8.0, 10.0, 0.0)), scene.place("east", (30.0, 10.0, 0.0))
    r0, r1 = scene.robot("r0", west), scene.robot("r1", east)
    scene.drive("go0", r0, [west, east], (40, 100))
    scene.drive("go1", r1, [east, west], (40, 100))
    ahead = straight((8.0, 10.0, 0.0), (30.0, 10.0, 0.0))
    back = straight((30.0, 10.0, 0.0), (8.0, 10.0, 0.0))
    head_on = plan(scene, {"go0": (0, 40), "go1": (0, 40)}, {"go0": ahead, "go1": back})
    return TestCase(scene.problem, True, 40, invalid_plans=[head_on])


def door() -> TestCase:
    """The door takes 3 units to open; the drive of 30 m through it (17 s, given at least 18 units)
    follows strictly after 8 units of preparation: 9 + 18 = 27. Driving through the door before it
    is open is wrong.
    """
    scene = SceneBuilder("door", rooms=True)
    west, east = scene.place("west", WEST), scene.place("far", FAR_EAST)
    leaf, _, opened = scene.door()
    go = scene.drive("go", scene.robot("r0", west), [west, east], (18, 100))
    opening = scene.problem.add_motion_activity("open_door", 3)
    opening.add_motion_effect(leaf, opened)
    prepare = scene.problem.add_activity("prepare", 8)
    scene.problem.add_constraint(LT(prepare.end, go.start))
    path = {"go": straight(WEST, FAR_EAST)}
    early = {"go": (9, 27), "prepare": (0, 8), "open_door": (0, 3)}
    return TestCase(
        scene.problem,
        True,
        27,
        valid_plans=[plan(scene, early, path)],
        invalid_plans=[
            plan(scene, {**early, "open_door": (24, 27)}, path),
            plan(scene, {**early, "go": (8, 26)}, path),
        ],
    )


def locked_door() -> TestCase:
    """Nobody opens the door: unsolvable. The straight drive goes through the closed door."""
    scene = SceneBuilder("locked-door", rooms=True)
    west, east = scene.place("west", WEST), scene.place("far", FAR_EAST)
    scene.door()
    scene.drive("go", scene.robot("r0", west), [west, east], (18, 100))
    through = plan(scene, {"go": (0, 18)}, {"go": straight(WEST, FAR_EAST)})
    return TestCase(scene.problem, False, invalid_plans=[through])


def too_late() -> TestCase:
    """17 m in at most 8 units: no robot of 2 m/s can. Unsolvable."""
    scene = SceneBuilder("too-late")
    west, east = scene.place("west", WEST), scene.place("east", EAST)
    scene.drive("go", scene.robot("r0", west), [west, east], (1, 8))
    hasty = {"go": straight(WEST, EAST, v_max=4.0, a_max=4.0)}
    return TestCase(scene.problem, False, invalid_plans=[plan(scene, {"go": (0, 8)}, hasty)])


def into_the_wall() -> TestCase:
    """The goal pose touches the outer wall: unsolvable."""
    scene = SceneBuilder("into-the-wall")
    west, wall = scene.place("west", WEST), scene.place("wall", (39.0, 10.0, 0.0))
    scene.drive("go", scene.robot("r0", west), [west, wall], (30, 100))
    into = plan(scene, {"go": (0, 30)}, {"go": straight(WEST, (39.0, 10.0, 0.0))})
    return TestCase(scene.problem, False, invalid_plans=[into])


def choice() -> TestCase:
    """One of two optional drives has to be made, of at least 20 or 26 units: optimum 20."""
    scene = SceneBuilder("choice")
    west, east, far = (
        scene.place(n, p) for n, p in zip("wef", (WEST, EAST, FAR_EAST), strict=True)
    )
    robot = scene.robot("r0", west)
    near = scene.drive("near", robot, [west, east], (20, 100), optional=True)
    long = scene.drive("long", robot, [west, far], (26, 100), optional=True)
    scene.problem.add_constraint(Or(near.present, long.present))
    scene.problem.add_constraint(Or(Not(near.present), Not(long.present)))
    paths = {"near": straight(WEST, EAST), "long": straight(WEST, FAR_EAST)}
    return TestCase(
        scene.problem,
        True,
        20,
        valid_plans=[
            plan(scene, {"near": (0, 20)}, paths),
            plan(scene, {"long": (0, 26)}, paths),
        ],
        invalid_plans=[
            plan(scene, {}, {}),
            plan(scene, {"near": (0, 20), "long": (30, 56)}, paths),
        ],
    )


def fetch(*, fluents: bool) -> TestCase:
    """There, pick, and back, strictly one after the other: 20 + 1 + 1 + 1 + 20 = 43, with
    precedences alone or also a fluent that tells where the robot is. A start without a gap is
    wrong.
    """
    scene = SceneBuilder(f"fetch-{'fluents' if fluents else 'no-fluents'}")
    west, east = scene.place("west", WEST), scene.place("east", EAST)
    robot = scene.robot("r0", west)
    there = scene.drive("there", robot, [west, east], (20, 100))
    back = scene.drive("back", robot, [east, west], (20, 100))
    pick = scene.problem.add_activity("pick", 1)
    if fluents:
        at = Fluent("robot_at", scene.pose_type, robot=scene.robot_type)
        scene.problem.add_fluent(at)
        scene.problem.set_initial_value(at(robot), west)
        for a, needs in ((there, west), (back, east), (pick, east)):
            a.add_condition(TimePointInterval(Timing(0, a.start)), Equals(at(robot), needs))
        there.add_effect(there.end, at(robot), east)
        back.add_effect(back.end, at(robot), west)
    scene.problem.add_constraint(LT(there.end, pick.start))
    scene.problem.add_constraint(LT(pick.end, back.start))
    paths = {"there": straight(WEST, EAST), "back": straight(EAST, WEST)}
    return TestCase(
        scene.problem,
        True,
        43,
        valid_plans=[plan(scene, {"there": (0, 20), "pick": (21, 22), "back": (23, 43)}, paths)],
        invalid_plans=[
            plan(scene, {"there": (0, 20), "pick": (21, 22), "back": (22, 42)}, paths),
            plan(scene, {"there": (1, 21), "pick": (21, 22), "back": (0, 20)}, paths),
        ],
    )


def via() -> TestCase:
    """A robot that can drive in any direction passes a place aside, in at least 40 units: 40. The
    straight drive that leaves the place out is wrong.
    """
    scene = SceneBuilder("via")
    west, east = scene.place("west", WEST), scene.place("east", EAST)
    aside = scene.place("aside", (13.0, 15.0, math.pi / 2))
    robot = scene.robot("r0", west, MotionModels.SE2)
    scene.drive("go", robot, [west, aside, east], (40, 100))
    past = plan(scene, {"go": (0, 40)}, {"go": straight(WEST, EAST)})
    return TestCase(scene.problem, True, 40, invalid_plans=[past])


def first_plan() -> TestCase:
    """Without a metric any valid plan will do: two cars through one opening, either way round."""
    scene = SceneBuilder("first-plan", rooms=True, metric=False)
    west, east = scene.place("west", WEST), scene.place("far", FAR_EAST)
    low, high = scene.place("low", (5.0, 5.0, 0.0)), scene.place("high", (35.0, 15.0, 0.0))
    r0, r1 = scene.robot("r0", west), scene.robot("r1", low)
    scene.drive("go0", r0, [west, east], (1, 200))
    scene.drive("go1", r1, [low, high], (1, 200))
    return TestCase(scene.problem, True)


def get_test_cases() -> dict[str, TestCase]:
    """Return all test cases by name, as UP's report wants them."""
    cases = [
        drive(),
        side_by_side(),
        in_the_way(),
        swap(),
        door(),
        locked_door(),
        too_late(),
        into_the_wall(),
        choice(),
        fetch(fluents=True),
        fetch(fluents=False),
        via(),
        first_plan(),
    ]
    return {f"samp:{case.name}": case for case in cases}
