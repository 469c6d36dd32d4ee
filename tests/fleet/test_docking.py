"""Places that robots come to straight: planned, judged, told, and gone on with from anywhere."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from unified_planning.model.motion import SE2
from unified_planning.shortcuts import OneshotPlanner, get_environment

import up_samp  # noqa: F401
from tests.fleet.floors import map_with
from tests.usual import usually
from up_samp.execution import Executor, dependencies_of
from up_samp.execution.floor import Delays
from up_samp.execution.simulate import Floor
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.picture import draw_fleet
from up_samp.model import ProblemError, Trajectory, UnsupportedError
from up_samp.model.bodies import same_pose
from up_samp.model.frames import Frame
from up_samp.upio.read import read_problem
from up_samp.upio.read_maps import read_movable
from up_samp.validation import validate_plan

MODELS = usually("diff", of=("car", "diff", "omni"))


def site(folder, rng, model="diff", **docking):
    """Two robots bring loads from two racks to a bay, listed in any order."""
    get_environment().credits_stream = None
    fleet = Fleet(map_with((), folder))
    fleet.add_robot_type("amr", footprint=(0.8, 0.6), model=model, a_max=0.7, turning_radius=0.8)
    docking = {"metres": 1.0, "v_max": 0.3} | docking
    back = {**docking, "backwards": True}
    places = [
        ("home1", 1.5, 2.5, 0.0, {}),
        ("home2", 1.5, 4.5, 0.0, {}),
        ("rack", 10.0, 4.6, math.pi / 2, {"docking": docking}),
        ("bay", 6.0, 1.0, math.pi / 2, {"docking": back}),
    ]
    robots = [("r1", "home1"), ("r2", "home2")]
    orders = [("o1", "rack", "bay"), ("o2", "rack", "home2")]
    for things in (places, robots, orders):
        rng.shuffle(things)
    for name, x, y, theta, options in places:
        fleet.add_place(name, x, y, theta, **options)
    for name, start in robots:
        fleet.add_robot(name, "amr", start)
    for name, pickup, delivery in orders:
        fleet.add_order(name, pickup=pickup, delivery=delivery)
    return fleet


def straight(plan, name, trajectory, reach):
    """Assert that the last stretch of a drive is on the line along its last heading."""
    goal = trajectory.poses[-1]
    far = np.hypot(*(trajectory.poses[:, :2] - goal[:2]).T) > reach
    last = trajectory.poses[int(np.flatnonzero(far)[-1]) + 1 :]
    rows = Frame(*goal).inverse.out(last)
    assert len(rows) > 5
    assert np.abs(rows[:, 1]).max() < 1e-3, name
    assert np.abs(np.remainder(rows[:, 2] + 1, math.tau) - 1).max() < 1e-3, name
    return rows


def planned(folder, seed, model):
    result = site(folder, np.random.default_rng(seed), model).solve(timeout=60, first_plan=True)
    assert result.plan is not None
    assert validate_plan(result.problem, result.plan).valid
    return result


@pytest.fixture(scope="module")
def docked(tmp_path_factory):
    """The plan of differential drives."""
    return planned(tmp_path_factory.mktemp("docked"), 3, "diff")


@pytest.mark.parametrize("model", MODELS)
def test_drives_to_docks_end_straight(tmp_path, docked, model):
    result = docked if model == "diff" else planned(tmp_path, len(model), model)
    docked = 0
    for name, trajectory in result.plan.trajectories.items():
        place = next((p for p in ("rack", "bay") if name.endswith(f"_to_{p}")), None)
        if place is not None:
            rows = straight(result.plan, name, trajectory, 0.97)
            assert (rows[0, 0] > 0) == (place == "bay")
            docked += 1
    assert docked >= 3
    # whoever comes from the side, or too fast, is refused
    name, motion = next(
        (n, t) for n, t in result.plan.trajectories.items() if n.endswith("_to_rack")
    )
    shear = np.clip(0.05 - np.abs(np.linspace(-0.3, 0.0, len(motion.poses))), 0.0, None)
    aside = motion.poses.copy()
    aside[:, 0] += shear * (aside[:, 1] < 4.59)
    wrong = {**result.plan.trajectories, name: Trajectory(motion.times, aside)}
    kinds = {v.kind for v in validate_plan(result.problem, result.plan, wrong).violations}
    assert "docking" in kinds


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_the_rest_of_a_drive_to_a_dock_is_planned_from_anywhere(tmp_path, docked, seed):
    rng = np.random.default_rng(seed)
    result = planned(tmp_path, rng, "diff") if seed else docked
    plan = result.data
    found = dependencies_of(result.problem, plan)
    for share in rng.uniform(0.05, 0.9, 1 + seed):
        executor = Executor(plan, result.problem, dependencies=found)
        floor = Floor(executor, Delays(slow=0.3), seed)
        while floor.now < share * plan["makespan"]:
            floor.step()
        left = executor.remaining_problem()
        with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
            again = planner.solve(left.problem, timeout=60)
        assert again.plan is not None, again.log_messages
        assert validate_plan(left.problem, again.plan).valid


def test_walls_on_the_straight_way_and_robots_that_cannot_reverse_are_told(tmp_path):
    rng = np.random.default_rng(0)
    fleet = site(tmp_path, rng, metres=9.0)
    told = [str(finding) for finding in fleet.check()]
    assert any("straight way" in text and "docking" in text for text in told)
    fleet = Fleet(map_with((), tmp_path))
    fleet.add_robot_type("amr", footprint=(0.8, 0.6), model="diff", reverse="never")
    with pytest.raises(FleetError, match="never drive backwards"):
        fleet.add_place("bay", 6, 1, 1.57, docking={"metres": 1.0, "backwards": True})


def test_places_at_one_pose_are_docked_at_alike(tmp_path):
    docking = {"metres": 1.0, "v_max": 0.3}
    places = [("bay", 0.0, docking), ("bay2", math.tau, docking), ("left", math.pi, None)]
    for listing in itertools.permutations(places):
        fleet = Fleet(map_with((), tmp_path))
        for name, theta, how in listing:
            fleet.add_place(name, 6.0, 3.0, theta, **({"docking": how} if how else {}))
        fleet.save(tmp_path / "site.yaml")
        assert set(Fleet.from_file(tmp_path / "site.yaml").records.places) == {
            "bay",
            "bay2",
            "left",
        }
    for there in ({}, {"docking": docking | {"v_max": 0.2}}):
        for name in ("aisle", "zoo"):  # listed before it, and after it
            data = yaml.safe_load((tmp_path / "site.yaml").read_text())
            data["places"][name] = {"pose": [6.0, 3.0004, -math.tau], **there}
            data["places"] = dict(sorted(data["places"].items()))
            (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
            with pytest.raises(
                FleetError, match=r"is at the same pose, and is docked at otherwise"
            ):
                Fleet.from_file(tmp_path / "wrong.yaml")


def test_rules_are_drawn_before_there_are_robot_types(tmp_path):
    fleet = Fleet(map_with((), tmp_path))
    fleet.add_zone("slowly", [(3, 3), (5, 3), (5, 5), (3, 5)], v_max=0.4)
    drawn = len(draw_fleet(fleet.records, tmp_path).get_children())
    fleet.add_robot_type("amr", footprint=(0.8, 0.6))
    assert len(draw_fleet(fleet.records, tmp_path).get_children()) == drawn
    fleet.records.zones.clear()
    assert len(draw_fleet(fleet.records, tmp_path).get_children()) < drawn


def test_only_waypoints_that_lie_ahead_are_left_of_a_drive(docked):
    """Who stands on the straight way has its front behind it, whichever robot is asked."""
    result = docked
    plan = result.data
    found = dependencies_of(result.problem, plan)
    fronts = {True: 0, False: 0}
    executor = Executor(plan, result.problem, dependencies=found)
    floor = Floor(executor, Delays(), 0)
    while floor.now < plan["makespan"] - 1:
        for _ in range(3):
            floor.step()
        left = executor.remaining_problem()
        for activity in left.problem.motion_activities:
            for constraint in activity.motion_constraints:
                zones = constraint.movable.object().motion_parameters["zones"]
                *inner, last = (node.object().configuration for node in constraint.waypoints)
                goal, start = tuple(last), tuple(constraint.starting.object().configuration)
                zone = next((z for z in zones if z.dock and z.binds(goal)), None)
                if zone is not None and not (inner and same_pose(tuple(inner[-1]), start, 0.02)):
                    assert bool(inner) is not zone.leads_in(start), (activity.name, start)
                    fronts[bool(inner)] += 1
    assert min(fronts.values()) > 0


def test_motions_of_problems_that_do_not_come_straight_are_refused_by_name(tmp_path):
    fleet = site(tmp_path, np.random.default_rng(1))
    problem = fleet.problem
    drive = next(a for a in problem.motion_activities if a.name.endswith("home1_to_rack"))
    (constraint,) = drive.motion_constraints
    front, rack = constraint.waypoints
    constraint._waypoints = [rack]
    with pytest.raises(ProblemError, match=r"come straight to rack"):
        read_problem(problem)
    here = front.object().configuration
    front.object()._configuration = SE2(here.x, here.y + 0.3, here.theta)  # in the zone
    constraint._waypoints = [front, rack]
    with pytest.raises(ProblemError, match=r"come straight to rack.* where the zone begins"):
        read_problem(problem)
    front.object()._configuration = here
    constraint._waypoints = [front, rack, front, rack]
    with pytest.raises(UnsupportedError, match="goes on from a dock"):
        read_problem(problem)


def test_zones_through_which_nobody_comes_to_their_dock_are_refused_by_name(tmp_path):
    problem = site(tmp_path, np.random.default_rng(2)).problem
    drive = next(a for a in problem.motion_activities if a.name.endswith("home1_to_rack"))
    (constraint,) = drive.motion_constraints
    robot = constraint.movable.object()
    zone = next(z for z in robot.motion_parameters["zones"] if z.binds((10.0, 4.6, math.pi / 2)))
    x, y, _ = zone.dock
    for polygon in (
        ((x - 1, y - 1.0), (x + 1, y - 1.0), (x + 1, y - 0.5), (x - 1, y - 0.5)),  # before it
        ((x - 1, y - 1.0), (x + 1, y - 1.0), (x + 1, y), (x - 1, y)),  # it is on the edge
        ((x, y - 1.0), (x + 1, y - 1.0), (x + 1, y + 0.1), (x, y + 0.1)),  # the line is an edge
        ((x - 1, y - 1.0), (x + 1, y - 0.5), (x + 1, y + 0.1), (x - 1, y + 0.1)),  # farthest aside
    ):
        for k in range(4):
            turned = (*polygon[k:], *polygon[:k])[:: (-1) ** k]
            robot.motion_parameters["zones"] = (replace(zone, polygon=turned),)
            with pytest.raises(ProblemError, match=r"has to hold the dock, and the straight way"):
                read_movable(robot)
    wide = ((x - 1, y - 1.0), (x + 1, y - 1.0), (x + 1, y + 0.1), (x - 1, y + 0.1))
    robot.motion_parameters["zones"] = (replace(zone, polygon=wide),)
    assert read_movable(robot)
