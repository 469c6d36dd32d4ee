import math

import numpy as np
import pytest
import shapely
from scipy import ndimage

from tests.motion.oracle import CAR, DOOR, RECTANGLE, ROBOT, box_map, logistics_map
from up_samp.geometry import OccupancyGrid, Scene
from up_samp.geometry.cells import Visibility
from up_samp.model import Body, Kinematics, MotionModel, Outcome, Placed
from up_samp.motion import MotionService
from up_samp.motion.proofs.bounds import DurationBounds
from up_samp.motion.proofs.certificates import Certifier
from up_samp.validation.collisions import JudgedShape as JudgedShape
from up_samp.validation.collisions import Track, hits_body

START = (25.0, 59.0, math.pi / 2)


@pytest.fixture(scope="module")
def depot():
    return MotionService(logistics_map())


def test_what_is_behind_a_closed_door(depot):
    closed = Placed("door", DOOR, (51.5, 30.0, 0.0))
    targets = {"inside": (59.0, 32.0, 0.0), "outside": (59.0, 42.0, 0.0), "wall": (59.0, 37.0, 0.0)}

    def cut_off(*obstacles):
        return {
            name
            for name, pose in targets.items()
            if depot.certificate(ROBOT, (START, pose), obstacles) is not None
        }

    assert cut_off(closed) == {"inside", "wall"}
    assert cut_off() == {"wall"}


def test_blockers_are_few():
    """Two rooms in a row: one door is enough; a second way in needs only one of them gone."""
    door = Body(((-0.2, -2.0), (0.2, -2.0), (0.2, 2.0), (-0.2, 2.0)), CAR)
    two_in_a_row = box_map(
        30, 10, [(10, 0, 10.4, 3), (10, 7, 10.4, 10), (20, 0, 20.4, 3), (20, 7, 20.4, 10)]
    )
    a, b = Placed("a", door, (10.2, 5.0, 0.0)), Placed("b", door, (20.2, 5.0, 0.0))
    other = Placed("other", ROBOT, (5.0, 2.0, 0.0))
    service = MotionService(two_in_a_row)
    ends = ((5.0, 5.0, 0.0), (25.0, 5.0, 0.0))
    proof = service.certificate(ROBOT, ends, (other, a, b))
    assert proof.outcome is Outcome.IMPOSSIBLE
    assert len(proof.blockers) == 1
    assert proof.blockers < {"a", "b"}
    assert (
        service.certificate(
            ROBOT, ends, (other, *(p for p in (a, b) if p.name not in proof.blockers))
        )
        is not None
    )

    two_ways = box_map(20, 20, [(10, 0, 10.4, 3), (10, 7, 10.4, 13), (10, 17, 10.4, 20)])
    low, high = Placed("low", door, (10.2, 5.0, 0.0)), Placed("high", door, (10.2, 15.0, 0.0))
    service = MotionService(two_ways)
    ends = ((5.0, 5.0, 0.0), (15.0, 5.0, 0.0))
    proof = service.certificate(ROBOT, ends, (low, high, other))
    assert proof.blockers == {"low", "high"}
    assert service.certificate(ROBOT, ends, (low, other)) is None


def test_poses_in_walls_and_objects(depot):
    parked = Placed("parked", ROBOT, (26.0, 59.0, 0.0))
    proof = depot.certificate(ROBOT, (START, (40.0, 50.0, 0.0)), (parked,))
    assert proof.blockers == {"parked"}
    proof = depot.certificate(ROBOT, (START, (60.0, 37.0, 0.0)), (parked,))
    assert proof.blockers == frozenset()
    assert "60, 37" in proof.reason
    assert depot.certificate(ROBOT, (START, (-5.0, 37.0, 0.0)), ()) is not None
    assert depot.pose_blockers(ROBOT, START, (parked,)) == (False, {"parked"})
    assert depot.pose_blockers(ROBOT, (60.0, 37.0, 0.0), (parked,)) == (True, frozenset())
    beside = Placed("beside", ROBOT, (26.5, 59.0, 0.0))  # touches
    assert depot.pose_blockers(ROBOT, START, (beside,)) == (False, frozenset())


