"""Free flyers in the validator: planted crashes, and distances against coal."""

import itertools
import math

import numpy as np
import pytest
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
from unified_planning.plans import MotionSchedule
from unified_planning.shortcuts import (
    ConfigurationType,
    MinimizeMakespan,
    MovableType,
)

trimesh = pytest.importorskip("trimesh")

from tests.validation.validation_kit import hall, kinds, write_map  # noqa: E402
from up_samp.geometry import load_map  # noqa: E402
from up_samp.model import (  # noqa: E402
    Deadline,
    PathQuery,
    Placed,
    ProblemError,
    Trajectory,
    UnsupportedError,
)
from up_samp.motion import MotionService  # noqa: E402
from up_samp.upio import read_problem  # noqa: E402
from up_samp.validation import validate_plan  # noqa: E402
from up_samp.validation.se3 import (  # noqa: E402
    Solid,
    SpaceTrack,
    inside,
    mesh_distance,
    triangle_distances,
)

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
QUARTER = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))


class Sky:
    """A hall with a wall at x = 20 m but for y in [8, 12], and a brick that flies."""

    def __init__(self, folder, size=(1.0, 0.4, 0.2)):
        self.folder = folder
        self.problem = SchedulingMotionProblem("sky")
        area = OccupancyMap(str(write_map(folder, hall())), (0, 0))
        self.space = ConfigurationType("space", area, ConfigurationKind.SE3)
        self.plane = ConfigurationType("plane", area, ConfigurationKind.SE2)
        self.kind = MovableType("thing")
        self.count = itertools.count()
        self.times, self.trajectories = {}, {}
        self.flyer = self.solid("brick", trimesh.creation.box(size))
        self.problem.add_quality_metric(MinimizeMakespan())

    def solid(self, name, mesh, pose=None):
        file = self.folder / f"{name}.stl"
        mesh.export(file)
        item = MovableObject(
            name,
            self.kind,
            geometric_model=str(file),
            motion_model=MotionModels.SE3,
            motion_parameters={"v_max": 2.0, "a_max": 1.0, "omega_max": 1.0},
        )
        return self._put(item, pose)

    def flat(self, name, corners, pose):
        item = MovableObject(name, self.kind, footprint=corners, motion_model=MotionModels.SE2)
        return self._put(item, pose)

    def _put(self, item, pose):
        self.problem.add_object(item)
        if pose is not None:
            self.problem.set_initial_configuration(item, self.place(pose))
        return item

    def place(self, pose):
        kind, value = (self.plane, SE2) if len(pose) == 3 else (self.space, SE3)
        name = f"q{next(self.count)}"
        item = ConfigurationObject(name, kind, value(*map(float, pose)))
        self.problem.add_object(item)
        return item

    def fly(self, start, goal, item=None, name="fly", seconds=20.0, since=0, **options):
        """A straight flight from rest to rest, sampled every 0.05 s."""
        item = item or self.flyer
        here, there = self.place(start), self.place(goal)
        self.problem.set_initial_configuration(item, here)
        activity = self.problem.add_motion_activity(name)
        activity.set_duration_bounds(0, 1000)
        activity.add_motion_constraint(ActivityWaypoints(item, here, [there], **options))
        times = np.linspace(0, seconds, round(20 * seconds) + 1)
        share = times / seconds
        share = share**3 * (10 - 15 * share + 6 * share**2)
        track = SpaceTrack(np.array([0.0, 1.0]), np.array([start, goal]), 0.0)
        self.trajectories[name] = Trajectory(times + since, track.poses_at(share))
        self.times[name] = (since, since + math.ceil(seconds))

    def judge(self, **options):
        assignment = {}
        activities = list(self.problem.activities)
        for a in activities:
            assignment[a.start], assignment[a.end] = self.times[a.name]
        plan = MotionSchedule(activities, assignment, {})
        return validate_plan(self.problem, plan, self.trajectories, **options)


@pytest.fixture
def sky(tmp_path):
    return Sky(tmp_path)


def test_a_clear_flight_is_valid(sky):
    sky.fly((10, 10, 1, *UPRIGHT), (28, 10.5, 3, *QUARTER))
    assert sky.judge().violations == ()


