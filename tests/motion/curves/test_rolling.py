"""Bodies that turn on the spot drive arcs: as the judge allows, no later than straight on, and no
sooner than any motion can.
"""

import math

import numpy as np
import pytest

from tests.motion.oracle import smallest_clearance
from tests.usual import usually
from up_samp.benchmarks.builders import warehouse
from up_samp.execution.travel import travel_of
from up_samp.geometry import OccupancyGrid, lay_out
from up_samp.model import (
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    PathQuery,
    Placed,
)
from up_samp.motion import MotionService
from up_samp.motion.curves.reeds_shepp import run_time
from up_samp.motion.curves.rolling import rolled, rolling_time, rows_of, thinned
from up_samp.motion.curves.trapezoid import timed_chain
from up_samp.motion.fleet.paths import path_of, safe_intervals
from up_samp.motion.fleet.speed import tune
from up_samp.motion.legs import parking_clears
from up_samp.motion.moves import drive, steer
from up_samp.motion.planners.car import PivotPlanner
from up_samp.motion.protocol import LegQuery
from up_samp.upio import read_problem
from up_samp.validation.kinematics import Limits, motion_violations

RING = ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3))


def kinematics(rng):
    v, a, omega = (float(x) for x in np.exp(rng.uniform(-1.5, 1.5, 3)))
    return Kinematics(MotionModel.PIVOT, 1.0, v, a, omega)


def refused(motion, kin):
    """Return what the independent judge has against a motion."""
    limits = Limits("r", "PIVOT", 0.0, kin.v_max, kin.v_max, kin.a_max, kin.omega_max)
    return list(motion_violations("m", limits, motion.times, motion.poses))


def drawn_rows(rng):
    """Return lines, arcs and turns on the spot, some of them tight or tiny."""
    rows = [np.array([0.0, 0.0, rng.uniform(-3, 3)])]
    for _ in range(rng.integers(1, 9)):
        if rng.random() < 0.3:
            rows.append(rows[-1] + np.array([0.0, 0.0, rng.uniform(-3, 3)]))
            continue
        bend = rng.choice([0.0, rng.uniform(-4, 4)])
        way = math.exp(rng.uniform(-5, 2)) * rng.choice([1, 1, -1])
        arcs = np.array([[bend, np.sign(way) * min(abs(way), 3.0 / max(abs(bend), 1e-3))]])
        rows += list(rows_of(rows[-1], arcs)[1:])
    return np.array(rows)


def test_drawn_drives_are_within_limits_and_no_slower_than_they_need_be():
    rng = np.random.default_rng(1)
    for _ in range(120):
        kin, rows = kinematics(rng), drawn_rows(rng)
        motion = rolled(rows, kin)
        assert not refused(motion, kin)
        assert motion.duration == pytest.approx(rolling_time(rows, kin), abs=1e-6)
        assert np.abs(motion.poses[[0, -1]] - rows[[0, -1]]).max() == 0.0
        again = thinned(motion.poses, kin)
        assert len(again) <= len(motion.poses)
        assert rolling_time(again, kin) == pytest.approx(motion.duration, abs=1e-5)


def test_lines_and_turns_alone_take_what_they_take_from_rest_to_rest():
    rng = np.random.default_rng(2)
    for _ in range(40):
        kin, rows = kinematics(rng), [np.zeros(3)]
        for _ in range(4):
            x, y, theta = rows[-1]
            theta += rng.uniform(0.2, 3.0)
            way = rng.uniform(0.1, 9.0)
            rows.append(np.array([x, y, theta]))
            rows.append(rows[-1] + np.array([way * math.cos(theta), way * math.sin(theta), 0.0]))
        rows = np.array(rows)
        assert rolled(rows, kin).duration == pytest.approx(timed_chain(rows, kin).duration)


def rooms(rng):
    """Return a room with walls, and blocks in it."""
    cells = np.zeros((70, 100), dtype=bool)
    cells[:2] = cells[-2:] = True
    cells[:, :2] = cells[:, -2:] = True
    for _ in range(rng.integers(1, 5)):
        r, c, h, w = rng.integers(5, 55), rng.integers(15, 75), *rng.integers(3, 22, 2)
        cells[r : r + h, c : c + w] = True
    return OccupancyGrid(cells, 0.1)


def free_pose(rng, service, body):
    while True:
        x, y, theta = rng.uniform(0.8, 9.2), rng.uniform(0.8, 6.2), rng.uniform(-3.1, 3.1)
        pose = (float(x), float(y), float(theta))
        if service.scene.pose_free(body, pose, (), 0.03):
            return pose


