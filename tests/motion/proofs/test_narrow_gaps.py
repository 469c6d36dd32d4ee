"""Gaps that are some centimetres too narrow: proven on finer cells, never where a disc passes."""

import random

import shapely

from tests.motion.oracle import CAR, ROBOT, box_map, shape_at
from up_samp.geometry.shapes import shape_of
from up_samp.model import Body, Deadline, Outcome, PathQuery, Placed
from up_samp.motion import MotionService

SIZE, WALL = 10.0, (4.0, 4.4)
RADIUS = shape_of(ROBOT).inner[2]
ENDS = ((2.0, 8.5, 0.0), (2.0, 1.5, 0.0))
BEHIND = tuple(shapely.Point(x, y) for x, y, _ in ENDS)


def gap_beside_a_box(rng):
    """Draw a wall with a gap, and boxes in front of both its ends."""
    left, right = round(rng.uniform(2.8, 3.4), 1), round(rng.uniform(4.6, 5.4), 1)
    walls = [(0.0, WALL[0], left, WALL[1]), (right, WALL[0], SIZE, WALL[1])]
    placed = []
    for k, x in enumerate((left, right)):
        long, wide = rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.4)
        body = Body(((-long, -wide), (long, -wide), (long, wide), (-long, wide)), CAR)
        pose = (x + rng.uniform(-0.4, 0.4), WALL[1] + rng.uniform(0.7, 1.6), rng.uniform(-3, 3))
        placed.append(Placed(f"box{k}", body, pose))
    return walls, placed


def passes(walls, placed, radius):
    """Return whether a disc gets from one end to the other, by shapely."""
    outer = shapely.box(0.2, 0.2, SIZE - 0.2, SIZE - 0.2)
    solid = [shapely.box(*wall) for wall in walls]
    solid += [shape_at(p.body.footprint, p.pose) for p in placed]
    room = outer.buffer(-radius) - shapely.union_all(solid).buffer(radius, 64)
    parts = getattr(room, "geoms", [room])
    return any(all(part.covers(point) for point in BEHIND) for part in parts)


def test_what_is_too_narrow_by_centimetres():
    proven = finer = 0
    for seed in range(40):
        walls, placed = gap_beside_a_box(random.Random(seed))
        service = MotionService(box_map(SIZE, SIZE, walls))
        proof = service.certifier.prove_slowly(ROBOT, *ENDS, placed, Deadline.after(0.0))
        if passes(walls, placed, RADIUS + 1e-3):
            assert proof is None, seed
        elif not passes(walls, placed, RADIUS - 0.02):
            assert proof is not None, seed
            proven += 1
            finer += service.certificate(ROBOT, ENDS, placed) is None
    assert proven > 5
    assert finer > 0


def test_the_answer_names_what_is_in_the_way_and_is_remembered(monkeypatch):
    box = Body(((-1.2, -0.3), (1.2, -0.3), (1.2, 0.3), (-1.2, 0.3)), CAR)
    beside = Placed("beside", ROBOT, (6.5, 1.5, 0.0))
    for below in (0.93, 1.1):  # between its corners and those of the wall
        service = MotionService(box_map(SIZE, SIZE, [(0, 4, 2.6, 4.4), (5.4, 4, SIZE, 4.4)]))
        placed = (Placed("box", box, (4.0, WALL[0] - below - 0.3, 0.0)), beside)
        query = PathQuery(ROBOT, ENDS, placed)
        report = service.plan(query, Deadline.after(60))
        if below > 1:
            assert report.outcome is Outcome.FOUND
            continue
        assert (report.outcome, report.blockers) == (Outcome.IMPOSSIBLE, {"box"})
        assert service.certificate(ROBOT, ENDS, placed) is None
        monkeypatch.setattr(service.legs, "_sought", None)  # nobody is asked again
        again = service.plan(PathQuery(ROBOT, ENDS, placed[::-1]), Deadline.after(60))
        assert (again.outcome, again.blockers) == (report.outcome, report.blockers)
