"""The compiled checks against a naive oracle (shapely)."""

import math

import numpy as np
import pytest
import shapely
from shapely import affinity

from tests.motion.oracle import shape_at
from tests.usual import usually
from up_samp.geometry import OccupancyGrid, Scene, shape_of
from up_samp.geometry import kernels as k
from up_samp.geometry.kernels import arc_free, path_free, samples_free
from up_samp.model import Body, Kinematics, MotionModel, Placed, ProblemError

KIN = Kinematics(MotionModel.REEDSSHEPP)
FOOTPRINTS = {
    "car": ((-1, -0.5), (1, -0.5), (1, 0.5), (-1, 0.5)),
    "rear axle, clockwise": ((-0.2, 0.4), (1.4, 0.4), (1.4, -0.4), (-0.2, -0.4)),
    "triangle": ((-0.4, -0.3), (0.7, 0.0), (-0.4, 0.5)),
    "L": ((-0.5, -0.5), (0.9, -0.5), (0.9, 0.0), (0.0, 0.0), (0.0, 0.8), (-0.5, 0.8)),
    "U": ((0, 0), (2, 0), (2, 1.5), (1.5, 1.5), (1.5, 0.5), (0.5, 0.5), (0.5, 1.5), (0, 1.5)),
}
TOLERANCE = 1e-6


def body(name):
    return Body(FOOTPRINTS[name], KIN)


def cluttered(rng, origin=(0.0, 0.0, 0.0), density=0.01):
    return OccupancyGrid(rng.random((60, 80)) < density, 0.25, origin)


def walls_of(grid):
    """Return the blocked area, including all around the map, as one polygon in the world frame."""
    size = grid.resolution
    rows, cols = np.nonzero(grid.blocked)
    cells = [
        shapely.box(c * size, r * size, (c + 1) * size, (r + 1) * size)
        for r, c in zip(rows, cols, strict=True)
    ]
    width, height = grid.size
    around = shapely.box(-50, -50, width + 50, height + 50) - shapely.box(0, 0, width, height)
    area = shapely.union_all([*cells, around])
    area = affinity.rotate(area, grid.origin[2], origin=(0, 0), use_radians=True)
    area = affinity.translate(area, *grid.origin[:2])
    shapely.prepare(area)
    return area


def random_poses(rng, grid, n):
    width, height = grid.size
    local = np.column_stack([rng.uniform(-1, width + 1, n), rng.uniform(-1, height + 1, n)])
    c, s = math.cos(grid.origin[2]), math.sin(grid.origin[2])
    x = grid.origin[0] + c * local[:, 0] - s * local[:, 1]
    y = grid.origin[1] + s * local[:, 0] + c * local[:, 1]
    return np.column_stack([x, y, rng.uniform(-4, 4, n)])


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-3.0, 7.0, 0.7)])
def test_poses_against_the_map(name, origin):
    rng = np.random.default_rng(len(name))
    grid = cluttered(rng, origin)
    area, scene = walls_of(grid), Scene(grid)
    footprint = FOOTPRINTS[name]
    bare = shape_of(body(name)).data
    margined = shape_of(body(name), 0.1).data
    bare, margined = (k.WorldData(scene.data, scene.polys(), s) for s in (bare, margined))
    free_count = 0
    for x, y, th in random_poses(rng, grid, 400):
        shape = shape_at(footprint, (x, y, th))
        free = k.clearance(bare, x, y, th) >= 0.0
        deep = area.intersection(shape).area > 1e-5
        assert not (free and deep)
        if not free:
            assert area.intersects(shape)
        free_count += free
        distance = area.distance(shape)
        if k.clearance(margined, x, y, th) >= 0.0:
            assert distance >= 0.1 - TOLERANCE
        else:  # mitred corners exceed the margin by at most 8.3 %
            assert distance <= 0.1 * 1.083 + TOLERANCE
        # the bound on the clearance is a bound
        clearance = k.clearance(margined, x, y, th)
        if clearance >= 0:
            assert distance >= 0.1 + clearance - TOLERANCE
    assert 20 < free_count < 380


