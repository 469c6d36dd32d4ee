"""Groups whose answer is known."""

import itertools
import math

import numpy as np
import pytest

from tests.motion.fleet.spacetime_oracle import CAR, Straight, judge, motion, room
from up_samp.model import (
    Deadline,
    GroupQuery,
    GroupReport,
    Outcome,
    Rest,
    TimedMotion,
)
from up_samp.motion.curves.reeds_shepp import DriveLimits
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.paths import TimeSets
from up_samp.motion.fleet.speed import TunedPath, in_time, reachable
from up_samp.motion.fleet.timed_path import natural_timing, run_of
from up_samp.motion.fleet.together import couple
from up_samp.motion.fleet.workspace import rest_run, workspace_of
from up_samp.motion.service import MotionService

UP = math.pi / 2
CORRIDOR = (1, 1, 39, 3)  # one robot wide


def solve(service, motions, rests=(), seconds=120.0):
    return coordinate(service, GroupQuery(tuple(motions), tuple(rests)), Deadline.after(seconds))


def test_nobody_meets_anybody():
    motions = [motion("a", (0, 0, 0), (20, 0, 0), 3), motion("b", (0, 5, 0), (20, 5, 0), 4)]
    report = solve(Straight(), motions)
    judge(report, motions)
    assert report.trajectories["a"].start == 3.0
    assert report.trajectories["b"].start == 4.0
    assert not report.late
    assert not report.conflict


def test_one_waits_at_a_crossing():
    motions = [motion("a", (0, 0, 0), (40, 0, 0)), motion("b", (20, -20, UP), (20, 20, UP))]
    report = solve(Straight(), motions)
    judge(report, motions)
    # alone both need 24 s; the second one loses about the time to cover two bodies
    ends = sorted(t.end for t in report.trajectories.values())
    assert ends[0] == pytest.approx(24.0, abs=0.01)
    assert 25.0 < ends[1] < 26.2


def test_four_crossings():
    motions = [
        motion("a", (0, 0, 0), (40, 0, 0)),
        motion("b", (20, -20, UP), (20, 20, UP)),
        motion("c", (23, -20, UP), (23, 20, UP)),
        motion("d", (26, 20, -UP), (26, -20, -UP)),
    ]
    judge(solve(Straight(), motions), motions)


def test_waits_with_a_running_start_for_what_leaves():
    motions = [motion("a", (0, 0, 0), (40, 0, 0))]
    rests = [Rest("x", CAR, (20.0, 0.0, 0.0), -math.inf, 30.0)]
    report = solve(Straight(), motions, rests)
    judge(report, motions, rests)
    # at 30 s it may pass x = 18 at full speed: 18 m at 2 m/s and 4 m of braking in 4 s
    assert report.trajectories["a"].end == pytest.approx(30 + 9 + 4, abs=0.3)


def test_what_rests_for_ever_blocks_for_ever():
    report = solve(
        Straight(), [motion("a", (0, 0, 0), (40, 0, 0))], [Rest("x", CAR, (20.0, 0.0, 0.0))]
    )
    assert report.outcome is Outcome.OUT_OF_TIME
    assert not report.trajectories
    assert report.conflict == {"a"}
    assert report.blockers == {"x"}


def test_it_need_not_avoid_what_is_not_named():
    a = motion("a", (0, 0, 0), (40, 0, 0), avoid=frozenset({"y"}))
    report = solve(Straight(), [a], [Rest("x", CAR, (20.0, 0.0, 0.0))])
    assert report.trajectories["a"].end == pytest.approx(24.0, abs=0.01)


def test_follow_the_leader():
    motions = [motion("a", (4, 0, 0), (44, 0, 0)), motion("b", (0, 0, 0), (40, 0, 0))]
    report = solve(Straight(), motions)
    judge(report, motions)
    assert max(t.end for t in report.trajectories.values()) == pytest.approx(24.0, abs=0.01)


def test_waits_until_a_goal_is_left():
    motions = [motion("a", (3, 0, 0), (15, 0, 0)), motion("b", (15, 0, 0), (26, 0, 0), 20)]
    report = solve(Straight(), motions)
    judge(report, motions)
    # braking behind an equally strong starter takes 4 s more: minimise x^2 + (4 - x)^2
    assert 24.0 <= report.trajectories["a"].end < 24.6


def test_the_same_object_drives_twice():
    motions = [
        TimedMotion("go", "A", CAR, ((0, 0, 0), (20, 0, 0)), 0.0, 5.0, present_until=10.0),
        TimedMotion("on", "A", CAR, ((20, 0, 0), (40, 0, 0)), 10.0, 40.0, present_from=10.0),
    ]
    report = solve(Straight(), motions)
    assert report.late == {"go": report.trajectories["go"].end}
    assert report.trajectories["on"].start >= report.trajectories["go"].end
    assert report.conflict == {"go"}


