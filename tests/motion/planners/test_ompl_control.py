"""Bodies with their own equations of motion: exact ends, admissible controls, honest "no"."""

import math

import numpy as np
import pytest

from tests.motion.planners import ompl_oracle as oracle
from tests.motion.planners.asking import plan_with_ompl
from tests.motion.planners.ompl_oracle import CRATE, DOOR, FOOTPRINT, GOAL, START, unicycle
from tests.oracles.clocks import Watch
from tests.usual import usually
from up_samp.geometry import Scene
from up_samp.model import (
    Body,
    ControlLaw,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    ProblemError,
    UnsupportedError,
)
from up_samp.motion.planners.control import ControlPiece, Roller, Shot
from up_samp.validation.kinematics import Limits, motion_violations

PLANNERS = ("RRT", "KPIECE1", "EST")
SCENE = oracle.hall_scene()
WALLS = oracle.walls(SCENE.grid)


def drifting(q, u, qdot):
    """Slips sideways in bends; forwards only."""
    qdot[0] = u[0] * math.cos(q[2]) - 0.1 * u[1] * math.sin(q[2])
    qdot[1] = u[0] * math.sin(q[2]) + 0.1 * u[1] * math.cos(q[2])
    qdot[2] = u[1]


def holonomic(q, u, qdot):
    """Not for numba: it keeps its gains in a dictionary with values of several types."""
    gains = {"along": 1.0, "across": [0.8]}
    c, s = math.cos(q[2]), math.sin(q[2])
    ahead, side = gains["along"] * u[0], gains["across"][0] * u[1]
    qdot[:] = (c * ahead - s * side, s * ahead + c * side, u[2])


LAWS = {
    "unicycle": ControlLaw(unicycle, (("v", -0.5, 1.5), ("w", -1.0, 1.0))),
    "drifting": ControlLaw(drifting, (("v", 0.0, 1.5), ("w", -0.6, 1.0))),
    "holonomic": ControlLaw(holonomic, (("v", -1.0, 1.0), ("s", -1.0, 1.0), ("w", -1.0, 1.0))),
}


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    """Compile before anything is timed."""
    for law in LAWS.values():
        Roller(law)
    query = PathQuery(body_of(LAWS["unicycle"]), (START, (4.0, 3.0, 0.0)), (CRATE,))
    assert plan_with_ompl(SCENE, query, Deadline.after(240), planner="RRT").trajectory is not None


def body_of(law):
    return Body(FOOTPRINT, Kinematics(MotionModel.CONTROL, control=law))


def judged(law, trajectory):
    """What the independent validator finds wrong."""
    bounds = tuple((low, high) for _, low, high in law.bounds)
    limits = Limits("r", "CONTROL", 1.0, 1.0, 1.0, 1.0, 1.0, law.function, bounds)
    return list(motion_violations("r", limits, trajectory.times, trajectory.poses))


def ends_exactly(trajectory, poses):
    for pose, wanted in ((trajectory.poses[0], poses[0]), (trajectory.poses[-1], poses[-1])):
        assert tuple(pose[:2]) == wanted[:2]
        assert abs(math.remainder(pose[2] - wanted[2], 2 * math.pi)) < 1e-9


@pytest.mark.parametrize("law", usually("unicycle", of=("unicycle", "holonomic")))
def test_open_plane(law):
    poses = ((0.0, 0.0, 0.0), (6.0, 2.0, 1.0))
    query = PathQuery(body_of(LAWS[law]), poses)
    report = plan_with_ompl(Scene(None), query, Deadline.after(20), planner="RRT", seed=1)
    assert report.outcome is Outcome.FOUND
    ends_exactly(report.trajectory, poses)
    assert judged(LAWS[law], report.trajectory) == []
    limit = LAWS[law].bounds[0][2]
    assert report.trajectory.duration < 1.5 * math.hypot(6, 2) / limit


@pytest.mark.parametrize(
    ("law", "planner"),
    usually(
        ("unicycle", "RRT"),
        ("unicycle", "EST"),
        of=[("unicycle", "RRT"), ("drifting", "KPIECE1"), ("unicycle", "EST")],
    ),
)
def test_through_the_gap(law, planner):
    query = PathQuery(body_of(LAWS[law]), (START, GOAL), (CRATE,))
    reports = [
        plan_with_ompl(SCENE, query, Deadline.after(40), planner=planner, seed=2) for _ in range(2)
    ]
    assert reports[0].outcome is Outcome.FOUND
    trajectory = reports[0].trajectory
    assert np.array_equal(trajectory.poses, reports[1].trajectory.poses)
    ends_exactly(trajectory, query.poses)
    assert judged(LAWS[law], trajectory) == []
    world = WALLS.union(oracle.obstacles_of([CRATE]))
    assert oracle.clearance(query.body, trajectory.poses[::4], world) > 0