@pytest.mark.parametrize("name", usually("car", of=("car", "L", "rear axle, clockwise")))
def test_edges_against_the_map(name):
    """What is called free is free all the way; what is refused comes close to something."""
    rng = np.random.default_rng(7)
    grid = cluttered(rng, density=0.004)
    area, scene = walls_of(grid), Scene(grid)
    footprint, margin = FOOTPRINTS[name], 0.02
    shape = shape_of(body(name), margin).data
    world = k.WorldData(scene.data, scene.polys(), shape)
    seen = {True: 0, False: 0}
    for x, y, th in random_poses(rng, grid, 250):
        kappa = float(rng.choice([0.0, 1.0, -1.0, 0.3]))
        length = float(rng.uniform(-3, 3))
        free = arc_free(world, x, y, th, kappa, length)
        poses = [k.advance(x, y, th, kappa, length * i / 60) for i in range(61)]
        nearest = min(area.distance(shape_at(footprint, pose)) for pose in poses)
        seen[free] += 1
        if free:
            assert nearest >= margin - TOLERANCE
        else:  # the least slack of 0.02, mitred, and the spacing of the oracle's own samples
            assert nearest <= (margin + shape.slack[2]) * 1.083 + 0.05
        arcs = np.array([[kappa, length / 2], [kappa, length / 2]])
        whole = path_free(world, np.array([x, y, th]), arcs)
        assert (whole < 0) == free or nearest <= (margin + shape.slack[2]) * 1.083 + 0.05
    assert min(seen.values()) > 25


def test_distances_between_bodies():
    rng = np.random.default_rng(3)
    scene = Scene(None)
    names = list(FOOTPRINTS)
    for _ in range(800):
        a, b = rng.choice(names, 2)
        pose_a = tuple(rng.uniform(-2, 2, 3))
        pose_b = tuple(rng.uniform(-2, 2, 3))
        first, second = shape_at(FOOTPRINTS[a], pose_a), shape_at(FOOTPRINTS[b], pose_b)
        distance = scene.distance(body(a), pose_a, body(b), pose_b)
        if distance > 0:
            assert distance == pytest.approx(first.distance(second), abs=1e-9)
        else:
            assert first.intersects(second)
        assert (
            scene.overlap(body(a), pose_a, body(b), pose_b)
            == (first.intersection(second).area > 1e-12)
            or abs(distance) < 1e-6
        )


@pytest.mark.parametrize("name", usually("U", of=("car", "U")))
def test_resting_objects(name):
    rng = np.random.default_rng(11)
    scene = Scene(None, 0.05)
    shape = scene.shape(body(name)).data
    for _ in range(12):
        others = tuple(
            Placed(f"o{i}", body(other), tuple(rng.uniform(-5, 5, 3)))
            for i, other in enumerate(("L", "car", "triangle"))
        )
        area = shapely.union_all([shape_at(p.body.footprint, p.pose) for p in others])
        world = k.WorldData(scene.data, scene.polys(others), shape)
        for _ in range(20):
            x, y, th = rng.uniform(-6, 6, 3)
            me = shape_at(FOOTPRINTS[name], (x, y, th))
            distance = k.poly_distance(world.polys, shape, x, y, th, 100.0)
            if distance > 0:
                assert distance == pytest.approx(area.distance(me), abs=1e-9)
            free = k.clearance(world, x, y, th) >= 0.0
            assert free == (area.distance(me) >= 0.05) or abs(area.distance(me) - 0.05) < TOLERANCE
            kappa, length = float(rng.choice([0.0, 1.0])), float(rng.uniform(-3, 3))
            swept = [k.advance(x, y, th, kappa, length * i / 40) for i in range(41)]
            nearest = min(area.distance(shape_at(FOOTPRINTS[name], pose)) for pose in swept)
            if arc_free(world, x, y, th, kappa, length):
                assert nearest >= 0.05 - TOLERANCE
            else:
                assert nearest <= 0.05 + 0.01 + 0.1


def test_samples_are_swept():
    """A thin wall between two samples is not jumped over."""
    scene = Scene(None, 0.0)
    wall = Placed("wall", Body(((-0.01, -2), (0.01, -2), (0.01, 2), (-0.01, 2)), KIN), (0, 0, 0))
    dot = Body(((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)), KIN)
    across = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    beside = np.array([[-1.0, 2.2, 0], [1.0, 2.2, 0]])
    world = scene.world(shape_of(dot), (wall,))
    assert samples_free(world, across, 1e-4) == 0
    assert samples_free(world, beside, 1e-4) == -1