def test_a_robot_leaves_its_parking_place_for_another():
    service = MotionService(room(30, 6, [(1, 1, 29, 5)]))
    motions = [motion("a", (3, 3, 0), (15, 3, 0)), motion("b", (15, 3, 0), (26, 3, 0), 5)]
    report = solve(service, motions)
    judge(report, motions)
    assert report.trajectories["a"].end < 11.5


def test_a_swap_needs_the_pocket():
    service = MotionService(room(40, 8, [CORRIDOR, (8, 1, 11, 6.5)]))
    motions = [motion("a", (3, 2, 0), (37, 2, 0)), motion("b", (36.8, 2, math.pi), (3, 2, math.pi))]
    report = solve(service, motions)
    judge(report, motions)
    # one of them went into the pocket
    assert max(t.poses[:, 1].max() for t in report.trajectories.values()) > 3.5


def test_a_swap_where_the_first_must_wait_for_the_second_to_step_aside():
    service = MotionService(room(40, 8, [CORRIDOR, (19, 1, 22, 6.5)]))
    motions = [motion("a", (3, 2, 0), (37, 2, 0)), motion("b", (36.8, 2, math.pi), (3, 2, math.pi))]
    judge(solve(service, motions), motions)


def test_head_on_without_a_pocket_is_not_guessed():
    service = MotionService(room(14, 8, [(1, 1, 13, 3)]))
    motions = [motion("a", (3, 2, 0), (11, 2, 0)), motion("b", (11, 2, math.pi), (3, 2, math.pi))]
    report = solve(service, motions, seconds=40.0)
    assert report.outcome is Outcome.NOT_FOUND  # true, but nobody has proven it
    assert report.conflict == {"a", "b"}


@pytest.mark.parametrize("heading", [UP, -UP])
def test_two_exchange_places_in_a_ring(heading):
    ring = [(1, 1, 15, 3.4), (1, 12.6, 15, 15), (1, 1, 3.4, 15), (12.6, 1, 15, 15)]
    service = MotionService(room(16, 16, ring))
    left, right = (2.2, 8, heading), (13.8, 8, -heading)
    motions = [motion("a", left, right), motion("b", right, left)]
    judge(solve(service, motions), motions)


def test_one_cannot_be_reached_behind_a_wall():
    service = MotionService(room(20, 10, [(1, 1, 9, 9), (11, 1, 19, 9)]))
    report = solve(service, [motion("a", (3, 5, 0), (16, 5, 0))])
    assert report.outcome is Outcome.IMPOSSIBLE
    assert report.conflict == {"a"}


def test_passes_head_on_in_the_open_without_losing_time():
    service = MotionService(room(60, 12, [(1, 1, 59, 11)]))
    motions = [
        motion("a", (3, 6, 0), (57, 6, 0), 0, 32),
        motion("b", (57, 6, math.pi), (3, 6, math.pi), 0, 32),
    ]
    report = solve(service, motions)
    judge(report, motions)
    assert not report.late


def test_lateness_names_the_pair_that_conflicts():
    motions = [
        motion("a", (0, 0, 0), (40, 0, 0), 0, 24.01),
        motion("b", (20, -20, UP), (20, 20, UP), 0, 24.01),
        motion("c", (60, -20, UP), (60, 20, UP), 0, 24.01),
    ]
    report = solve(Straight(), motions)
    judge(report, motions)
    assert len(report.late) == 1
    assert report.conflict == {"a", "b"}


def test_same_seed_same_answer():
    motions = [
        motion("a", (3, 6, 0), (37, 6, 0)),
        motion("b", (37, 6, math.pi), (3, 6, math.pi)),
        motion("c", (20, 2.5, UP), (20, 9.5, UP)),
    ]
    found = [
        solve(MotionService(room(40, 12, [(1, 1, 39, 11)])), motions).trajectories for _ in "ab"
    ]
    for name in "abc":
        assert (found[0][name].times == found[1][name].times).all()
        assert (found[0][name].poses == found[1][name].poses).all()


LONG = (1, 1, 99, 3)
BAY = (49, 1, 52, 6.5)


def test_coupling_heeds_what_comes_by():
    service = MotionService(room(100, 8, [LONG, BAY]))
    motions = [
        motion("a", (3, 2, 0), (97, 2, 0)),
        motion("b", (96.8, 2, math.pi), (3, 2, math.pi)),
    ]
    alone = {m.name: sent(service, m) for m in motions}
    guest = Rest("guest", CAR, (70.0, 2.0, 0.0), -math.inf, 90.0)
    workspace = workspace_of(service)
    world = [rest_run(workspace, guest)]
    runs = couple(workspace, motions, alone, world, Deadline.after(60))
    assert runs is not None
    found = {name: run.timing.trajectory for name, run in runs.items()}
    report = GroupReport(Outcome.FOUND, found)
    judge(report, motions, [guest])
    assert min(t.end for t in found.values()) > 90.0


