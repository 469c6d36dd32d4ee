"""Free flyers with meshes: over walls, through windows, never through anything."""

import builtins
import math

import numpy as np
import pytest

from tests.motion.planners import ompl_oracle as oracle

pytest.importorskip("coal")
trimesh = pytest.importorskip("trimesh")

from tests.motion.planners.asking import plan_with_ompl  # noqa: E402
from up_samp.geometry import OccupancyGrid, Scene, meshes  # noqa: E402
from up_samp.model import (  # noqa: E402
    Body,
    Deadline,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    Placed,
    ProblemError,
    UnsupportedError,
    interpolate,
)
from up_samp.motion import MotionService  # noqa: E402

LIMITS = Kinematics(MotionModel.SE3, v_max=1.5, a_max=0.8, omega_max=0.7)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
QUARTER = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    brick = trimesh.creation.box((1.0, 0.4, 0.2))
    brick.export(folder / "brick.stl")
    # a wall of 6 m x 4 m with a window of 1 m x 1 m
    parts = [
        trimesh.creation.box((0.2, 2.5, 4.0), transform=shift(0, -1.75, 2.0)),
        trimesh.creation.box((0.2, 2.5, 4.0), transform=shift(0, 1.75, 2.0)),
        trimesh.creation.box((0.2, 1.0, 1.5), transform=shift(0, 0, 0.75)),
        trimesh.creation.box((0.2, 1.0, 1.5), transform=shift(0, 0, 3.25)),
    ]
    trimesh.util.concatenate(parts).export(folder / "wall.obj")
    return {n: Body((), LIMITS, str(folder / f)) for n, f in
            (("brick", "brick.stl"), ("wall", "wall.obj"))}  # fmt: skip


