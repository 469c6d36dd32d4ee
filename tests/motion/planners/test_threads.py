"""Ways as thin as a hair, on which each motion that is known was drawn before the walls."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.motion.oracle import smallest_clearance
from tests.soundness.known_plans import SECONDS, KnownPlan
from tests.usual import usually
from up_samp.geometry.maps import load_map
from up_samp.model import Deadline, Outcome, PathQuery
from up_samp.motion.planners.car import CarPlanner, CarSettings, PivotPlanner
from up_samp.motion.planners.omni import PlanarPlanner
from up_samp.motion.protocol import LegQuery
from up_samp.motion.service import MotionService
from up_samp.upio import read_problem
from up_samp.validation.kinematics import limits_of, motion_violations

PLANNERS = {"car": CarPlanner, "differential": PivotPlanner, "omni": PlanarPlanner}


def drives(seed, folder):
    """Yield the drives of a world's known plan, its map, and the robots that drive them."""
    world = KnownPlan(seed, folder)
    grid = load_map(folder / f"known{seed}.yaml")
    snapshot = read_problem(world.problem, SECONDS)
    for number, drive in enumerate(world.drives):
        name = f"r{number}"
        ends = tuple(snapshot.configurations[f"{end}{number}"] for end in ("from", "to"))
        limits = limits_of(world.problem.object(name))
        yield world.kind, grid, snapshot.objects[name].body, ends, limits, drive


KNOWN = [*((seed, 1.1) for seed in (2, 5, 7, 8, 28, 31, 56)), (30, 1.3)]


@pytest.mark.parametrize(("seed", "most"), usually((8, 1.1), (56, 1.1), of=KNOWN))
def test_what_is_known_to_be_driven_is_found(seed, most, tmp_path):
    for kind, grid, body, ends, limits, known in drives(seed, tmp_path):
        service = MotionService(grid)
        planner = PLANNERS[kind](service.scene)
        motion = planner.leg(LegQuery(body, *ends), Deadline.never()).trajectory
        assert motion is not None
        assert motion.duration <= known.motion.duration * most
        assert motion.duration >= service.lower_bound(body, ends) - 1e-9
        assert not list(motion_violations("m", limits, motion.times, motion.poses))
        assert smallest_clearance(motion, body, grid, ()) > -1e-6
        for pose, end in zip(motion.poses[[0, -1]], ends, strict=True):
            assert np.allclose(pose[:2], end[:2], atol=1e-7)
            assert abs(math.remainder(pose[2] - end[2], 2 * math.pi)) < 1e-7


def test_the_finest_levels_are_for_what_few_states_are_left_of(tmp_path):
    """A level is left out where the one before had looked at much: it would not come to an end."""
    _, grid, body, ends, _, _ = next(drives(8, tmp_path))
    service, sought = MotionService(grid), []
    for few in (8, math.inf):
        leg = CarPlanner(service.scene, 0, CarSettings(few=few)).leg(
            LegQuery(body, *ends), Deadline.never()
        )
        sought.append(leg)
    assert [leg.trajectory is None for leg in sought] == [False, True]
    assert sought[1].complete  # asking again would give the same


def test_a_thread_is_planned_by_the_service_without_a_second_opinion(tmp_path):
    for kind, grid, body, ends, _, _ in drives(7, tmp_path):
        report = MotionService(grid).plan(PathQuery(body, ends), Deadline.after(60))
        assert report.outcome is Outcome.FOUND
        assert report.planner == {"car": "car", "differential": "pivot"}[kind]


@pytest.mark.parametrize(("seed", "number"), usually((7, 0), (8, 0), of=[(7, 0), (8, 0), (30, 2)]))
def test_a_quick_planner_gives_up_where_only_a_thread_leads(seed, number, tmp_path):
    kind, grid, body, ends, _, _ = [*drives(seed, tmp_path)][number]
    planner = PLANNERS[kind].quick(MotionService(grid).scene)
    leg = planner.leg(LegQuery(body, *ends), Deadline.never())
    assert leg.trajectory is None
    assert leg.effort <= 20_000


def farthest(motion, reach):
    """The largest speed and acceleration of what is ``reach`` m ahead, by finite differences."""
    heading = motion.poses[:, 2]
    there = motion.poses[:, :2] + reach * np.column_stack((np.cos(heading), np.sin(heading)))
    dt = np.diff(motion.times)
    speed = np.diff(there, axis=0) / dt[:, None]
    change = np.linalg.norm(np.diff(speed, axis=0), axis=1) / (0.5 * (dt[1:] + dt[:-1]))
    return np.linalg.norm(speed, axis=1).max(), change.max()


@pytest.mark.parametrize("reach", [pytest.param(0.0, marks=pytest.mark.long), 0.7])
def test_who_keeps_formation_is_planned_by_the_finer_searches_too(reach, tmp_path):
    """They may drive a body on wheels, which turns at once: nothing far off can follow that."""
    found = 0
    for seed in (4, 10, 24):
        for kind, grid, body, ends, _, _ in drives(seed, tmp_path):
            if kind != "omni":
                continue
            own = body.kinematics
            limits = replace(own, drives_along=True, reach=reach, omega_max=0.6)
            leg = PlanarPlanner(MotionService(grid).scene).leg(
                LegQuery(replace(body, kinematics=limits), *ends), Deadline.after(20)
            )
            if leg.trajectory is not None and reach:
                speed, change = farthest(leg.trajectory, reach)
                assert speed <= 1.01 * own.v_max
                assert change <= 1.02 * (own.a_max + 0.6**2 * reach)
            found += leg.trajectory is not None
    assert found > 0