@pytest.mark.parametrize("seed", usually(0, 1, of=range(4)))
def test_plans_in_rooms_are_valid_no_later_than_straight_on_and_not_below_the_bound(seed):
    rng = np.random.default_rng(seed)
    found = sooner = 0
    while found < 6:
        body = Body(RING, kinematics(rng))
        service = MotionService(rooms(rng))
        ends = free_pose(rng, service, body), free_pose(rng, service, body)
        parked = Placed("parked", body, free_pose(rng, service, body))
        query = LegQuery(body, *ends, (parked,), effort=1500)
        motion = PivotPlanner(service.scene).leg(query, Deadline.never()).trajectory
        stops = drive(steer(body, *ends), body.kinematics)
        # within a margin and what a footprint's approximation adds to it
        if smallest_clearance(stops, body, service.grid, (parked,)) < 0.03:
            stops = None
        if motion is None:
            assert stops is None
            continue
        found += 1
        assert not refused(motion, body.kinematics)
        assert smallest_clearance(motion, body, service.grid, (parked,)) > -1e-6
        assert parking_clears(service.scene, motion, body, parked, 0.0)
        assert motion.poses[0].tolist() == list(ends[0])
        assert motion.poses[-1, :2].tolist() == list(ends[1][:2])
        assert motion.duration >= service.lower_bound(body, ends, (parked,)) - 1e-9
        assert stops is None or motion.duration <= stops.duration + 1e-9
        sooner += stops is None or motion.duration < 0.95 * stops.duration
    assert sooner > 0


def test_in_a_warehouse_it_is_nearly_as_fast_as_its_bound():
    problem = warehouse.warehouse(5, 10, encoding="compact")
    snapshot, grid = lay_out(read_problem(problem))
    kin = Kinematics(MotionModel.PIVOT, 1.0, warehouse.V_MAX, warehouse.A_MAX, warehouse.OMEGA_MAX)
    body, service = Body(warehouse.FOOTPRINT, kin), MotionService(grid)
    places = {}
    for item in problem.all_objects:
        if (pose := getattr(item, "configuration", None)) is not None:
            places[item.name] = (float(pose.x), float(pose.y), float(pose.theta))
    ways = [("dock0", "slot0"), ("slot0", "station0"), ("station0", "slot3"), ("dock1", "slot5")]
    for a, b in ways:
        query = PathQuery(body, (places[a], places[b]))
        took = service.plan(query, Deadline.never()).trajectory.duration
        assert took <= 1.1 * service.lower_bound(body, (places[a], places[b])), (a, b)
    assert snapshot is not None


def curved(kin):
    """Return a drive along lines, a wide arc, a tight one, and a turn on the spot."""
    wide, tight = 1.5 * kin.v_max / kin.omega_max, 0.4 * kin.v_max / kin.omega_max
    arcs = np.array([[0.0, 2.0], [1 / wide, wide], [0.0, 1.5], [-1 / tight, 1.4 * tight], [0.0, 2]])
    rows = rows_of(np.zeros(3), arcs)
    turned = rows[-1] + np.array([0.0, 0.0, 1.2])
    return rolled(np.concatenate([rows, turned[None]]), kin)


@pytest.mark.parametrize("seed", range(4))
def test_speeds_tuned_along_arcs_are_within_limits(seed):
    rng = np.random.default_rng(seed)
    body = Body(RING, kinematics(rng))
    motion = curved(body.kinematics)
    path = path_of(motion, body)
    assert path.tunable
    assert int(path.stop.sum()) == 3  # both ends, and where it begins to turn on the spot
    assert path.caps.min() == pytest.approx(0.4 * body.kinematics.v_max, rel=1e-5)
    for at in (0.3, 0.5, 0.7, 0.9):
        # it has to leave its start soon, and may not come by somewhere until later
        cell = int(at * path.cells)
        soon, later = 0.2 * motion.duration, 1.5 * motion.duration
        rows = np.array([[0.0, soon, math.inf], [float(cell), -math.inf, later]])
        timing = tune(path, safe_intervals(rows, path.cells), 0.0, -math.inf)
        assert timing is not None
        tuned = timing.trajectory
        assert tuned.start <= soon + 1e-6
        assert tuned.duration > motion.duration
        assert not refused(tuned, body.kinematics)
        between = np.interp(later - 1e-3, tuned.times, timing.s)
        assert between <= path.edges[cell - 1] + 1e-6


def test_the_simulator_heeds_tight_arcs():
    kin = Kinematics(MotionModel.PIVOT, 1.0, 1.5, 1.0, 1.5)
    path = path_of(curved(kin), Body(RING, kin))
    travel = travel_of(path)
    for s in np.linspace(0.0, path.length, 200):
        top = float(path.tops_within(np.array([s]), np.array([s + 1e-6]))[0])
        assert travel.cap_at(float(s)) <= top + 1e-9


def test_a_short_straight_drive_takes_as_long_as_for_a_car():
    kin = Kinematics(MotionModel.PIVOT, 1.0, 1.0, 1.0, 1.0)
    report = MotionService(None).plan(
        PathQuery(Body(RING, kin), ((0.0, 0.0, 0.0), (16.0, 0.0, 0.0))), Deadline.never()
    )
    assert report.trajectory.duration == pytest.approx(run_time(16.0, 1.0, 1.0))