def shift(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = (x, y, z)
    return matrix


def sampled_clearance(body, trajectory, world):
    """The smallest distance from the body's own surface points to ``world``, densely sampled."""
    mesh = trimesh.load(body.mesh, force="mesh")
    points = np.concatenate([mesh.vertices, mesh.triangles_center])
    best = math.inf
    poses = trajectory.poses
    for i in range(0, len(poses) - 1, 3):
        pose = interpolate(poses[i], poses[i + 1], 0.5)
        moved = points @ meshes.rotation(pose[3:]).T + np.array(pose[:3])
        best = min(best, float(world(moved).min()))
    return best


def limits_hold(trajectory):
    dt = np.diff(trajectory.times)
    assert dt.max() <= 0.05 + 1e-9
    velocity = np.diff(trajectory.poses[:, :3], axis=0) / dt[:, None]
    assert np.linalg.norm(velocity, axis=1).max() <= LIMITS.v_max * 1.001
    q = trajectory.poses[:, 3:]
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 1e-9
    turn = 2 * np.arccos(np.abs(np.sum(q[1:] * q[:-1], axis=1)).clip(0, 1))
    assert (turn / dt).max() <= LIMITS.omega_max * 1.01 + 1e-5
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / ((dt[1:] + dt[:-1]) / 2)
    assert change.max() <= LIMITS.a_max * 1.01


def test_through_the_window_or_over_the_wall(bodies):
    wall = Placed("wall", bodies["wall"], (0.0, 0.0, 0.0, *UPRIGHT))
    query = PathQuery(
        bodies["brick"], ((-3.0, 0.0, 1.0, *UPRIGHT), (3.0, 0.0, 3.0, *QUARTER)), (wall,)
    )
    reports = [
        plan_with_ompl(Scene(None), query, Deadline.after(20), planner="RRTConnect", seed=4)
        for _ in range(2)
    ]
    assert reports[0].outcome is Outcome.FOUND
    trajectory = reports[0].trajectory
    assert np.array_equal(trajectory.poses, reports[1].trajectory.poses)
    assert tuple(trajectory.poses[0]) == query.poses[0]
    assert tuple(trajectory.poses[-1]) == query.poses[1]
    limits_hold(trajectory)

    def outside(points):
        """Distance to the solid wall (its window taken out), negative inside it."""
        slab = np.abs(points[:, 0]) - 0.1
        window = np.maximum(np.abs(points[:, 1]), np.abs(points[:, 2] - 2.0)) - 0.5
        frame = np.maximum(np.abs(points[:, 1]) - 3.0, np.abs(points[:, 2] - 2.0) - 2.0)
        return np.maximum(slab, np.maximum(frame, -window))

    assert sampled_clearance(bodies["brick"], trajectory, outside) > 0


def test_walls_of_a_map_reach_the_sky(bodies):
    scene = oracle.hall_scene()
    start, goal = (3.0, 3.0, 1.0, *UPRIGHT), (17.0, 9.0, 5.0, *QUARTER)
    query = PathQuery(bodies["brick"], (start, goal))
    report = plan_with_ompl(scene, query, Deadline.after(20), planner="RRTConnect", seed=1)
    assert report.outcome is Outcome.FOUND

    def free(points):
        row, col = (points[:, 1] / 0.1).astype(int), (points[:, 0] / 0.1).astype(int)
        return np.where(scene.grid.blocked[row, col], -1.0, 1.0)

    assert sampled_clearance(bodies["brick"], report.trajectory, free) > 0
    closed = oracle.hall_scene(gap=False)
    report = plan_with_ompl(closed, query, Deadline.after(0.5), planner="RRTConnect", seed=1)
    assert report.outcome is Outcome.OUT_OF_TIME


def test_planar_bodies_stand_in_the_way(bodies):
    query = PathQuery(
        bodies["brick"],
        ((3.0, 3.0, 1.0, *UPRIGHT), (17.0, 9.0, 5.0, *QUARTER)),
        (oracle.DOOR,),
    )
    scene = oracle.hall_scene()
    report = plan_with_ompl(scene, query, Deadline.after(0.5), planner="RRTConnect")
    assert report.outcome is Outcome.OUT_OF_TIME


def test_ends_inside_of_something(bodies):
    wall = Placed("big", bodies["brick"], (0.0, 0.0, 0.0, *UPRIGHT))
    query = PathQuery(
        bodies["brick"], ((0.1, 0.0, 0.0, *UPRIGHT), (3.0, 0.0, 0.0, *UPRIGHT)), (wall,)
    )
    report = plan_with_ompl(Scene(None), query, Deadline.after(5), planner="RRT")
    assert report.outcome is Outcome.NOT_FOUND
    assert "touches" in report.reason


def test_contains_and_distance():
    ball = trimesh.creation.icosphere(radius=0.2)
    box = trimesh.creation.box((1, 1, 1))
    small = meshes.make_mesh(ball.vertices, ball.faces)
    big = meshes.make_mesh(box.vertices, box.faces)
    assert meshes.contains(big, (0.1, 0.2, -0.3))
    assert not meshes.contains(big, (0.1, 0.2, -0.7))
    here = meshes.transform((0, 0, 0, *UPRIGHT))
    there = meshes.transform((2, 0, 0, *QUARTER))
    assert meshes.surface_distance(big, here, small, there) == pytest.approx(1.3, abs=5e-3)
    assert meshes.surface_distance(big, here, small, meshes.transform((0.5, 0, 0, *UPRIGHT))) == 0


def test_rectangles_cover_the_blocked_cells():
    rng = np.random.default_rng(3)
    occupied = rng.random((13, 17)) < 0.4
    grid = OccupancyGrid(occupied, 0.5, (2.0, -1.0, 0.3))
    import shapely

    rectangles = [shapely.Polygon(r) for r in meshes.wall_rectangles(grid)]
    assert all(r.exterior.is_ccw for r in rectangles)
    area = sum(r.area for r in rectangles)
    assert area == pytest.approx((occupied.sum() + 15 * 19 - 13 * 17) * 0.25)
    solid = shapely.union_all(rectangles)
    for row in range(13):
        for col in range(17):
            assert solid.contains(shapely.Point(grid.point_of(row, col))) == occupied[row, col]


def test_clear_errors(bodies, tmp_path, monkeypatch):
    broken = tmp_path / "broken.stl"
    broken.write_text("nothing")
    with pytest.raises(ProblemError, match="broken"):
        meshes.load_mesh(broken)
    with pytest.raises(ProblemError, match="not a file"):
        meshes.load_mesh(tmp_path / "missing.stl")
    query = PathQuery(Body((), LIMITS), ((0.0, 0.0, 0.0, *UPRIGHT), (3.0, 0.0, 0.0, *UPRIGHT)))
    with pytest.raises(ProblemError, match="geometric model"):
        plan_with_ompl(Scene(None), query, Deadline.after(5), planner="RRT")

    def without(name, *args, **kwargs):
        if name.startswith(("coal", "trimesh")):
            raise ImportError(name)
        return builtins.__import__(name, *args, **kwargs)

    meshes._library.cache_clear()
    monkeypatch.setattr(meshes.importlib, "import_module", without)
    with pytest.raises(UnsupportedError, match=r"pip install trimesh coal"):
        meshes.transform((0, 0, 0, *UPRIGHT))


def test_a_flyer_passes_waypoints_on_a_straight_way(bodies):
    body = bodies["brick"]
    turn = (0.0, 0.0, math.sin(0.4), math.cos(0.4))
    start, end = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), (12.0, 4.0, 3.0, *turn)
    inner = [interpolate(np.array(start), np.array(end), share) for share in (0.2, 0.25, 0.7)]
    service = MotionService(None)
    alone = service.plan(PathQuery(body, (start, end)), Deadline.after(20))
    through = service.plan(PathQuery(body, (start, *inner, end)), Deadline.after(20))
    assert through.trajectory.duration == pytest.approx(alone.trajectory.duration, rel=1e-9)
    assert through.complete
    for pose in inner:
        assert np.abs(through.trajectory.poses - np.array(pose)).max(axis=1).min() < 1e-9
    bent = (*inner[0][:2], inner[0][2] + 1.0, *inner[0][3:])
    stopping = service.plan(PathQuery(body, (start, bent, end)), Deadline.after(20))
    assert not stopping.complete, "it rests at the corner, though nobody asks for that"
