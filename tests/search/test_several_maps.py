"""Maps in frames of their own, and several maps: floors, halls side by side, lifts."""

import itertools
import math

import numpy as np
import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import (
    SE2,
    SE3,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import LE, OneshotPlanner, get_environment

from tests.fuzz.problems import SECONDS, Writer, random_case
from tests.usual import usually
from up_samp.geometry import write_map
from up_samp.io import plan_from_dict, result_to_dict
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.frames import Frame
from up_samp.validation import validate_plan

SOLVED = (Status.SOLVED_SATISFICING, Status.SOLVED_OPTIMALLY)
BOX = [(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3)]


def lifted(frame, height=0.0):
    """Return a frame as SE3."""
    half = 0.5 * frame.yaw
    return SE3(frame.x, frame.y, height, 0.0, 0.0, math.sin(half), math.cos(half))


class Elsewhere(Writer):
    """The same problem on a map that lies elsewhere in the world."""

    def __init__(self, case, map_file, frame, stated):
        self.frame, self._frame = stated, frame
        super().__init__(case, map_file)

    def _place(self, name, pose):
        return super()._place(name, self._frame.of(pose))


def solve(problem, engine="cpsat", timeout=60.0, **params):
    with OneshotPlanner(name=f"samp-refine[{engine}]", params=params) as planner:
        result = planner.solve(problem, timeout=timeout)
    unit = params.get("seconds_per_unit", 1.0)
    if result.plan is not None:
        assert validate_plan(problem, result.plan, seconds_per_unit=unit).valid
    return result


FRAMES = [
    Frame(100.0, -40.0, 0.0),
    Frame(0.0, 0.0, 0.5 * math.pi),
    Frame(-3.7, 12.3, 0.7),
    Frame(5e3, 1e4, -2.9),
]


def compare(seed, frame, tmp_path, as_se3):
    case = random_case(seed)
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    here = Writer(case, case.floor.write(tmp_path / "here")).write()
    stated = lifted(frame, 2.5) if as_se3 else SE2(frame.x, frame.y, frame.yaw)
    there = Elsewhere(case, case.floor.write(tmp_path / "there"), frame, stated).write()
    # plans that are proven best have one makespan, whatever happens to be found first
    one, two = (solve(p, seconds_per_unit=SECONDS, optimal=True, timeout=20) for p in (here, there))
    if cut_short(one) or cut_short(two):
        no_contradiction(one, two)
        no_contradiction(two, one)
    else:
        assert one.status == two.status
    if one.plan is None or two.plan is None:
        return
    if Status.SOLVED_OPTIMALLY is one.status is two.status:
        assert one.metrics["makespan"] == two.metrics["makespan"]
    for name, track in one.plan.trajectories.items():
        if name in two.plan.trajectories:
            off = frame.out(track.poses[[0, -1]]) - two.plan.trajectories[name].poses[[0, -1]]
            off[:, 2] = np.remainder(off[:, 2] + math.pi, math.tau) - math.pi  # turned round or not
            assert np.allclose(off, 0, atol=1e-6)


def cut_short(result):
    """Return whether a search has not come to its end: it is timed by the clock."""
    return result.status in (Status.TIMEOUT, Status.SOLVED_SATISFICING)


def no_contradiction(one, two):
    """Assert that nothing is found that the other search has ruled out."""
    if two.plan is not None:
        assert one.status is not Status.UNSOLVABLE_PROVEN
        if one.status is Status.SOLVED_OPTIMALLY:
            assert int(one.metrics["makespan"]) <= int(two.metrics["makespan"])


@pytest.mark.parametrize(
    ("seed", "k"), usually((3, 1), (4, 2), of=zip((1, 3, 4, 12), range(4), strict=True))
)
def test_a_map_that_lies_elsewhere(tmp_path, seed, k):
    compare(seed, FRAMES[k], tmp_path, as_se3=k % 2)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(40, 80))
def test_maps_that_lie_elsewhere(tmp_path, seed):
    compare(seed, FRAMES[seed % len(FRAMES)], tmp_path, as_se3=seed % 3 == 0)