def test_walls_of_the_map_reach_the_sky(sky):
    sky.fly((10, 5, 50, *UPRIGHT), (30, 5, 53, *UPRIGHT))
    assert kinds(sky.judge()) == ["map-collision"]


@pytest.mark.parametrize(("height", "meets"), [(1.25, True), (1.31, False)])
def test_a_brick_over_a_crate(sky, height, meets):
    sky.solid("crate", trimesh.creation.box((1, 1, 1)), (10, 10, 0.7, *UPRIGHT))
    sky.fly((5, 10, height, *UPRIGHT), (15, 10, height, *UPRIGHT))
    assert kinds(sky.judge()) == (["collision"] if meets else [])


def test_nothing_slips_through_between_samples(sky):
    sheet = 10.0235
    sky.solid("sheet", trimesh.creation.box((0.001, 3, 3)), (sheet, 10, 1, *UPRIGHT))
    dart = sky.solid("dart", trimesh.creation.box((0.02, 0.02, 0.02)))
    sky.fly((5, 10, 1, *UPRIGHT), (15, 10, 1, *UPRIGHT), dart)
    gaps = np.abs(sky.trajectories["fly"].poses[:, 0] - sheet)
    assert gaps.min() > 0.0105  # no sample touches it
    assert kinds(sky.judge()) == ["collision"]


@pytest.mark.parametrize(("goal", "meets"), [(QUARTER, True), (UPRIGHT, False)])
def test_the_turn_counts(sky, goal, meets):
    sky.solid("post", trimesh.creation.box((0.1, 0.1, 4)), (10, 10.4, 1, *UPRIGHT))
    sky.fly((10, 10, 1, *UPRIGHT), (10, 10, 1, *goal))
    assert kinds(sky.judge()) == (["collision"] if meets else [])


def test_a_window_can_be_flown_through(sky):
    bars = [((0.2, 3, 1), (0, 0, 2)), ((0.2, 3, 1), (0, 0, 0)), ((0.2, 1, 1), (0, 1, 1)),
            ((0.2, 1, 1), (0, -1, 1))]  # fmt: skip
    parts = []
    for size, shift in bars:
        part = trimesh.creation.box(size)
        part.apply_translation(shift)
        parts.append(part)
    sky.solid("frame", trimesh.util.concatenate(parts), (10, 10, 0, *UPRIGHT))
    sky.fly((5, 10, 1, *UPRIGHT), (15, 10, 1, *UPRIGHT))
    assert sky.judge().valid
    poses = sky.trajectories["fly"].poses.copy()
    poses[:, 1] += 0.4 * np.exp(-((poses[:, 0] - 10) ** 2))  # a bend, into the bar
    sky.trajectories["fly"] = Trajectory(sky.trajectories["fly"].times, poses)
    assert kinds(sky.judge()) == ["collision"]


def test_inside_of_a_closed_body(sky):
    sky.solid("shell", trimesh.creation.box((8, 8, 8)), (10, 10, 1, *UPRIGHT))
    sky.fly((9, 10, 1, *UPRIGHT), (11, 10, 1, *UPRIGHT))
    assert kinds(sky.judge()) == ["collision"]


def test_planar_bodies_stand_from_floor_to_sky(sky):
    door = [(-0.1, -2.0), (0.1, -2.0), (0.1, 2.0), (-0.1, 2.0)]
    sky.flat("door", door, (20, 10, 0))
    sky.fly((10, 10, 9, *UPRIGHT), (28, 10, 9, *UPRIGHT))
    assert kinds(sky.judge()) == ["collision"]


def test_two_flyers_meet_in_the_air(sky):
    other = sky.solid("other", trimesh.creation.box((1.0, 0.4, 0.2)))
    sky.fly((5, 10, 1, *UPRIGHT), (15, 10, 1, *UPRIGHT))
    sky.fly((15, 10, 1, *UPRIGHT), (5, 10, 1, *UPRIGHT), other, "back")
    assert kinds(sky.judge()) == ["collision"]
    below = sky.trajectories["back"].poses.copy()
    below[:, 2] -= 0.25 * np.sin(np.linspace(0, math.pi, len(below))) ** 2
    sky.trajectories["back"] = Trajectory(sky.trajectories["back"].times, below)
    assert sky.judge().valid