def test_a_sealed_room():
    grid = box_map(20, 10, [(10, 0, 10.4, 10)])
    proof = MotionService(grid).certificate(ROBOT, ((5, 5, 0.0), (15, 5, 0.0)), ())
    assert proof is not None
    assert proof.blockers == frozenset()


def test_unknown_cells_are_walls():
    occupied = box_map(20, 10).occupied
    unknown = np.zeros_like(occupied)
    unknown[:, 100:104] = True
    grid = OccupancyGrid(occupied, 0.1, unknown=unknown)
    assert MotionService(grid).certificate(ROBOT, ((5, 5, 0.0), (15, 5, 0.0)), ()) is not None


@pytest.mark.parametrize("resolution", [0.1, 0.25, 0.5])
@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_passable_gaps_are_never_refuted(resolution, yaw):
    """A disc-shaped body that just fits: it is driven through on paper, so no proof may say no."""
    angles = np.linspace(0, 2 * math.pi, 40, endpoint=False)
    ring = tuple((0.5 * math.cos(a), 0.5 * math.sin(a)) for a in angles)
    disc = Body(ring, CAR)
    rng = np.random.default_rng(0)
    for _ in range(20):
        gap = 1.0 + float(rng.uniform(0.001, 0.05))
        y = float(rng.uniform(3, 6))
        half = Body(((-0.3, 0.0), (0.3, 0.0), (0.3, 12.0), (-0.3, 12.0)), CAR)
        c, s = math.cos(yaw), math.sin(yaw)

        def at(x, y, turn, c=c, s=s):
            return (c * x - s * y, s * x + c * y, turn + yaw)

        upper = Placed("upper", half, at(10, y + gap / 2, 0.0))
        lower = Placed("lower", half, at(10, y - gap / 2, math.pi))
        empty = np.zeros((round(10 / resolution), round(20 / resolution)), dtype=bool)
        service = MotionService(OccupancyGrid(empty, resolution, (0.0, 0.0, yaw)))
        ends = (at(5, y, 0.0), at(15, y, 0.0))
        assert service.certificate(disc, ends, (upper, lower)) is None
        tight = Placed("upper", half, at(10, y + gap / 2 - 0.4 - 1.5 * resolution, 0.0))
        proof = service.certificate(disc, ends, (tight, lower))
        assert proof is not None
        assert proof.blockers == {"upper", "lower"}


def test_random_maps_against_flood_fill():
    """Where the robot's centre line connects cell by cell with room to spare, nothing is
    refuted.
    """
    rng = np.random.default_rng(1)
    body = Body(RECTANGLE, Kinematics(MotionModel.SE2))
    for _ in range(15):
        blocked = ndimage.binary_dilation(rng.random((80, 80)) < 0.003, iterations=2)
        grid = OccupancyGrid(blocked, 0.25)
        service = MotionService(grid)
        wide = ndimage.distance_transform_edt(~np.pad(blocked, 1, constant_values=True))[1:-1, 1:-1]
        open_cells = wide * 0.25 > 1.12 + 0.36  # the whole circumscribed disc fits
        labels, count = ndimage.label(open_cells)
        for label in range(1, count + 1):
            cells = np.argwhere(labels == label)
            a, b = cells[rng.integers(len(cells))], cells[rng.integers(len(cells))]
            ends = [(*grid.point_of(*cell), 0.5) for cell in (a, b)]
            assert service.certificate(body, ends, ()) is None


