import math

import numpy as np

from tests.motion.oracle import CAR, RECTANGLE, ROBOT, box_map
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery, Placed
from up_samp.motion import MotionService
from up_samp.motion.proofs.heading_slices import discs_inside, separated

SLIDER = Body(RECTANGLE, Kinematics(MotionModel.SE2))


def corner(width):
    """Return a corridor of some width that turns by a right angle."""
    return box_map(12, 12, [(1.0 + width, 1.0 + width, 12, 12), (0, 0, 1.0, 12), (0, 0, 12, 1.0)])


def test_a_corner_too_narrow_for_the_length():
    """The inner disc passes, the footprint does not: only headings prove it."""
    service = MotionService(corner(1.15))
    ends = ((1.575, 8.0, math.pi / 2), (8.0, 1.575, 0.0))
    assert service.certificate(ROBOT, ends, ()) is None
    report = service.plan(PathQuery(ROBOT, ends), Deadline.after(60))
    assert report.outcome is Outcome.IMPOSSIBLE
    assert report.blockers == frozenset()


def test_an_object_that_makes_a_corner_too_narrow():
    service = MotionService(corner(2.4))
    wedge = Body(((0, 0), (0, -1.3), (-1.3, -1.3), (-1.3, 0)), CAR)
    blocker = Placed("wedge", wedge, (3.4, 3.4, 0.0))
    far = Placed("far", ROBOT, (8.0, 2.9, 0.0))
    ends = ((1.75, 10.0, math.pi / 2), (10.5, 1.75, 0.0))
    proof = service.certifier.prove_slowly(ROBOT, *ends, (far, blocker), Deadline.after(60))
    assert proof is not None
    assert proof.blockers == {"wedge"}


def test_discs_are_inside():
    import shapely

    for footprint in (RECTANGLE, ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))):
        polygon = shapely.Polygon(footprint).buffer(1e-9)
        discs = discs_inside(Body(footprint, CAR))
        assert len(discs) > 2
        for x, y, r in discs:
            assert polygon.covers(shapely.Point(x, y).buffer(r, 64))


def test_what_can_be_driven_is_never_refuted():
    rng = np.random.default_rng(0)
    for seed, walls in enumerate(
        ([(4, 0, 5, 6.6), (8, 4.4, 9, 10)], [(5, 0, 6, 4.4), (5, 5.6, 6, 10)])
    ):
        service = MotionService(box_map(13, 10, walls), seed=seed)
        found = 0
        while found < 4:
            ends = [tuple(map(float, rng.uniform((1, 1, -3), (12, 9, 3)))) for _ in range(2)]
            if not all(service.scene.pose_free(SLIDER, e) for e in ends):
                continue
            report = service.plan(PathQuery(SLIDER, tuple(ends)), Deadline.after(20))
            if report.outcome is Outcome.FOUND:
                found += 1
                nearest = service.certifier.nearest
                limit = Deadline.after(20)
                assert not separated(service.scene, nearest, SLIDER, tuple(ends), (), limit)
