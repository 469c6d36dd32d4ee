"""Docks: come to straight, at the speed asked for, by whoever ends there and nobody else."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.motion.crossings import (
    ANY,
    CAR,
    KINDS,
    RING,
    WEDGE,
    WHEELS,
    Crossing,
    drive,
    floor,
    free_pose,
    hall,
)
from tests.motion.fleet.independent import broken_by, judge
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Outcome,
    PathQuery,
    Placed,
    TimedMotion,
    TrafficZone,
    Trajectory,
)
from up_samp.model.frames import Frame
from up_samp.motion import MotionService
from up_samp.motion.legs import comes_straight, docking_leg
from up_samp.motion.protocol import LegQuery


def dock(pose, metres, v_max=math.inf, behind=False):
    """The zone of a dock, and the pose from where it is come to straight."""
    side = 1.0 if behind else -1.0
    frame = Frame(*pose)
    low, high = sorted((side * (metres - 0.01), -side * 0.01))
    corners = frame.points([(low, -0.01), (high, -0.01), (high, 0.01), (low, 0.01)])
    front = frame.of((side * metres, 0.0, 0.0))
    return TrafficZone(tuple(map(tuple, corners.tolist())), v_max, dock=tuple(pose)), front


@KINDS
@pytest.mark.parametrize("behind", [False, True], ids=["ahead", "behind"])
def test_the_last_metres_are_driven_straight_and_slowly(kinematics, behind):
    goal = (12.0, 6.0, math.pi / 3)
    zone, front = dock(goal, 1.5, 0.3, behind)
    body = Body(RING, replace(kinematics, zones=(zone,)))
    motion = drive(body, (2.0, 3.0, 0.0), front, goal).trajectory
    far = np.hypot(*(motion.poses[:, :2] - goal[:2]).T) > 1.48
    last = slice(int(np.flatnonzero(far)[-1]) + 1, None)
    rows, times = Frame(*goal).inverse.out(motion.poses[last]), motion.times[last]
    assert np.abs(rows[:, 1]).max() < 1e-4
    assert np.abs(np.remainder(rows[:, 2] + 1, math.tau) - 1).max() < 1e-4
    assert (np.hypot(*np.diff(rows[:, :2], axis=0).T) / np.diff(times)).max() <= 0.301
    # as fast as can be: what the dock asks for is the same on every way
    # (what moves in any direction might pass the front faster than it is told to)
    assert drive(body, (2.0, 3.0, 0.0), front, goal).complete is (kinematics is not ANY)
    usual = drive(Body(RING, kinematics), (2.0, 3.0, 0.0), front, goal).trajectory
    assert motion.duration > usual.duration + 2.0
    assert broken_by("r", body, usual)
    assert MotionService(hall()).lower_bound(body, ((2.0, 3.0, 0.0), front, goal)) > (
        MotionService(hall()).lower_bound(Body(RING, kinematics), ((2.0, 3.0, 0.0), front, goal))
    )


@KINDS
def test_who_passes_or_leaves_is_not_bound(kinematics):
    goal = (8.0, 4.5, math.pi / 2)
    zone, _ = dock(goal, 1.5, 0.1)
    for ends in (((2.0, 3.8, 0.0), (14.0, 3.8, 0.0)), (goal, (14.0, 3.8, 0.0))):
        free = drive(Body(RING, kinematics), *ends).trajectory
        ruled = drive(Body(RING, replace(kinematics, zones=(zone,))), *ends).trajectory
        assert ruled.duration == free.duration


@KINDS
@pytest.mark.parametrize("gap", [0.02, 0.005, 0.001, 0.0001, -0.001])
def test_the_straight_way_is_as_narrow_as_it_is(kinematics, gap):
    goal = (12.0, 6.0, 0.0)
    zone, front = dock(goal, 3.0)
    body = Body(RING, replace(kinematics, zones=(zone,)))
    post = Body(((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)), kinematics)
    beside = Placed("post", post, (10.2, 6.0 + 0.35 + 0.1 + gap, 0.0))
    query = PathQuery(body, ((2.0, 3.0, 0.0), front, goal), (beside,))
    report = MotionService(hall()).plan(query, Deadline.after(60))
    assert (report.trajectory is not None) is (gap > 0)


@KINDS
def test_who_stands_on_the_straight_way_is_told(kinematics):
    goal = (12.0, 6.0, 0.0)
    zone, front = dock(goal, 3.0, 0.3)
    body = Body(RING, replace(kinematics, zones=(zone,)))
    service = MotionService(hall())
    there = Placed("parked", Body(RING, kinematics), (10.5, 5.5, 0.0))
    elsewhere = Placed("aside", Body(RING, kinematics), (5.0, 2.0, 0.0))
    query = PathQuery(body, ((2.0, 3.0, 0.0), front, goal), (elsewhere, there))
    report = service.plan(query, Deadline.after(60))
    assert report.trajectory is None
    assert report.blockers == {"parked"}
    assert "straight" in report.reason


def test_who_drives_ahead_only_comes_to_no_dock_backwards():
    """As who would rather not drive backwards is asked how it gets there ahead."""
    goal = (12.0, 6.0, 0.0)
    service = MotionService(hall())
    for behind in (False, True):
        zone, front = dock(goal, 1.5, behind=behind)
        for reverse in (False, True):
            body = Body(RING, replace(WHEELS, zones=(zone,), reverse=reverse))
            leg = docking_leg(service.scene, LegQuery(body, front, goal))
            assert (leg.trajectory is None) == (behind and not reverse)
            report = service.plan(
                PathQuery(body, ((2.0, 3.0, 0.0), front, goal)), Deadline.after(20)
            )
            assert (report.trajectory is None) == (behind and not reverse)


def test_ways_from_the_side_are_not_straight():
    goal = (5.0, 5.0, 0.0)
    zone, front = dock(goal, 1.0)
    body = Body(RING, replace(ANY, zones=(zone,)))
    rows = np.array([(3.0, 5.0, 0.0), front, goal])
    good = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(rows)])
    assert comes_straight(good, body)
    assert not broken_by_dock(body, good)
    for wrong in (
        np.linspace((5.0, 3.0, 0.0), goal, 60),  # sideways
        np.linspace((3.0, 5.0, 0.4), goal, 60),  # turning
        np.linspace((6.0, 5.0, 0.0), goal, 60),  # from the other side
        np.concatenate(
            [
                np.linspace((4.5, 3.0, 0.0), (4.5, 5.0, 0.0), 60),
                np.linspace((4.5, 5.0, 0.0), goal, 20),
            ]
        ),
    ):
        assert not comes_straight(wrong, body)
        assert broken_by_dock(body, wrong)
    assert comes_straight(np.linspace((4.5, 5.0, 0.0), goal, 20), body)  # it began there


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_the_planner_and_the_judge_agree_on_what_is_straight(seed):
    rng = np.random.default_rng(seed)
    goal = tuple(rng.uniform((5, 3, -3), (11, 6, 3)).tolist())
    metres, behind = float(rng.uniform(0.3, 2.0)), bool(rng.integers(2))
    zone, _ = dock(goal, metres, behind=behind)
    side = 1.0 if behind else -1.0
    aside = 0.3 * rng.choice([-1.0, 1.0]) * (rng.random(2) < 0.3)
    line = [(0.0, 0.0, 0.0), (side * metres * float(rng.choice([0.4, 0.8, 1.0, 1.5])), *aside)]
    # ways that come from beside the line, from the other side, or that begin on it
    before = [(-side * metres, 0.0, 0.0), (line[1][0], 2.0, 1.0), (side * metres / 2, 0.0, 0.0)]
    some = rng.permutation(len(before))[: rng.integers(len(before) + 1)]
    corners = [Frame(*goal).of(at) for at in [*(before[k] for k in some), line[1], line[0]]]
    ways = [np.linspace(a, b, 60) for a, b in itertools.pairwise(corners)]
    rows = np.concatenate([ways[0], *(way[1:] for way in ways[1:])])
    body = Body(RING, replace(ANY, zones=(zone,)))
    assert comes_straight(rows, body) is not bool(broken_by_dock(body, rows))


def broken_by_dock(body, rows):
    """Slowly enough to keep all other limits."""
    times = np.linspace(0.0, 0.1 * len(rows), len(rows))
    return [v for v in broken_by("r", body, Trajectory(times, rows)) if v.kind == "docking"]


@KINDS
def test_no_lane_leads_beside_the_straight_way(kinematics):
    """A lane that crosses the way in is worth leaving it for, by what is driven beside lanes."""
    goal = (8.0, 7.0, math.pi / 2)
    zone, front = dock(goal, 5.0, 0.8)
    lane = TrafficZone(((6.8, 1.0), (7.8, 1.0), (7.8, 8.0), (6.8, 8.0)), prefer=9.0)
    body = Body(RING, replace(kinematics, zones=(lane, zone)))
    motion = drive(body, (2.0, 2.0, 0.0), front, goal).trajectory
    assert comes_straight(motion.poses, body)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    ring=st.sampled_from((RING, WEDGE)),
    kinematics=st.sampled_from((CAR, WHEELS, ANY)),
    behind=st.booleans(),
)
def test_random_docks_are_come_to_straight(seed, ring, kinematics, behind):
    rng = np.random.default_rng(seed)
    service = MotionService(floor(rng, 3, 1.6), seed=1)
    start, goal = (
        free_pose(np.random.default_rng(seed + k), service, Body(ring, kinematics)) for k in (1, 2)
    )
    metres = float(rng.uniform(0.3, 2.0))
    zone, front = dock(goal, metres, float(rng.uniform(0.1, 2.0)), behind)
    others = [dock(free_pose(rng, service, Body(ring, kinematics)), 1.0, 0.2)[0] for _ in range(3)]
    zones = [*others, zone]
    rng.shuffle(zones)
    body = Body(ring, replace(kinematics, zones=tuple(zones)))
    report = service.plan(PathQuery(body, (start, front, goal)), Deadline.after(300))
    if report.outcome is Outcome.FOUND:
        assert not broken_by("r", body, report.trajectory)
        assert comes_straight(report.trajectory.poses, body)
        bound = service.lower_bound(body, (start, front, goal))
        assert report.trajectory.duration >= bound - 1e-9
    else:
        leg = docking_leg(service.scene, LegQuery(body, front, goal))
        there = service.plan(PathQuery(body, (start, front)), Deadline.after(300))
        assert leg.trajectory is None or there.outcome is not Outcome.FOUND


def docking(seed, count, swap=False):
    """Robots on one floor that each come to a dock; all know of all docks, in any order. ``swap``:
    each begins at the dock of another one.
    """
    rng = np.random.default_rng(seed)
    grid = floor(rng, 2, 1.6)
    metres, behind = float(rng.uniform(0.5, 2.0)), bool(rng.integers(2))

    def before(goal):
        return (dock(goal, metres, behind=behind)[1],)

    kinds = [(CAR, WHEELS, ANY)[int(k)] for k in rng.integers(3, size=count)]
    plain = [Body(RING, kin) for kin in kinds]
    group = Crossing(rng, grid, plain, count, seconds=300, due=200.0, before=before)
    zones = [dock(m.poses[-1], metres, 0.4, behind)[0] for m in group.query.motions]
    motions = []
    for k in rng.permutation(count):
        motion = group.query.motions[k]
        if swap:
            begin = group.query.motions[k - 1].poses[-1]
            motion = replace(motion, poses=(begin, *motion.poses[1:]))
        some = tuple(zones[i] for i in rng.permutation(count))
        kin = replace(motion.body.kinematics, zones=some)
        motions.append(replace(motion, body=replace(motion.body, kinematics=kin)))
    group.query = GroupQuery(tuple(motions))
    return group


def test_robots_in_traffic_come_to_their_docks_straight(tmp_path):
    assert sum([docking(seed, 3, seed % 2 > 0).found(tmp_path) for seed in range(6)]) >= 3


@KINDS
@pytest.mark.parametrize("first", [True, False], ids=["told_first", "told_last"])
@pytest.mark.parametrize("release", [0.0, 20.0])
def test_who_stands_on_the_straight_way_for_a_while_is_waited_for(
    kinematics, first, release, tmp_path
):
    goal = (13.0, 4.5, 0.0)
    zone, front = dock(goal, 6.0, 0.8)
    docked = Body(RING, replace(kinematics, zones=(zone,)))
    comes = TimedMotion("m0", "r0", docked, ((2.0, 3.0, 0.0), front, goal), 0.0, 200.0)
    ends = ((10.0, 4.5, math.pi / 2), (4.0, 7.0, math.pi))
    leaves = TimedMotion("m1", "r1", Body(RING, kinematics), ends, release, 200.0)
    query = GroupQuery((comes, leaves)[:: 1 if first else -1])
    report = MotionService(hall()).coordinate(query, Deadline.after(300))
    judge(SimpleNamespace(query=query, grid=hall()), report, tmp_path)
    assert report.trajectories["m0"].end > release


@pytest.mark.long
def test_many_robots_in_traffic_come_to_their_docks_straight(tmp_path):
    assert sum([docking(seed, 4, seed % 2 > 0).found(tmp_path) for seed in range(6, 36)]) >= 15