class House:
    """Robots on floors, each floor a map with a frame. ``poses`` are given in their map's frame."""

    def __init__(self, maps, frames):
        self.env = get_environment()
        self.problem = SchedulingMotionProblem("house", self.env)
        self.types, self.frames = [], []
        for k, (file, frame) in enumerate(zip(maps, frames, strict=True)):
            frame = frame if isinstance(frame, SE3) else SE2(*frame)
            kind = self.env.type_manager.ConfigurationType(
                f"on{k}", OccupancyMap(str(file), frame), ConfigurationKind.SE2
            )
            self.types.append(kind)
            if isinstance(frame, SE3):
                self.frames.append(Frame(frame.x, frame.y, 2 * math.atan2(frame.rz, frame.rw)))
            else:
                self.frames.append(Frame(*frame))
        self.poses, self.floor, self.robots = {}, {}, {}
        self.problem.add_quality_metric(MinimizeMakespan())

    def pose(self, name, floor, *local):
        place = SE2(*self.frames[floor].of(local))
        item = ConfigurationObject(name, self.types[floor], place, self.env)
        self.problem.add_object(item)
        self.poses[name] = item

    def robot(self, name, start, footprint=BOX, **limits):
        item = MovableObject(
            name,
            self.env.type_manager.MovableType(f"type_{name}"),
            footprint=footprint,
            motion_model=MotionModels.SE2,
            motion_parameters={"v_max": 1.0, "a_max": 1.0, **limits},
            env=self.env,
        )
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.poses[start])
        self.robots[name] = item

    def move(self, name, robot, start, goal):
        activity = self.problem.add_motion_activity(name, 1)
        activity.set_duration_bounds(1, 100)
        activity.add_motion_constraint(
            ActivityWaypoints(self.robots[robot], self.poses[start], [self.poses[goal]])
        )
        return activity


def hall(folder, name="hall", cell=0.1, width=12.0, height=3.0):
    cells = np.zeros((round(height / cell), round(width / cell)), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    return write_map(folder, name, cells, cell)


def facing(house, low, high, y=1.5):
    """Two robots that go to opposite ends of a hall, or of two."""
    for k, floor in enumerate((low, high)):
        house.pose(f"w{k}", floor, 1.5, y, 0.0)
        house.pose(f"e{k}", floor, 10.5, y, 0.0)
    house.robot("r0", "w0")
    house.robot("r1", "e1")
    house.move("go0", "r0", "w0", "e0")
    house.move("go1", "r1", "e1", "w1")
    return house


@pytest.mark.parametrize(
    ("cell", "engine"),
    usually((0.1, "cpsat"), (0.05, "aries"), of=itertools.product((0.1, 0.05), ("cpsat", "aries"))),
)
def test_robots_on_different_floors_never_meet(tmp_path, engine, cell):
    maps = [hall(tmp_path, "low", height=1.7), hall(tmp_path, "high", cell, height=1.7)]
    house = House(maps, [lifted(Frame(), 0.0), lifted(Frame(0.0, 0.0, 0.3), 3.0)])
    facing(house, 0, 1, 0.85)
    result = solve(house.problem, engine)
    assert result.status in SOLVED
    assert int(result.metrics["makespan"]) == 10
    ends = [house.poses[n].configuration for n in ("e0", "w1")]
    for name, end in zip(("go0", "go1"), ends, strict=True):
        assert np.allclose(result.plan.trajectories[name].poses[-1], list(end), atol=1e-6)


def test_the_same_robots_on_one_floor_meet(tmp_path):
    file = hall(tmp_path, "low", height=1.4)
    house = House([file], [(0, 0, 0)])
    facing(house, 0, 0, 0.7)
    assert solve(house.problem, timeout=3).plan is None


@pytest.mark.parametrize("engine", usually("cpsat", of=("cpsat", "aries-opt")))
def test_a_lift_is_a_motion_effect(tmp_path, engine):
    house = House(
        [hall(tmp_path, "low"), hall(tmp_path, "high")],
        [lifted(Frame(7.0, 0.0, 0.0), 0.0), lifted(Frame(7.0, 0.0, 0.0), 3.0)],
    )
    for k in range(2):
        house.pose(f"w{k}", k, 1.5, 1.5, 0.0)
        house.pose(f"lift{k}", k, 10.5, 1.5, 0.0)
    house.robot("r0", "w0")
    out = house.move("out", "r0", "w0", "lift0")
    ride = house.problem.add_motion_activity("ride", 7)
    ride.add_motion_effect(house.robots["r0"], house.poses["lift1"])
    back = house.move("back", "r0", "lift1", "w1")
    house.problem.add_constraint(LE(out.end, ride.start))
    house.problem.add_constraint(LE(ride.end, back.start))
    result = solve(house.problem, engine, optimal=True)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert int(result.metrics["makespan"]) == 27


def test_without_a_ride_a_robot_is_on_the_wrong_floor(tmp_path):
    """At the same x and y."""
    frames = [lifted(Frame(), 0.0), lifted(Frame(), 3.0)]
    house = House([hall(tmp_path, "low"), hall(tmp_path, "high")], frames)
    for k in range(2):
        house.pose(f"w{k}", k, 1.5, 1.5, 0.0)
        house.pose(f"e{k}", k, 10.5, 1.5, 0.0)
    house.robot("r0", "w0")
    house.move("back", "r0", "w1", "e1")
    result = solve(house.problem, timeout=10)
    assert result.status is Status.UNSOLVABLE_PROVEN


def test_the_validator_knows_floors(tmp_path):
    """A plan for two floors is refused where both are one, and where a robot changes floors."""
    maps = [hall(tmp_path, "low", height=1.7)] * 2
    heights = {}
    for high in (3.0, 0.0):
        house = House(maps, [lifted(Frame(), 0.0), lifted(Frame(), high)])
        facing(house, 0, 1, 0.85)
        heights[high] = house
    result = solve(heights[3.0].problem)
    flat = heights[0.0].problem
    plan = plan_from_dict(flat, result_to_dict(heights[3.0].problem, result))
    verdict = validate_plan(flat, plan)
    assert {v.kind for v in verdict.violations} == {"collision"}


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ([SE3(0, 0, 0, 0.6, 0, 0, 0.8)], "tilted"),
        ([SE3(0, 0, 0, 0, 0, 2.0, 1.0)], "no rotation"),
        ([(0, 0, 0), (3, 0, 0.2)], "over each other"),
        ([(3e7, 0, 0)], "makes? sense"),
    ],
)
def test_frames_that_are_refused(tmp_path, frames, text):
    house = House([hall(tmp_path)] * len(frames), frames)
    low, high = 0, len(frames) - 1
    facing(house, low, high)
    with pytest.raises((ProblemError, UnsupportedError), match=text):
        solve(house.problem, timeout=10)