def sent(service, motion):
    workspace = workspace_of(service)
    path = workspace.path(motion.body, motion.poses, (), Deadline.after(60))
    return run_of(motion, path, natural_timing(path, motion.release))


def test_coupling_refuses_what_it_cannot_do():
    workspace = workspace_of(MotionService(room(40, 8, [CORRIDOR])))
    one = motion("a", (3, 2, 0), (37, 2, 0))
    assert couple(workspace, [one], {}, [], Deadline.after(60)) is None
    again = motion("b", (37, 2, 0), (3, 2, 0))
    same = TimedMotion("c", again.object, CAR, again.poses, 0.0, math.inf)
    assert couple(workspace, [again, same], {}, [], Deadline.after(60)) is None


def test_two_stops_a_hair_apart_cost_no_memory():
    # the levels of top speed over cells of half a micrometre would be millions
    edges = np.array([0.0, 0.5, 1.0, 1.0 + 5e-7, 1.0 + 1e-6, 1.5, 2.0])
    halt = np.array([True, False, True, False, True, False, True])
    head = np.arange(len(edges) + 1)
    safe = np.tile([0.0, np.inf], (len(edges) + 1, 1))
    tops, held = np.full(len(edges), 20.0), np.zeros(len(edges) - 1, dtype=bool)
    way = TunedPath(edges, halt, tops, held, halt | True)
    index, sets = reachable(way, DriveLimits(0.0, 20.0, 1.0), TimeSets(head, safe), 0.0, np.inf)
    assert len(index) <= 4 * len(edges) + 1
    last = (len(index) - 1) // len(edges) * (len(edges) - 1)
    arrival = sets[index[last], 0]
    ways = np.array([1.0, 1e-6, 1.0])
    assert arrival == pytest.approx(float(2 * np.sqrt(ways).sum()), abs=1e-3)


def random_way(rng):
    """Cells of any length, halts, slow stretches, and times at which others are there."""
    m = int(rng.integers(2, 14))
    edges = np.concatenate([[0.0], np.cumsum(np.exp(rng.uniform(-4, 0.5, m)))])
    halt = rng.random(m + 1) < 0.15
    halt[[0, -1]] = True
    tops = np.where(rng.random(m + 1) < 0.3, rng.uniform(0.1, 1.0, m + 1), 1.5)
    waits = halt | (rng.random(m + 1) < 0.8)
    sets = [np.cumsum(rng.uniform(0.2, 6.0, 2 * int(rng.integers(0, 3)))) for _ in range(m + 2)]
    free = [np.append(np.insert(times, 0, 0.0), math.inf).reshape(-1, 2) for times in sets]
    safe = TimeSets(np.cumsum([0, *map(len, free)]), np.concatenate(free))
    return TunedPath(edges, halt, tops, np.zeros(m, dtype=bool), waits), safe


LIMITS = DriveLimits(0.0, 1.5, 0.8)


def arrivals(way, safe, release, horizon):
    """Return when one may arrive (n, 2)."""
    reached = reachable(way, LIMITS, safe, release, horizon)
    width = (len(reached.head) - 1) // len(way.edges)
    first, last = reached.head[(len(way.edges) - 1) * width :][:2]
    return reached.intervals[first:last]


def test_whoever_has_to_come_by_some_time_comes_as_soon_as_without_it():
    rng, asked = np.random.default_rng(0), 0
    for _ in range(300):
        way, safe = random_way(rng)
        whole = arrivals(way, safe, 0.0, math.inf)[:, 0]
        for soonest in whole:
            in_between = arrivals(way, safe, 0.0, soonest + 1e-9)[:, 0]
            assert in_between == pytest.approx(whole[whole <= soonest + 1e-9])
            asked += 1
        assert not len(whole) or not len(arrivals(way, safe, 0.0, whole[0] - 1e-3))
    assert asked > 100


def test_who_is_told_to_come_too_late_does():
    rng = np.random.default_rng(1)
    found = dict.fromkeys(itertools.product((True, False), repeat=2), 0)
    for _ in range(2_000):
        way, safe = random_way(rng)
        release, goal_free, horizon = rng.uniform(0, 10, 3) * (1, 2, 3)
        goal_free = rng.choice([-math.inf, goal_free])
        horizon = rng.choice([horizon, math.inf])
        told = in_time(way, LIMITS, safe, release, goal_free, horizon)
        comes = (
            max(low, goal_free) <= horizon
            for low, high in arrivals(way, safe, release, horizon)
            if high >= goal_free
        )
        found[told, any(comes)] += 1
    assert found[False, True] == 0
    assert found[False, False] > found[True, False] > 0
    assert found[True, True] > 300