def test_bounds_are_exact_lengths_round_corners():
    """Round a thin wall: the disc's centre turns about the wall's end at its radius."""
    grid = box_map(20, 20, [(9.9, 0, 10.1, 10)], resolution=0.05)
    bounds = DurationBounds(Scene(grid))
    a, b = (5.0, 5.0, 0.0), (15.0, 5.0, 0.0)
    length = bounds.length(ROBOT, a, b)
    free = math.dist((5, 5), (9.9, 10)) * 2 + 0.2
    assert free < length
    # the exact way: tangents and an arc of radius 0.5 about the wall's corners
    beta = math.atan2(5, 4.9) + math.asin(0.5 / math.dist((5, 5), (9.9, 10)))
    exact = 2 * (math.sqrt(math.dist((5, 5), (9.9, 10)) ** 2 - 0.25) + 0.5 * beta) + 0.2
    assert length <= exact
    assert length >= exact - 0.15  # a cell or so
    door = Placed("door", DOOR, (10.0, 12.5, 0.0))
    assert bounds.length(ROBOT, a, b, (door,)) > length


def test_bounds_by_model():
    bounds = DurationBounds(Scene(None))
    spin = Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, 2.0, 0.5, omega_max=0.1))
    assert bounds.through(spin, ((0, 0, 0.0), (1, 0, 2.0))) == pytest.approx(20.0)
    assert bounds.through(ROBOT, ((0, 0, 0.0), (18, 0, 0.0))) == pytest.approx(13.0)
    solid = Body((), Kinematics(MotionModel.SE3), mesh="a.stl")
    turned = (0, 0, 0, 0, 0, 1, 0)
    assert bounds.through(solid, ((0, 0, 0, 0, 0, 0, 1), turned)) == pytest.approx(math.pi)