@pytest.mark.parametrize("planner", usually("KPIECE1", of=PLANNERS))
def test_closed_door(planner):
    query = PathQuery(body_of(LAWS["unicycle"]), (START, GOAL), (CRATE, DOOR))
    watch = Watch()
    report = plan_with_ompl(SCENE, query, Deadline.after(0.7), planner=planner)
    assert watch.late(0.7) < 1.0
    assert report.outcome is Outcome.OUT_OF_TIME
    assert report.reason


def test_sideways_into_a_slot():
    """Forwards only, a slot as wide as the body: parking sideways cannot be found."""
    occupied = np.zeros((60, 100), dtype=bool)
    occupied[:20] = True
    occupied[10:20, 40:53] = False
    from up_samp.geometry import OccupancyGrid

    scene = Scene(OccupancyGrid(occupied, 0.1))
    query = PathQuery(body_of(LAWS["drifting"]), ((2.0, 4.0, 0.0), (4.55, 1.5, 0.0)))
    report = plan_with_ompl(scene, query, Deadline.after(0.7), planner="RRT")
    assert report.outcome is Outcome.OUT_OF_TIME


def test_roller_agrees_with_the_exact_arc():
    roller = Roller(LAWS["unicycle"])
    rows = roller.rows((1.0, 2.0, 0.5), (1.2, 0.8), 2.0)
    assert len(rows) == 41
    radius, angle = 1.5, 0.5 + 1.6
    assert rows[-1] == pytest.approx(
        (
            1.0 + radius * (math.sin(angle) - math.sin(0.5)),
            2.0 - radius * (math.cos(angle) - math.cos(0.5)),
            angle,
        ),
        abs=1e-7,
    )
    assert roller.speed() == pytest.approx(1.5)


def test_compiled_and_called_laws_agree():
    def slow(q, u, qdot):
        _ = {"not": 1, "for": "numba"}
        unicycle(q, u, qdot)

    fast = Roller(LAWS["unicycle"])
    plain = Roller(ControlLaw(slow, LAWS["unicycle"].bounds))
    args = (0.1, 0.2, 0.3), (0.7, -0.4), 1.3
    assert np.allclose(fast.rows(*args), plain.rows(*args), atol=1e-12)


def test_shots_hit_or_say_no():
    roller = Roller(LAWS["unicycle"])
    goal = (2.0, 1.0, 0.5)
    shot = Shot(roller, (0.0, 0.0, 0.0), goal, 3.0, 4)
    guess = [ControlPiece((1.0, 0.1), 0.6)] * 4
    z = shot.restore(shot.pack(guess))
    assert z is not None
    pieces = shot.final(z)
    assert np.abs(roller.trajectory((0.0, 0.0, 0.0), pieces).poses[-1] - goal).max() < 1e-7
    quick = shot.final(shot.quicken(z, lambda _: True))
    assert sum(p.seconds for p in quick) <= sum(p.seconds for p in pieces) + 1e-6
    for piece in quick:
        for value, (_, low, high) in zip(piece.controls, LAWS["unicycle"].bounds, strict=True):
            assert low - 1e-12 <= value <= high + 1e-12
    hopeless = Shot(roller, (0.0, 0.0, 0.0), (50.0, 0.0, 0.0), 1.0, 2)
    assert hopeless.restore(hopeless.pack(guess[:2])) is None


def test_clear_errors():
    def five(q, u, qdot):
        qdot[4] = u[0]

    query = PathQuery(body_of(ControlLaw(five, (("v", -1.0, 1.0),))), (START, GOAL))
    with pytest.raises(UnsupportedError, match=r"\(x, y, theta\)"):
        plan_with_ompl(SCENE, query, Deadline.after(5), planner="RRT")

    def still(q, u, qdot):
        qdot[2] = u[0]

    query = PathQuery(body_of(ControlLaw(still, (("w", -1.0, 1.0),))), (START, GOAL))
    with pytest.raises(ProblemError, match="never moves"):
        plan_with_ompl(SCENE, query, Deadline.after(5), planner="RRT")
    query = PathQuery(body_of(LAWS["unicycle"]), (START, GOAL))
    with pytest.raises(ProblemError, match=r"control planner 'RRTConnect'.*RRT, KPIECE1, EST"):
        plan_with_ompl(SCENE, query, Deadline.after(5), planner="RRTConnect")
