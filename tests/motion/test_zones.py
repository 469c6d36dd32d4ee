"""Rules of places, and a speed limit backwards: planned, coordinated, judged."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType

from tests.motion.crossings import (
    ANY,
    CAR,
    CARS,
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
from tests.motion.fleet.independent import broken_by
from up_samp.extensions import extended
from up_samp.model import (
    Body,
    Deadline,
    Outcome,
    PathQuery,
    ProblemError,
    TrafficZone,
    Trajectory,
    UnsupportedError,
)
from up_samp.motion import Leg, MotionService
from up_samp.motion.curves.slowing import seconds_of, slowed, steps_in
from up_samp.motion.curves.trajectories import reversed_trajectory, twists
from up_samp.upio.read_maps import read_movable
from up_samp.validation.kinematics import limits_of


def block(x, y, long, wide, **rules):
    return TrafficZone(((x, y), (x + long, y), (x + long, y + wide), (x, y + wide)), **rules)


@KINDS
def test_a_zone_is_driven_through_at_its_speed_and_no_slower(kinematics):
    zone = block(6, 0, 3, 9, v_max=0.5)
    body = Body(RING, replace(kinematics, zones=(zone,)))
    free = drive(Body(RING, kinematics), (2.0, 4.5, 0.0), (14.0, 4.5, 0.0)).trajectory
    slow = drive(body, (2.0, 4.5, 0.0), (14.0, 4.5, 0.0)).trajectory
    # 4.2 m at 0.5 m/s; before it 3.4 m from 0 to 1.5 to 0.5 m/s, after it 4.4 m
    ramps = 1.5 / 0.7 + 1.0 / 0.7 - (1.5**2 + 1.5**2 - 0.5**2) / 1.4 / 1.5
    exact = 4.2 / 0.5 + (3.4 + 4.4) / 1.5 + 2 * ramps
    assert free.duration == pytest.approx(12 / 1.5 + 1.5 / 0.7)
    assert exact - 1e-6 <= slow.duration <= exact + 0.15
    assert broken_by("r", body, free)


@KINDS
def test_the_way_around_a_slow_zone_is_taken_where_it_is_quicker(kinematics):
    body = Body(RING, replace(kinematics, zones=(block(6, 0, 3, 6, v_max=0.2),)))
    ends = (2.0, 3.5, 0.0), (13.0, 3.5, 0.0)
    motion = drive(body, *ends).trajectory
    assert not any(steps_in(zone, motion.poses, body).any() for zone in body.kinematics.zones)
    assert motion.duration < 16.0
    # who begins in it has no way around
    inside = drive(body, (7.5, 3.5, 0.0), (13.0, 3.5, 0.0)).trajectory
    assert inside.duration > 2.1 / 0.2


@KINDS
@pytest.mark.parametrize("shuffle", [1, -1])
def test_a_slow_zone_is_gone_round_though_another_cannot_be(kinematics, shuffle):
    zones = (block(4, 0, 1, 9, v_max=0.6), block(8, 3, 3, 3, v_max=0.1))[::shuffle]
    body = Body(RING, replace(kinematics, zones=zones))
    motion = drive(body, (2.0, 4.5, 0.0), (14.0, 4.5, 0.0)).trajectory
    slowest = max(zones, key=lambda zone: -zone.v_max)
    assert not steps_in(slowest, motion.poses, body).any()
    assert motion.duration < 25.0


def test_who_turns_round_because_it_is_slow_backwards_goes_round_zones_as_well():
    """Neither of both is worth it alone: at first the way leads backwards beside the zone."""
    zone = block(5, 0, 3, 5.5, v_max=0.1)
    slow = replace(CAR, v_back=0.1, zones=(zone,))
    body = Body(RING, slow)
    ends = (2.0, 3.0, math.pi), (12.0, 3.0, math.pi)
    motion = drive(body, *ends).trajectory
    assert not steps_in(zone, motion.poses, body).any()
    assert np.min(twists(motion.poses)[:, 0]) > -1e-6
    assert motion.duration < 30.0


@KINDS
def test_what_is_slowed_is_never_called_the_fastest(kinematics):
    zone = block(6, 0, 3, 9, v_max=0.5)
    ends = (2.0, 4.5, 0.0), (14.0, 4.5, 0.0)
    for zones, complete in (((), True), ((block(0, 7, 9, 2, v_max=0.1),), True), ((zone,), False)):
        body, service = Body(RING, replace(kinematics, zones=zones)), MotionService(hall())
        report = drive(body, *ends, service=service)
        assert report.complete is complete
        assert service.lower_bound(body, ends) <= report.trajectory.duration + 1e-9


@pytest.mark.parametrize("kinematics", [CAR, WHEELS], ids=["car", "diff"])
def test_a_speed_limit_backwards_slows_or_turns_the_body_round(kinematics):
    body = Body(RING, replace(kinematics, v_back=0.25))
    near = drive(body, (8.0, 4.5, 0.0), (7.0, 4.5, 0.0)).trajectory
    assert near.duration == pytest.approx(1.0 / 0.25 + 0.25 / 0.7, abs=0.02)
    far = drive(body, (13.0, 4.5, 0.0), (3.0, 4.5, 0.0)).trajectory
    assert far.duration < 10.0 / 0.25
    assert broken_by(
        "r", body, drive(Body(RING, kinematics), (8.0, 4.5, 0.0), (3.0, 4.5, 0.0)).trajectory
    )


@pytest.mark.parametrize("start", [(15.0, 4.5, 0.0), (15.3, 4.5, 0.0), (14.8, 8.3, 0.0)])
def test_no_second_opinion_is_asked_for_on_another_way(start):
    """Who stands before a wall has to drive backwards, slow or not: that no way ahead was found
    took a random search of 2 s each time.
    """
    service, asked = MotionService(hall()), []
    lazily = service.legs._lazily
    service.legs._lazily = lambda name, *rest: asked.append(name) or lazily(name, *rest)
    body = Body(RING, replace(CAR, v_back=0.25))
    motion = drive(body, start, (5.0, 4.5, math.pi), service=service).trajectory
    assert np.min(twists(motion.poses)[:, 0]) < 0.0
    assert asked == ["car", "car"]  # as it is, and ahead only


@pytest.mark.parametrize("kinematics", [CAR, WHEELS], ids=["car", "diff"])
def test_driving_backwards_is_chosen_where_it_is_worth_what_it_counts(kinematics):
    ends = (8.0, 4.5, 0.0), (5.0, 4.5, 0.0)
    free = drive(Body(RING, kinematics), *ends)
    never = drive(Body(RING, replace(kinematics, reverse=False)), *ends)
    assert free.complete
    assert free.trajectory.duration < never.trajectory.duration
    turning = never.trajectory.duration / free.trajectory.duration
    for cost, chosen in ((0.9 * turning, free), (1.1 * turning, never)):
        body = Body(RING, replace(kinematics, back_cost=cost))
        report = drive(body, *ends)
        assert report.trajectory.duration == pytest.approx(chosen.trajectory.duration)
        assert seconds_of(report.trajectory, body) <= seconds_of(free.trajectory, body)
        assert not report.complete  # the fastest is another one, perhaps
    ahead = drive(Body(RING, replace(kinematics, back_cost=9.0)), *ends[::-1])
    assert ahead.complete
    assert seconds_of(ahead.trajectory, Body(RING, kinematics)) == ahead.trajectory.duration


@pytest.mark.parametrize(
    ("model", "radius", "given", "told"),
    [
        (MotionModels.SE2, 1.0, 2.0, "along its heading"),
        (MotionModels.REEDSSHEPP, 1.0, 0.5, "1 or more"),
        (MotionModels.REEDSSHEPP, 1.0, "two", "positive number"),
    ],
)
def test_what_driving_backwards_counts_is_checked(model, radius, given, told):
    parameters = {"turning_radius": radius, "reverse_cost": given}
    robot = MovableObject(
        "r", MovableType("r"), footprint=RING, motion_model=model, motion_parameters=parameters
    )
    with pytest.raises((ProblemError, UnsupportedError), match=told):
        read_movable(robot)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    ring=st.sampled_from((RING, WEDGE)),
    kinematics=st.sampled_from((CAR, WHEELS, ANY)),
)
def test_random_drives_keep_the_rules_whatever_their_order(seed, ring, kinematics):
    rng = np.random.default_rng(seed)
    zones = random_zones(rng, 4)
    if kinematics is not ANY and rng.random() < 0.4:
        kinematics = replace(kinematics, v_back=float(rng.uniform(0.2, 1.0)))
    grid = floor(rng, 4, 1.6)
    pair = []
    for some in (zones, shuffled(rng, zones)):
        body, service = Body(ring, replace(kinematics, zones=some)), MotionService(grid, seed=1)
        poses = tuple(free_pose(np.random.default_rng(seed + k), service, body) for k in (1, 2))
        report = service.plan(PathQuery(body, poses), Deadline.after(300))
        pair.append(None)
        if report.outcome is Outcome.FOUND:
            pair[-1] = report.trajectory.duration
            assert not broken_by("r", body, report.trajectory)
            assert report.trajectory.duration >= service.lower_bound(body, poses) - 1e-9
            again = slowed(report.trajectory, body)
            assert again is report.trajectory
    assert pair[0] == pytest.approx(pair[1], abs=1e-6)


def random_zones(rng, count):
    """Zones with some rules each, convex or with a notch."""
    zones = []
    for _ in range(count):
        x, y = rng.uniform((1, 1), (11, 7))
        long, wide = rng.uniform(0.3, 4.0, 2)
        ring = [(x, y), (x + long, y), (x + long, y + wide), (x, y + wide)]
        if rng.random() < 0.5:
            ring.insert(3, (x + long / 2, y + wide / 3))
        corners = tuple((float(a), float(b)) for a, b in ring)
        speed, way, pivots = rng.random(3) < 0.5
        zones.append(
            TrafficZone(
                corners,
                float(rng.uniform(0.15, 1.2)) if speed or not way else math.inf,
                one_way=float(rng.uniform(-math.pi, math.pi)) if way else None,
                pivots=bool(pivots),
            )
        )
    return tuple(zones)


def shuffled(rng, zones):
    """The same, listed in another order, and each ring from another corner, either way round."""
    found = []
    for k in rng.permutation(len(zones)):
        ring = zones[k].polygon
        turn = int(rng.integers(len(ring)))
        ring = ring[turn:] + ring[:turn]
        found.append(replace(zones[k], polygon=ring[::-1] if rng.random() < 0.5 else ring))
    return tuple(found)


def crossing(seed, count):
    """Robots of all kinds on one floor with zones, some for some of them."""
    rng = np.random.default_rng(seed)
    grid, zones = floor(rng, 2, 1.6), random_zones(rng, 4)

    def bodies():
        while True:
            kin = (CAR, WHEELS, ANY)[int(rng.integers(3))]
            kin = kin if kin is ANY else replace(kin, v_back=0.5)
            yield Body(RING, replace(kin, zones=zones[int(rng.integers(3)) :]))

    return Crossing(rng, grid, bodies(), count, seconds=300, due=120.0)


def test_several_robots(tmp_path):
    assert any([crossing(seed, 3).found(tmp_path) for seed in range(3)])


@pytest.mark.long
def test_many_groups_of_robots(tmp_path):
    found = [crossing(seed, 4).found(tmp_path) for seed in range(25)]
    assert sum(found) >= 15


def through(seed, count):
    """Robots on one floor with zones in which nobody stops."""
    rng = np.random.default_rng(seed)
    grid = floor(rng, 3, 1.6)
    zones = tuple(replace(zone, stops=False) for zone in random_zones(rng, 4))

    def bodies():
        while True:
            kin = (CAR, WHEELS, ANY)[int(rng.integers(3))]
            yield Body(RING, replace(kin, zones=zones[int(rng.integers(3)) :]))

    return Crossing(rng, grid, bodies(), count, seconds=300, due=200.0)


def test_nobody_stops_where_zones_forbid_it(tmp_path):
    assert any([through(seed, 4).found(tmp_path) for seed in range(3)])


@pytest.mark.long
def test_many_groups_that_do_not_stop_in_zones(tmp_path):
    found = [through(seed, 4).found(tmp_path) for seed in range(25)]
    assert sum(found) >= 15


@KINDS
def test_a_rest_in_a_zone_without_stops_is_told(kinematics):
    zone = block(6, 0, 3, 9, stops=False)
    body = Body(RING, replace(kinematics, zones=(zone,)))
    motion = drive(body, (2.0, 4.5, 0.0), (14.0, 4.5, 0.0)).trajectory
    middle = int(np.argmin(np.abs(motion.poses[:, 0] - 7.5)))
    for low, high, told in ((0, middle, True), (middle, None, True), (0, None, False)):
        part = Trajectory(motion.times[low:high] + 1.0, motion.poses[low:high])
        assert ("stop" in [v.kind for v in broken_by("r", body, part)]) is told
    times = motion.times.copy()
    times[middle + 1 :] += 2.0
    poses = np.insert(motion.poses, middle + 1, motion.poses[middle], axis=0)
    waits = Trajectory(np.insert(times, middle + 1, motion.times[middle] + 2.0 - 1e-3), poses)
    assert "stop" in [v.kind for v in broken_by("r", body, waits)]


@KINDS
@pytest.mark.parametrize(("cost", "around"), [(0.1, False), (60.0, True)])
def test_a_zone_is_gone_round_where_its_cost_is_worth_it(kinematics, cost, around):
    ends = (2.0, 4.5, 0.0), (14.0, 4.5, 0.0)
    zones = (block(7, 3, 2, 6, cost=cost), block(4, 0, 0.2, 1, cost=cost))
    free = drive(Body(RING, kinematics), *ends).trajectory
    body = Body(RING, replace(kinematics, zones=zones))
    report = drive(body, *ends)
    assert bool(steps_in(zones[0], report.trajectory.poses, body).any()) is not around
    longer = report.trajectory.duration - free.duration
    assert (0.1 < longer < 60.0) if around else longer == pytest.approx(0.0, abs=1e-6)
    assert not report.complete
    within = drive(body, (2.0, 4.5, 0.0), (8.0, 4.5, 0.0)).trajectory
    assert within.duration < 12.0


@KINDS
@pytest.mark.parametrize("turned", [False, True])
def test_a_lane_is_taken_where_it_is_worth_it(kinematics, turned):
    ends = ((2.0, 4.5, 0.0), (14.0, 4.5, 0.0))[:: -1 if turned else 1]
    ends = tuple((x, y, math.pi * turned) for x, y, _ in ends)
    found = {}
    for prefer in (1.0, 1.05, 5.0):
        lane = block(3, 5.6, 10, 1, prefer=prefer)
        body = Body(RING, replace(kinematics, zones=(lane,)))
        report = drive(body, *ends)
        on = lane.polygon[0][1] < report.trajectory.poses[:, 1]
        found[prefer] = float(on.mean()), report.complete
    assert found[1.0][0] == found[1.05][0] == 0.0
    assert found[5.0][0] > 0.5
    assert not found[5.0][1]


def test_turns_of_a_lane_are_driven_and_what_is_beside_it_costs():
    wide = (block(2, 6, 8, 1, prefer=4.0), block(9, 1, 1, 6, prefer=4.0))
    body = Body(RING, replace(ANY, zones=wide))
    motion = drive(body, (3.0, 5.0, 0.0), (9.5, 2.0, -1.5)).trajectory
    on = np.any(
        [shapely.contains_xy(shapely.Polygon(z.polygon), motion.poses[:, :2]) for z in wide], 0
    )
    assert on.mean() > 0.6
    assert seconds_of(motion, body) < 2.5 * motion.duration
    still = Trajectory(np.zeros(1), motion.poses[:1])
    assert seconds_of(still, body) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_who_prefers_lanes_is_never_worse_off_by_its_own_count(seed):
    rng = np.random.default_rng(seed)
    kinematics, grid = (CAR, WHEELS, ANY)[seed % 3], floor(rng, 4)
    body = Body(RING, kinematics)
    lanes = tuple(
        block(*rng.uniform((1, 1), (7, 8)), *long, prefer=float(rng.uniform(1.1, 6.0)))
        for long in rng.permutation([(5.0, 1.0), (1.0, 5.0), (4.0, 0.8)])
    )
    rich = replace(body, kinematics=replace(kinematics, zones=lanes))
    ends = [free_pose(rng, MotionService(grid), body) for _ in range(2)]
    query = PathQuery(rich, tuple(ends))
    there, plain = (
        MotionService(grid).plan(replace(query, body=b), Deadline.after(300)) for b in (rich, body)
    )
    assert there.outcome is plain.outcome
    if there.outcome is Outcome.FOUND:
        assert not broken_by("r", rich, there.trajectory)
        assert seconds_of(there.trajectory, rich) <= seconds_of(plain.trajectory, rich) + 1e-6


def test_a_lane_that_is_none_is_refused():
    kind = MovableType("robot")
    for prefer in (0.5, math.inf):
        zones = (block(0, 0, 1, 1, prefer=prefer),)
        given = MovableObject(
            "r", kind, footprint=RING, motion_model=MotionModels.SE2,
            motion_parameters={"zones": zones},
        )  # fmt: skip
        with pytest.raises(ProblemError, match="prefer 1 at least"):
            read_movable(given)


LOWER = block(5, 0, 6, 4.5, one_way=math.pi)


@CARS
def test_nobody_drives_against_the_direction_of_a_lane(kinematics):
    body, service = Body(RING, replace(kinematics, zones=(LOWER,))), MotionService(hall())
    east, west = (13.0, 3.0), (3.0, 3.0)
    there = drive(body, (*west, 0.0), (*east, 0.0), service=service)
    back = drive(body, (*east, math.pi), (*west, math.pi), service=service)
    assert there.trajectory.poses[:, 1].max() > 4.5
    assert back.trajectory.poses[:, 1].max() < 3.1
    assert back.complete
    # its reverse is another motion, and the validator knows it for what it is
    turned = reversed_trajectory(back.trajectory)
    assert [v.kind for v in broken_by("r", body, turned)] == ["wrong-way"]
    # what lies all across the hall is passed one way only
    wall = replace(kinematics, zones=(block(6, 0, 3, 9, one_way=math.pi),))
    query = PathQuery(Body(RING, wall), ((*west, 0.0), (*east, 0.0)))
    report = MotionService(hall()).plan(query, Deadline.after(300))
    assert report.outcome is Outcome.NOT_FOUND


@pytest.mark.parametrize("kinematics", [WHEELS, ANY], ids=["diff", "omni"])
def test_nobody_turns_on_the_spot_where_it_must_not(kinematics):
    shelves = block(0, 0, 6, 9, pivots=False)
    ends = (4.0, 4.5, 0.0), (4.0, 4.5, math.pi / 2)
    free = drive(Body(RING, kinematics), *ends).trajectory
    assert np.hypot(*np.diff(free.poses[:, :2], axis=0).T).sum() < 1e-6
    body = Body(RING, replace(kinematics, zones=(shelves,)))
    assert [v.kind for v in broken_by("r", body, free)] == ["turn-on-the-spot"]
    assert drive(body, *ends).trajectory.duration > free.duration


def test_the_validator_sees_who_creeps_against_a_direction():
    body = Body(RING, replace(ANY, zones=(LOWER,)))
    times = np.arange(2000.0) * 0.1
    for way, broken in ((1e-6, True), (-1e-6, False), (1e-7, False)):
        poses = np.zeros((2000, 3))
        poses[:, 0], poses[:, 1] = 8.0 + way * np.arange(2000.0), 2.0
        found = broken_by("r", body, Trajectory(times, poses))
        assert ("wrong-way" in [v.kind for v in found]) is broken
    # who gained on one visit has nothing left for the next one
    legs = [(10, 2), (7, 2), (7, 6), (9, 6), (9, 2), (9.5, 2)]
    rows = np.concatenate([np.linspace(a, b, 100) for a, b in itertools.pairwise(legs)])
    poses = np.column_stack((rows, np.zeros(len(rows))))
    kinds = [v.kind for v in broken_by("r", body, Trajectory(np.arange(len(rows)) * 0.1, poses))]
    assert "wrong-way" in kinds
    poses = poses[:-100]
    kinds = [v.kind for v in broken_by("r", body, Trajectory(np.arange(len(poses)) * 0.1, poses))]
    assert "wrong-way" not in kinds


class Straight:
    """A planner from outside that knows of no rule."""

    name, reversible = "straight", True

    def __init__(self, scene, seed):
        self._asked = MotionService(None)

    def leg(self, query, deadline):
        plain = replace(query.body, kinematics=replace(query.body.kinematics, zones=()))
        found = self._asked.plan(PathQuery(plain, (query.start, query.goal)), deadline)
        return Leg(found.trajectory, complete=True)


def test_planners_that_know_of_no_lanes_are_refused():
    ends = (3.0, 3.0, 0.0), (13.0, 3.0, 0.0)
    body = Body(RING, replace(CAR, zones=(LOWER,)))
    service = MotionService(hall(), planner="RRTConnect")
    with pytest.raises(UnsupportedError, match="RRTConnect"):
        service.plan(PathQuery(body, ends), Deadline.never())
    with extended("planners", "straight", Straight):
        service = MotionService(hall(), planner="straight")
        slow = replace(CAR, zones=(replace(LOWER, one_way=None, v_max=0.5),))
        assert service.plan(PathQuery(Body(RING, slow), ends), Deadline.never()).trajectory
        with pytest.raises(UnsupportedError, match="straight"):
            service.plan(PathQuery(body, ends), Deadline.never())


def movable(model=MotionModels.REEDSSHEPP, **parameters):
    return MovableObject(
        "r",
        MovableType("robot"),
        footprint=list(RING),
        motion_model=model,
        motion_parameters=parameters,
    )


def test_they_are_parameters_of_what_moves_in_the_plane():
    zones = block(0, 0, 3, 9, v_max=0.5), block(5, 0, 3, 9, v_max=0.3)
    item = movable(zones=zones, reverse_v_max=0.4)
    kinematics = read_movable(item).body.kinematics
    assert set(kinematics.zones) == set(limits_of(item).zones) == set(zones)
    assert kinematics.v_back == limits_of(item).v_back == 0.4
    # which is listed first means nothing
    assert (
        read_movable(item).body == read_movable(movable(zones=zones[::-1], reverse_v_max=0.4)).body
    )
    crossed = TrafficZone(((0, 0), (1, 1), (1, 0), (0, 1)), 0.5)
    for wrong in (
        {"zones": ("slow",)},
        {"zones": (crossed,)},
        {"zones": (block(0, 0, 1, 1, v_max=0.0),)},
        {"zones": (block(0, 0, 1, 1, one_way=math.nan),)},
        {"reverse_v_max": 0.0},
        {"reverse_v_max": "slow"},
    ):
        for read in (read_movable, limits_of):
            with pytest.raises(ProblemError, match=r"zone|reverse_v_max|TrafficZone"):
                read(movable(**wrong))
    with pytest.raises(UnsupportedError, match="reverse_v_max"):
        read_movable(movable(MotionModels.SE2, reverse_v_max=0.4))

    def slides(q, u, rate):
        rate[:] = [u[0], u[1], 0.0]

    own = MovableObject(
        "r",
        MovableType("robot"),
        footprint=list(RING),
        motion_model=MotionModels.SE2,
        motion_parameters={"zones": zones},
        control_model=slides,
        control_parameters={"vx_max": 1.0, "vy_max": 1.0},
    )
    for read in (read_movable, limits_of):
        with pytest.raises(UnsupportedError, match="zones"):
            read(own)
