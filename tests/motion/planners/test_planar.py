import itertools
import math

import numpy as np
import pytest

from tests.motion.oracle import RECTANGLE, box_map, ends_exactly, smallest_clearance
from up_samp.geometry import Scene
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery, Placed
from up_samp.motion import LegQuery, MotionService
from up_samp.motion.planners.omni import PlanarPlanner, PlanarSettings

KIN = Kinematics(MotionModel.SE2, v_max=1.5, a_max=0.8, omega_max=0.7)
SLIDER = Body(RECTANGLE, KIN)


def faults(trajectory, kin):
    t, p = trajectory.times, trajectory.poses
    dt = np.diff(t)
    d = np.diff(p, axis=0)
    velocity = d[:, :2] / dt[:, None]
    said = []
    if dt.max() > trajectory.MAX_STEP + 1e-9:
        said.append("samples too far apart")
    if np.hypot(*velocity.T).max() > kin.v_max * (1 + 1e-9):  # rounding
        said.append("too fast")
    if np.abs(d[:, 2] / dt).max() > kin.omega_max * (1 + 1e-9):
        said.append("turns too fast")
    middle = (t[:-1] + t[1:]) / 2
    a = np.hypot(*(np.diff(velocity, axis=0) / np.diff(middle)[:, None]).T)
    if len(a) and a.max() > kin.a_max * 1.001:
        said.append(f"accelerates too much: {a.max()}")
    for i in (0, -1):
        if np.hypot(*velocity[i]) > kin.a_max * dt[i] / 2 * 1.001:
            said.append("not from rest to rest")
    return said


def check(service, body, poses, obstacles=()):
    report = service.plan(PathQuery(body, poses, obstacles), Deadline.after(60))
    assert report.outcome is Outcome.FOUND, report
    trajectory = report.trajectory
    assert ends_exactly(trajectory, poses[0], poses[-1])
    assert faults(trajectory, body.kinematics) == []
    assert smallest_clearance(trajectory, body, service.grid, obstacles) > 0
    bound = service.lower_bound(body, (poses[0], poses[-1]), obstacles)
    assert trajectory.duration >= bound - 1e-9
    return trajectory, bound


def test_straight_and_sideways():
    service = MotionService(box_map(20, 10))
    trajectory, bound = check(service, SLIDER, ((3, 2, 0.0), (3, 8, 0.0)))
    assert trajectory.duration == pytest.approx(bound, rel=1e-3)


def test_turning_on_the_spot():
    service = MotionService(box_map(20, 10))
    trajectory, _ = check(service, SLIDER, ((5, 5, 0.0), (5, 5, 3.0)))
    assert trajectory.duration == pytest.approx(3.0 / 0.7, rel=1e-3)


def test_round_walls_without_stopping_at_each_corner():
    grid = box_map(30, 20, [(10, 0, 11, 12), (19, 8, 20, 20)])
    trajectory, bound = check(MotionService(grid), SLIDER, ((4, 4, 0.0), (26, 16, 1.0)))
    assert trajectory.duration <= 1.4 * bound
    speed = np.hypot(*np.diff(trajectory.poses[:, :2], axis=0).T) / np.diff(trajectory.times)
    inside = speed[(trajectory.times[1:] > 3) & (trajectory.times[1:] < trajectory.end - 3)]
    assert inside.min() > 0.05


def test_a_gap_that_needs_the_right_heading():
    grid = box_map(20, 10, [(9, 0, 11, 4.3), (9, 5.7, 11, 10)])  # 1.4 m: only along the robot
    trajectory, _ = check(MotionService(grid), SLIDER, ((4, 2, math.pi / 2), (16, 8, math.pi / 2)))
    through = np.abs(trajectory.poses[:, 0] - 10).argmin()
    assert abs(math.sin(trajectory.poses[through, 2])) < 0.4


def test_objects_and_waypoints():
    service = MotionService(box_map(20, 10))
    parked = Placed("p", SLIDER, (10.0, 5.0, math.pi / 2))
    check(service, SLIDER, ((4, 5, 0.0), (16, 5, 0.0)), (parked,))
    trajectory, _ = check(service, SLIDER, ((4, 5, 0.0), (10, 8, 1.0), (16, 5, 0.0)), (parked,))
    assert np.hypot(trajectory.poses[:, 0] - 10, trajectory.poses[:, 1] - 8).min() < 1e-9


def test_random_places():
    rng = np.random.default_rng(4)
    walls = [(5, 0, 6, 6), (10, 4, 11, 10), (14, 0, 15, 6)]
    service = MotionService(box_map(20, 10, walls))
    found = 0
    while found < 4:
        ends = [
            (*rng.uniform(1, 19, 1), *rng.uniform(1, 9, 1), *rng.uniform(-3, 3, 1))
            for _ in range(2)
        ]
        ends = [tuple(map(float, e)) for e in ends]
        if all(service.scene.pose_free(SLIDER, e, (), 0.05) for e in ends):
            check(service, SLIDER, tuple(ends))
            found += 1