def test_clearance_field_is_a_bound_for_whole_cells():
    rng = np.random.default_rng(5)
    grid = cluttered(rng, density=0.02)
    area, scene = walls_of(grid), Scene(grid)
    for _ in range(2000):
        x, y = rng.uniform(0, 20), rng.uniform(0, 15)
        bound = k.point_clearance(scene.data, x, y)
        distance = area.distance(shapely.Point(x, y))
        assert bound <= distance + 1e-9
        assert bound >= distance - 2 * math.sqrt(2) * grid.resolution
    assert k.point_clearance(scene.data, -1.0, 3.0) == 0.0


def test_touching_is_no_collision():
    occupied = np.zeros((40, 40), dtype=bool)
    occupied[20:, :] = True
    scene = Scene(OccupancyGrid(occupied, 0.1))
    assert scene.map_free(body("car"), (2.0, 1.5, 0.0))
    assert not scene.map_free(body("car"), (2.0, 1.501, 0.0))
    assert not scene.pose_free(body("car"), (2.0, 1.5, 0.0))  # the margin is asked for
    assert not scene.overlap(body("car"), (0, 0, 0), body("car"), (2, 0, 0))
    assert scene.overlap(body("car"), (0, 0, 0), body("car"), (1.999, 0, 0))


def test_shapes():
    for name, footprint in FOOTPRINTS.items():
        shape = shape_of(body(name), 0.1)
        polygon = shapely.Polygon(footprint)
        parts = shapely.union_all([shapely.Polygon(p) for p in shape.parts])
        assert parts.symmetric_difference(polygon).area < 1e-9
        assert sum(shapely.Polygon(p).area for p in shape.parts) == pytest.approx(polygon.area)
        discs = shapely.union_all([shapely.Point(x, y).buffer(r, 256) for x, y, r in shape.discs])
        assert polygon.difference(discs).area < 1e-3
        cx, cy, r = shape.inner
        assert polygon.buffer(1e-9).covers(shapely.Point(cx, cy).buffer(r * (1 - 1e-9), 64))
        inflated = shapely.union_all(
            [
                shapely.Polygon(shape.data.verts[1, i, :n])
                for i, n in enumerate(shape.data.counts[1])
            ]
        )
        assert inflated.buffer(1e-9).covers(polygon.buffer(0.1, 256))
        assert polygon.buffer(0.1083, 256).covers(inflated)
    car = shape_of(body("car"))
    assert car.inscribed == pytest.approx(0.5)
    assert car.circumscribed == pytest.approx(math.hypot(1, 0.5))
    assert shape_of(body("U")).inscribed == 0.0


@pytest.mark.parametrize(
    ("footprint", "said"),
    [
        (((0, 0), (1, 0)), "three"),
        (((0, 0), (1, 0), (2, 0)), "valid|simple|area|three"),
        (((0, 0), (1, 1), (1, 0), (0, 1)), "simple"),
        (((0, 0), (1, 0), (float("nan"), 1)), "finite"),
    ],
)
def test_bad_footprints(footprint, said):
    with pytest.raises(ProblemError, match=said):
        shape_of(Body(footprint, KIN))


@pytest.mark.long
@pytest.mark.parametrize("name", FOOTPRINTS)
def test_many_edges_against_the_map(name):
    """Ten thousand swept edges: what is called free never comes closer than the margin."""
    rng = np.random.default_rng(17)
    footprint, margin = FOOTPRINTS[name], 0.02
    shape = shape_of(body(name), margin).data
    free = 0
    for turn in range(4):
        grid = cluttered(rng, (1.0, -2.0, 0.3 * turn), density=0.004)
        area, scene = walls_of(grid), Scene(grid)
        world = k.WorldData(scene.data, scene.polys(), shape)
        for x, y, th in random_poses(rng, grid, 500):
            kappa, length = float(rng.uniform(-1, 1)), float(rng.uniform(-3, 3))
            if arc_free(world, x, y, th, kappa, length):
                free += 1
                poses = [k.advance(x, y, th, kappa, length * i / 200) for i in range(201)]
                nearest = min(area.distance(shape_at(footprint, pose)) for pose in poses)
                assert nearest >= margin - TOLERANCE
    assert free > 200