def test_places_without_a_map_are_refused_by_name():
    kind = get_environment().type_manager.ConfigurationType("afloat", None, ConfigurationKind.SE2)
    problem = SchedulingMotionProblem("nowhere")
    problem.add_object(ConfigurationObject("here", kind, SE2(0, 0, 0)))
    with pytest.raises(ProblemError, match=r"type 'afloat' needs an OccupancyMap, not None"):
        solve(problem, timeout=10)


def test_halls_beside_each_other_at_one_height(tmp_path):
    """Each robot stays in its hall; a door between them would count in both: refused."""
    house = House([hall(tmp_path, "one"), hall(tmp_path, "two")], [(0, 0, 0), (12.0, 0, 0)])
    facing(house, 0, 1)
    result = solve(house.problem)
    assert result.status in SOLVED
    house.pose("between", 0, 11.9, 1.5, 0.0)
    house.robot("crate", "between")
    with pytest.raises(UnsupportedError, match=r"may reach onto map 'two\.yaml'"):
        solve(house.problem)


def test_a_pose_has_several_names_on_two_floors(tmp_path):
    """A parameter is the first floor's pose by some name; lifts and drives say them by others."""
    types = get_environment().type_manager
    problem = SchedulingMotionProblem("names")
    cells = np.zeros((60, 100), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True

    def floor(name, height):
        file = write_map(tmp_path, name, cells, 0.1)
        ground = OccupancyMap(str(tmp_path / file), lifted(Frame(0.0, 0.0, 0.0), height))
        return types.ConfigurationType(f"pose_{name}", ground, ConfigurationKind.SE2)

    def pose(name, kind, x, y=3.0):
        place = ConfigurationObject(name, kind, SE2(x, y, 0.0))
        problem.add_object(place)
        return place

    low, high = floor("low", 0.0), floor("high", 5.0)
    home, door, door_too = pose("home", low, 2), pose("door", low, 8), pose("door_too", low, 8)
    up, up_too, far = pose("up", high, 2), pose("up_too", high, 2), pose("far", high, 8)
    aside = pose("aside", low, 8, 4.5)
    robot = MovableObject(
        "r", types.MovableType("robot"), footprint=BOX, motion_model=MotionModels.SE2
    )
    problem.add_object(robot)
    problem.set_initial_configuration(robot, home)
    made = []

    def does(name, start, goal):
        activity = problem.add_motion_activity(name)
        activity.set_duration_bounds(1, 60)
        goal = activity.add_parameter("to", low) if goal is None else goal
        if start is not None:
            activity.add_motion_constraint(ActivityWaypoints(robot, start, [goal]))
        activity.add_motion_effect(robot, goal)
        if made:
            problem.add_constraint(LE(made[-1].end, activity.start))
        made.append(activity)

    does("go", home, None)
    does("ride", None, up)
    does("on", up_too, far)
    does("back", None, door_too)
    does("end", door, aside)
    problem.add_quality_metric(MinimizeMakespan())
    assert solve(problem).status in SOLVED