def test_corners_pushed_outwards_save_time():
    scene = Scene(box_map(30, 20, [(10, 0, 11, 12), (19, 8, 20, 20)]))
    query = LegQuery(SLIDER, (4.0, 4.0, 0.0), (26.0, 16.0, 0.0))
    hugging, pushed = (
        PlanarPlanner(scene, 0, settings).leg(query, Deadline.never()).trajectory
        for settings in (PlanarSettings(shifts=()), PlanarSettings())
    )
    assert pushed.duration < 0.99 * hugging.duration
    assert faults(pushed, KIN) == []
    assert smallest_clearance(pushed, SLIDER, scene.grid, ()) > 0


def test_a_motion_lasts_as_long_as_its_reverse_whichever_is_asked_for_first():
    grid = box_map(10, 7, [(4.4, 2.0, 10, 2.4), (4.4, 4.4, 10, 4.8)])
    kin = Kinematics(MotionModel.SE2, 1.0, 1.0, 0.5, 1.0)
    body = Body(((-0.4, -0.25), (0.4, -0.25), (0.4, 0.25), (-0.4, 0.25)), kin)
    pairs = [
        ((5.5, 1.2, 0.0), (2.6, 6.0, -math.pi / 2)),
        ((7.0, 1.2, 0.0), (2.6, 6.0, -math.pi / 2)),
        ((8.5, 3.4, 0.0), (1.0, 6.0, -math.pi / 2)),
    ]
    found = []
    for turned in (False, True):
        service = MotionService(grid)
        for a, b in pairs:
            ends = (b, a) if turned else (a, b)
            for poses in (ends, ends[::-1]):
                report = service.plan(PathQuery(body, poses), Deadline.after(30))
                assert report.trajectory.poses[0] == pytest.approx(poses[0])
                found.append(report.trajectory.duration)
    assert found[:6] == pytest.approx(found[6:])
    assert found[::2] == pytest.approx(found[1::2])


def test_the_longer_way_round_is_not_taken_for_the_fastest():
    """Random pillars: a leg is about as short as a disc's way, or no longer than its reverse."""
    rng, settings = np.random.default_rng(3), PlanarSettings()
    asked = 0
    for _ in range(12):
        squares = [
            Placed(f"p{k}", Body(((-1, -1), (1, -1), (1, 1), (-1, 1)), KIN), (*xy, 0.0))
            for k, xy in enumerate(rng.uniform((4, 2), (16, 8), (3, 2)).tolist())
        ]
        ends = [(*rng.uniform((1, 1), (2.5, 9)), 1.6), (*rng.uniform((17.5, 1), (19, 9)), 3.1)]
        planner = PlanarPlanner(Scene(box_map(20, 10)), 0, settings)
        ways = [(ends[0], ends[1]), (ends[1], ends[0])]
        queries = [LegQuery(SLIDER, a, b, tuple(squares)) for a, b in ways]
        there, back = (planner.leg(q, Deadline.after(60)).trajectory for q in queries)
        if there is None or back is None:
            continue
        asked += 1
        once = PlanarPlanner(planner.scene, 0, PlanarSettings(roundabout=math.inf))
        alone = [once.leg(q, Deadline.after(60)).trajectory.duration for q in queries]
        least = min(alone)
        for motion, first in zip((there, back), alone, strict=True):
            assert motion.duration <= first + 1e-9
            assert faults(motion, KIN) == []
            # who is slower than the better direction is near the shortest way of a disc, and that
            # is at most what the better direction takes
            assert motion.duration <= max(least + 0.01, settings.roundabout * least)
    assert asked >= 8


def test_gaps_that_the_steps_from_one_end_miss_are_found_from_the_other():
    """A gap a few centimetres wider than the body, before the goal; starts anywhere in a hall."""
    grid = box_map(24, 16, [(16, 0, 16.4, 8.0), (16, 9.2, 16.4, 16)])
    rng, efforts = np.random.default_rng(5), {}
    starts = [(*rng.uniform((2, 2), (13, 14)), rng.uniform(-3, 3)) for _ in range(8)]
    for soon in (PlanarSettings().soon, 10**9):
        planner = PlanarPlanner(Scene(grid, 0.05), 0, PlanarSettings(soon=soon))
        some = starts[:1] if soon == 10**9 else starts
        for start, swap in itertools.product(some, (False, True)):
            ends = (start, (19.0, 8.6, 0.0))[:: -1 if swap else 1]
            leg = planner.leg(LegQuery(SLIDER, *ends), Deadline.never())
            assert leg.trajectory is not None
            assert ends_exactly(leg.trajectory, *ends)
            assert faults(leg.trajectory, KIN) == []
            assert smallest_clearance(leg.trajectory, SLIDER, grid, ()) > 0
            efforts.setdefault(soon, []).append(leg.effort)
    assert max(efforts[PlanarSettings().soon]) < 2 * PlanarSettings().soon
    assert max(efforts[10**9]) > 10_000  # from one end alone