def test_a_flyer_too_fast_is_told(sky):
    sky.fly((5, 10, 1, *UPRIGHT), (15, 10, 1, *UPRIGHT), seconds=5)
    assert kinds(sky.judge()) == ["acceleration", "speed"]


def test_missing_and_broken_models_are_named(tmp_path):
    sky = Sky(tmp_path)
    sky.fly((5, 10, 1, *UPRIGHT), (15, 10, 1, *UPRIGHT))
    (tmp_path / "brick.stl").write_text("nothing")
    with pytest.raises(ProblemError, match="brick"):
        sky.judge()
    (tmp_path / "brick.stl").unlink()
    with pytest.raises(ProblemError, match="brick"):
        sky.judge()
    bare = MovableObject("bare", sky.kind, footprint=[(0, 0), (1, 0), (0, 1)],
                         motion_model=MotionModels.SE3)  # fmt: skip
    sky.problem.add_object(bare)
    trimesh.creation.box().export(tmp_path / "brick.stl")
    with pytest.raises(UnsupportedError, match="bare"):
        sky.judge()


def test_distances_agree_with_samples_and_with_coal():
    rng = np.random.default_rng(5)
    p, q = rng.normal(size=(200, 3, 3)), rng.normal(size=(200, 3, 3)) + 1.0
    shares = np.concatenate([rng.dirichlet((1, 1, 1), size=300), np.eye(3)])
    exact = triangle_distances(p, q)
    for a, b, d in zip(p, q, exact, strict=True):
        sampled = np.linalg.norm((shares @ a)[:, None] - (shares @ b)[None], axis=-1).min()
        assert d <= sampled + 1e-12
        assert sampled - d < 0.3
    coal = pytest.importorskip("coal")
    assert coal is not None
    from up_samp.geometry import meshes

    ring, box = trimesh.creation.torus(1.0, 0.3, 12, 8), trimesh.creation.box((0.5, 0.4, 0.3))
    mine = [Solid("", np.array(m.triangles), True) for m in (ring, box)]
    theirs = [meshes.make_mesh(m.vertices, m.faces) for m in (ring, box)]
    for _ in range(40):
        poses = [np.concatenate([0.8 * rng.normal(size=3), rng.normal(size=4)]) for _ in "ab"]
        d = mesh_distance(mine[0], poses[0], mine[1], poses[1])
        places = [meshes.transform(pose) for pose in poses]
        told = meshes.surface_distance(theirs[0], places[0], theirs[1], places[1])
        assert d == pytest.approx(told, abs=1e-9)
        point = rng.normal(size=(1, 3))
        around = poses[0].copy()
        local = meshes.rotation(around[3:]).T @ (point[0] - around[:3])
        assert inside(mine[0], around, point) == meshes.contains(theirs[0], local)


def test_plans_of_the_flying_planner_are_accepted(tmp_path):
    pytest.importorskip("coal")
    sky = Sky(tmp_path)
    sky.solid("crate", trimesh.creation.box((1, 3, 3)), (12, 10, 1, *UPRIGHT))
    sky.fly((5, 10, 1, *UPRIGHT), (18, 10, 1, *QUARTER))
    assert kinds(sky.judge()) == ["collision"]
    snapshot = read_problem(sky.problem)
    bodies = {name: item.body for name, item in snapshot.objects.items()}
    crate = Placed("crate", bodies["crate"], (12.0, 10.0, 1.0, *UPRIGHT))
    ends = (5.0, 10.0, 1.0, *UPRIGHT), (18.0, 10.0, 1.0, *QUARTER)
    service = MotionService(load_map(snapshot.map_file))
    report = service.plan(PathQuery(bodies["brick"], ends, (crate,)), Deadline.after(30))
    assert report.trajectory is not None, report.reason
    sky.trajectories["fly"] = report.trajectory
    sky.times["fly"] = (0, math.ceil(report.trajectory.end))
    assert sky.judge().violations == ()