def test_visibility_with_many_corners_stays_admissible():
    rng = np.random.default_rng(2)
    blocked = rng.random((120, 120)) < 0.2
    blocked[[0, -1]] = blocked[:, [0, -1]] = True
    blocked[1, 1] = blocked[-2, -2] = False
    coarse = Visibility(blocked, 0.1)
    way = coarse.distance((1.5, 1.5), (118.5, 118.5))
    free = ~blocked
    steps = np.full(blocked.shape, np.inf)
    steps[1, 1] = 0.0
    for _ in range(400):  # 8-connected steps: never shorter than the shortest way
        around = [
            np.roll(np.roll(steps, i, 0), j, 1) + math.hypot(i, j)
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        steps = np.where(free, np.minimum.reduce([steps, *around]), np.inf)
    if np.isfinite(steps[-2, -2]):
        assert way <= steps[-2, -2] * 0.1 + 1e-9
    assert way >= math.hypot(117, 117) * 0.1 - 1e-9


def test_the_same_without_a_map():
    certifier = Certifier(Scene(None))
    parked = Placed("parked", ROBOT, (5.0, 0.0, 0.0))
    assert certifier.prove(ROBOT, ((0, 0, 0.0), (10, 0, 0.0)), (parked,)) is None
    assert certifier.prove(ROBOT, ((0, 0, 0.0), (5, 0.2, 0.0)), (parked,)) is not None
    assert certifier.prove(ROBOT, ((0, 0, 0.0), (5, 0, 1.0)), (parked,)) is not None


def test_contact_is_no_proof():
    """Bodies pushed into each other by hardly anything: what is proven, the validator refuses."""
    rng = np.random.default_rng(11)
    proven = clear = 0
    for trial in range(300):
        sharp = float(rng.uniform(0.02, 0.6))
        spike = ((0.0, 0.0), (-1.0, sharp), (-1.0, -sharp))  # its tip is the reference point
        body, wall = Body(spike, CAR), Body(((0.0, -3.0), (2.0, -3.0), (2.0, 3.0), (0.0, 3.0)), CAR)
        depth = float(rng.choice([0.0, 5e-7, 1e-6, 1.5e-6, 3e-6, 1e-5, 1e-4, 1e-3]))
        heading = float(rng.uniform(-0.5, 0.5))
        pose, rest = (depth, float(rng.uniform(-1, 1)), heading), (0.0, 0.0, 0.0)
        obstacle = Placed("wall", wall, rest)
        proof = MotionService(None).certificate(body, ((-5.0, 0.0, 0.0), pose), (obstacle,))
        shapes = [JudgedShape(n, np.array(b.footprint)) for n, b in (("a", body), ("b", wall))]
        tracks = [
            Track(np.array([0.0]), np.array([p]), s.radius)
            for p, s in zip((pose, rest), shapes, strict=True)
        ]
        meets = hits_body(shapes[0], tracks[0], shapes[1], tracks[1], 0.0, 1.0) is not None
        assert meets or proof is None, f"trial {trial}: {depth} m deep is called proven"
        proven += proof is not None
        clear += not meets
    assert proven > 50
    assert clear > 50


def test_a_robot_that_touches_a_wall_is_not_in_it():
    grid = box_map(12, 8)
    service = MotionService(grid)
    for gap, inside in ((0.0, False), (-1e-6, False), (-1e-3, True)):
        blocked, _ = service.pose_blockers(ROBOT, (1.2 + gap, 4.0, 0.0), ())
        assert blocked is inside


def placed_at(footprint, poses):
    """Return a footprint at poses (n, 3), as polygons."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turned = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    corners = np.einsum("nij,kj->nki", turned, np.array(footprint)) + poses[:, None, :2]
    return shapely.polygons(corners)


def where_it_gets(footprint, start, walls):
    """Return the places (n, 2) that a body comes to past ``walls``, by small steps and turns."""
    xs, ys, turns = np.arange(0, 8, 0.25), np.arange(0, 4, 0.25), np.arange(8) * math.pi / 4
    grid = np.stack(np.meshgrid(xs, ys, turns, indexing="ij"), -1)
    grid[..., :2] += np.mod(start[:2], 0.25)
    free = ~shapely.intersects(placed_at(footprint, grid.reshape(-1, 3)), walls)
    free = free.reshape(grid.shape[:3])
    parts, _ = ndimage.label(np.concatenate([free, free], axis=2), np.ones((3, 3, 3)))
    mine = parts[int(start[0] / 0.25), int(start[1] / 0.25)]
    here = np.isin(parts, mine[mine > 0]).any(axis=2)
    return grid[:, :, 0, :2][here]


@pytest.mark.parametrize("seed", range(12))
def test_how_far_it_is_from_behind_a_door(seed):
    """Wherever a body waits, so much of its way is left, whatever its reference point is."""
    rng = np.random.default_rng(seed)
    at, low, wide = 3 + 2 * rng.random(), 0.6 + rng.random(), 0.9 + rng.random()
    gap = [(at, 0, at + 0.2, low), (at, low + wide, at + 0.2, 4)]
    walls = shapely.union_all([shapely.box(*box) for box in gap])
    floor = shapely.box(0, 0, 8, 4)
    length, breadth, ahead = 0.5 + rng.random(), 0.4, rng.uniform(-0.6, 0.6)
    shape = np.array(
        [(-length, -breadth), (length, -breadth), (length, breadth), (-length, breadth)]
    )
    footprint = shape / 2 + (ahead, 0)
    leaf = np.array([(-0.1, -wide / 2), (0.1, -wide / 2), (0.1, wide / 2), (-0.1, wide / 2)])
    body = Body(tuple(map(tuple, footprint)), Kinematics(MotionModel.SE2, 1.0, 1.0, 1.0))
    door = Placed("door", Body(tuple(map(tuple, leaf)), CAR), (at + 0.1, low + wide / 2, 0.0))
    start, goal = (1.5, 1.0 + 2 * rng.random(), 0.0), (6.7, 1.0 + 2 * rng.random(), math.pi)
    certifier = Certifier(Scene(box_map(8, 4, gap)))
    shut = shapely.union_all(
        [walls, shapely.box(*placed_at(leaf, np.array([door.pose]))[0].bounds)]
    )
    places = where_it_gets(footprint, start, shut | floor.exterior)
    least = float(np.hypot(*(places - goal[:2]).T).min())
    left = certifier.left(body, (start, goal), (door,))
    assert least - 1.0 < left <= least
    assert certifier.left(body, (start, goal), ()) == 0.0
    beyond = certifier.left(body, (start, goal, start, goal), (door,))
    assert beyond == pytest.approx(left + 2 * math.dist(start[:2], goal[:2]))
