"""Swept checks and kinematics against plain, dense sampling; and how long a large plan takes."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.oracles.clocks import Watch
from tests.validation.validation_kit import A, R, V, World, drive, hall, write_map
from up_samp.model import Trajectory
from up_samp.validation.collisions import (
    BlockedMap,
    JudgedShape,
    Track,
    hits_body,
    hits_map,
    placed,
)
from up_samp.validation.kinematics import Limits, motion_violations
from up_samp.validation.plan import validate_plan

LIMITS = Limits("r", "REEDSSHEPP", R, V, V, A, 1.0)
CORNERS = np.array([(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)])
DOT = np.array([(-0.1, -0.1), (0.1, -0.1), (0.0, 0.1)])
CAR = JudgedShape("car", CORNERS)
# concave: a fork whose prongs point forwards
FORK = JudgedShape(
    "fork",
    np.array(
        [(-1, -1), (1, -1), (1, -0.6), (-0.6, -0.6), (-0.6, 0.6), (1, 0.6), (1, 1), (-1, 1)],
        dtype=float,
    ),
)

segments = st.lists(
    st.tuples(
        st.floats(0.2, 6.0) | st.floats(-6.0, -0.2), st.sampled_from([-1.0, -0.4, 0.0, 0.7, 1.0])
    ),
    min_size=1,
    max_size=5,
)
poses = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-math.pi, math.pi))


def track(trajectory, shape=CAR):
    return Track(trajectory.times, trajectory.poses, shape.radius)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(poses, segments, st.sampled_from([0.03, 0.05, 0.1]))
def test_sound_drives_are_accepted(start, way, step):
    trajectory = drive(start, way, step=step)
    assert list(motion_violations("m", LIMITS, trajectory.times, trajectory.poses)) == []


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    poses,
    segments,
    st.sampled_from([0.05, 0.4, 2.0]),
    st.tuples(st.floats(-2.0, 30.0), st.floats(0.0, 12.0)),
)
def test_a_track_stays_in_its_box(start, way, step, window):
    driven = track(drive(start, way, step=step))
    low, high = window[0], window[0] + window[1]
    corners = driven.box(low, high)
    points = driven.poses_at(np.linspace(low, high, 300))[:, :2]
    assert (points >= corners[0] - 1e-9).all()
    assert (points <= corners[1] + 1e-9).all()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    poses,
    segments,
    st.sampled_from([(1.03, "speed"), (1.03, "acceleration"), (1.03, "radius")]),
)
def test_drives_beyond_a_limit_are_rejected(start, way, planted):
    by, which = planted
    assume(max(abs(s) for s, _ in way) > V * V / A or which != "speed")
    assume(any(abs(k) == 1.0 for _, k in way) or which != "radius")
    # scaling all lengths scales speed, acceleration and turning radius; the limits follow but one
    v, a, r = V / by, A / by, R * by
    limits = {
        "speed": Limits("r", "REEDSSHEPP", R, v, v, A, 1.0),
        "acceleration": Limits("r", "REEDSSHEPP", R, V, V, a, 1.0),
        "radius": Limits("r", "REEDSSHEPP", r, V, V, A, 1.0),
    }[which]
    trajectory = drive(start, way)
    found = {v.kind for v in motion_violations("m", limits, trajectory.times, trajectory.poses)}
    expected = {"speed": "speed", "acceleration": "acceleration", "radius": "curvature"}[which]
    assert expected in found


@settings(max_examples=40, deadline=None, derandomize=True)
@given(poses, segments, st.floats(0, 1), st.floats(0, 1))
def test_travel_bounds_the_way_of_every_corner(start, way, one, two):
    trajectory = drive(start, way)
    t = track(trajectory)
    a, b = sorted((one * trajectory.end, two * trajectory.end))
    before, after = placed(CORNERS, t.poses_at(np.array([a, b])))
    moved = np.linalg.norm(after - before, axis=1)
    assert moved.max() <= t.travel(np.array([a]), np.array([b]))[0] + 1e-9
    assert np.allclose(t.pose(a)[:2], trajectory.at(a)[:2], atol=1e-9)


def smallest_gap(shape, mine, other, theirs, end, step=0.004):
    times = np.arange(0, end + step, step)
    one = shapely.polygons(placed(shape.corners, mine.poses_at(times)))
    two = shapely.polygons(placed(other.corners, theirs.poses_at(times)))
    return float(shapely.distance(one, two).min())


@settings(max_examples=40, deadline=None, derandomize=True)
@given(poses, segments, poses, segments, st.sampled_from([CAR, FORK]))
def test_two_bodies_like_dense_sampling(start, way, other_start, other_way, shape):
    mine, theirs = drive(start, way), drive(other_start, other_way, 0.5)
    end = min(max(mine.end, theirs.end), 8.0)
    found = hits_body(shape, track(mine, shape), CAR, track(theirs), 0.0, end)
    gap = smallest_gap(shape, track(mine, shape), CAR, track(theirs), end)
    # between two samples of the oracle both move by at most 2 m/s * (1 + 1.2 / R) * 0.004 s
    assert (found is not None) or gap > 0
    assert (found is None) or gap < 0.05
    if found is not None:
        at = np.array([found])
        one = shapely.polygons(placed(shape.corners, track(mine, shape).poses_at(at)))
        two = shapely.polygons(placed(CORNERS, track(theirs).poses_at(at)))
        assert shapely.intersects(one, two).all()


@pytest.fixture(scope="module")
def cluttered(tmp_path_factory):
    rng = np.random.default_rng(5)
    cells = np.zeros((160, 160), dtype=int)
    for x, y in rng.integers(0, 158, size=(40, 2)):
        cells[y : y + rng.integers(1, 4), x : x + rng.integers(1, 4)] = 1 + rng.integers(0, 2)
    file = write_map(tmp_path_factory.mktemp("map"), cells, origin=(-8.0, -8.0, 0.0))
    boxes = [
        shapely.box(-8 + x / 10, -8 + y / 10, -7.9 + x / 10, -7.9 + y / 10)
        for y, x in np.argwhere(cells)
    ]
    inside = shapely.box(-8, -8, 8, 8)
    return BlockedMap(file), shapely.union_all(boxes), inside


@settings(max_examples=40, deadline=None, derandomize=True)
@given(poses, segments)
def test_map_like_dense_sampling(cluttered, start, way):
    blocked, walls, inside = cluttered
    trajectory = drive(start, way)
    t = track(trajectory)
    found = hits_map(CAR, t, blocked, 0.0, trajectory.end)
    times = np.arange(0, trajectory.end, 0.01)
    bodies = shapely.polygons(placed(CAR.thin, t.poses_at(times)))
    hit = shapely.intersects(bodies, walls).any() or not shapely.covers(inside, bodies).all()
    near = (shapely.distance(bodies, walls) < 0.05).any() or not shapely.covers(
        inside.buffer(-0.05), bodies
    ).all()
    assert (found is not None) or not hit
    assert (found is None) or near


def test_rectangles_cover_exactly_the_blocked_cells(cluttered):
    blocked, walls, _ = cluttered
    boxes = [g for g in blocked._tree.geometries if g.area < 1e4]
    assert math.isclose(sum(g.area for g in boxes), walls.area, rel_tol=1e-9)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_map_modes(tmp_path, mode):
    """One row of pixels; what is not free is blocked."""
    from PIL import Image

    levels = np.array([[0, 50, 90, 150, 205, 240, 255]], dtype=np.uint8)
    Image.fromarray(levels).save(tmp_path / "m.pgm")
    (tmp_path / "m.yaml").write_text(
        "image: m.pgm\nresolution: 1.0\norigin: [0, 0]\nnegate: 0\noccupied_thresh: 0.65\n"
        f"free_thresh: 0.196\nmode: {mode}\n"
    )
    blocked = BlockedMap(tmp_path / "m.yaml")
    free = (blocked.distances(DOT + [[[x + 0.5, 0.5]] for x in range(7)]) > 0).tolist()
    expected = [True] + [False] * 6 if mode == "raw" else [False] * 5 + [True] * 2
    assert free == expected


def test_transparent_pixels_are_blocked(tmp_path):
    from PIL import Image

    pixels = np.full((2, 2, 4), 255, dtype=np.uint8)
    pixels[0, 1, 3] = 0  # the upper right one
    Image.fromarray(pixels).save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text("image: m.png\nresolution: 1.0\n")
    blocked = BlockedMap(tmp_path / "m.yaml")
    centres = [[[x + 0.5, y + 0.5]] for x in (0, 1) for y in (0, 1)]
    assert (blocked.distances(DOT + centres) == 0).tolist() == [False, False, False, True]


def test_ten_robots_sixty_motions(tmp_path):
    """Each of ten robots goes to and fro six times within 300 s."""
    cells = np.zeros((400, 600), dtype=int)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[216:222, 100:500:20] = 1
    w = World(tmp_path, cells)
    for k in range(10):
        y = 3.0 + 1.5 * k + (4 if k > 4 else 0)
        w.object(f"r{k}", (4.0, y, 0.0))
        for n in range(6):
            begin = 49.0 * n
            there = (4.0, y, 0.0) if n % 2 == 0 else (54.0, y, 0.0)
            sign = 1 if n % 2 == 0 else -1
            way = [(sign * 20.0, 0.0), (sign * 30.0, 0.0)]
            w.move(f"m{k}_{n}", f"r{k}", drive(there, way, begin), int(begin), int(begin) + 40)
    watch = Watch()
    verdict = validate_plan(w.problem, w.plan(), w.trajectories)
    assert verdict.valid
    assert watch.late(0.0) < 30  # a few seconds on an idle machine
    # and one robot a little out of its lane is found
    w.trajectories["m3_2"] = Trajectory(
        w.trajectories["m3_2"].times, np.add(w.trajectories["m3_2"].poses, [0.0, 0.6, 0.0])
    )
    found = {v.kind for v in validate_plan(w.problem, w.plan(), w.trajectories).violations}
    assert {"collision", "continuity", "start", "goal"} <= found


def test_hall_has_its_wall(tmp_path):
    blocked = BlockedMap(write_map(tmp_path, hall()))
    bodies = placed(CORNERS, np.array([(20.0, 10.0, 0.0), (20.0, 12.0, 0.0)]))
    assert (blocked.distances(bodies) > 1.4).tolist() == [True, False]
    assert blocked.distances(bodies)[1] == 0
