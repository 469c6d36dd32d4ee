"""The margin is what the parameter says, everywhere: random groups before a judge of distances.

Robots of several bodies drive in a room with a doorway, among what rests there for good, or for a
while (a door's leaf, a load): each keeps the margin from the others, from what rests, and from the
walls, less only where two stand closer at an end.
"""

import itertools
import math
import random

import numpy as np
import pytest
import shapely

from tests.motion.fleet import tight_places as tight
from tests.motion.fleet.spacetime_oracle import placed, room
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    Rest,
    TimedMotion,
)
from up_samp.motion import MotionService

NEAR = 2e-3
"""m that sampled distances, and arcs between samples, may be off."""
FREE = [(0.1, 0.1, 6.4, 7.9), (6.3, 3.0, 6.9, 5.2), (6.8, 0.1, 13.1, 7.9)]
MODELS = (MotionModel.REEDSSHEPP, MotionModel.PIVOT, MotionModel.SE2)
SHAPES = (
    ((-0.35, -0.25), (0.35, -0.25), (0.35, 0.25), (-0.35, 0.25)),
    ((-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3)),
    # with a load ahead
    ((-0.35, -0.25), (0.35, -0.25), (0.35, -0.2), (0.75, -0.2), (0.75, 0.2), (0.35, 0.2),
     (0.35, 0.25), (-0.35, 0.25)),
)  # fmt: skip
LEAF = ((-0.1, -0.6), (0.1, -0.6), (0.1, 0.6), (-0.1, 0.6))


def walls():
    outside = shapely.box(-1, -1, 15, 9)
    return outside.difference(shapely.union_all([shapely.box(*part) for part in FREE]))


def draw(seed, margin):
    """Return motions and rests whose ends are farther apart than the margin."""
    rng = random.Random(seed)
    taken = [walls()]
    bodies = [
        Body(rng.choice(SHAPES), Kinematics(rng.choice(MODELS), 0.6, 1.0, 0.5, 1.0))
        for _ in range(rng.choice((2, 2, 3, 3, 4)))
    ]

    def spot(body, side):
        for _ in range(400):
            x = rng.uniform(1.2, 5.2) if side else rng.uniform(8.0, 12.0)
            pose = (x, rng.uniform(1.2, 6.8), rng.choice((0.0, 0.5, 1.0, 1.5)) * math.pi)
            here = placed(body, pose)
            if all(here.distance(other) > margin + 0.1 for other in taken):
                taken.append(here)
                return pose
        return None

    rests = []
    if rng.random() < 0.5:
        leaf = Rest("leaf", Body(LEAF, bodies[0].kinematics), (6.6, 4.2, 0.0), 0.0, 12.0)
        rests.append(leaf)
    starts = [(side, spot(b, side)) for b in bodies for side in [rng.random() < 0.5]]
    crate = spot(bodies[0], rng.random() < 0.5)
    if crate is not None:
        rests.append(Rest("crate", bodies[0], crate))
    goals = [spot(b, not side) for b, (side, _) in zip(bodies, starts, strict=True)]
    motions = [
        TimedMotion(f"m{k}", f"r{k}", body, (start, goal), 0.0, rng.choice((20.0, 40.0, 1e9)))
        for k, (body, (_, start), goal) in enumerate(zip(bodies, starts, goals, strict=True))
        if start is not None and goal is not None
    ]
    return motions, rests


def closest(motions, rests, trajectories, floor):
    """Return the least distance (m) of each pair of bodies, and of each from the walls (``floor``),
    while one of them moves.
    """
    found = {}
    end = max(t.end for t in trajectories.values())
    for t in np.arange(0.0, end, 0.04):
        there = [(r.name, placed(r.body, r.pose), False) for r in rests if r.since <= t < r.until]
        for m in motions:
            way = trajectories[m.name]
            there.append((m.object, placed(m.body, way.at(t)), way.start < t < way.end))
        for a, b in itertools.combinations(there, 2):
            if a[2] or b[2]:
                pair = (a[0], b[0])
                found[pair] = min(found.get(pair, math.inf), a[1].distance(b[1]))
        for name, shape, moves in there:
            if moves:
                found[name] = min(found.get(name, math.inf), shape.distance(floor))
    return found


def too_close(seed, margin):
    """Return who comes closer than the margin; None where nothing was found."""
    motions, rests = draw(seed, margin)
    service = MotionService(room(14, 8, FREE), margin=margin)
    query = GroupQuery(tuple(motions), tuple(rests))
    report = service.coordinate(query, Deadline.after(20))
    if report.outcome is not Outcome.FOUND:
        return None
    found = closest(motions, rests, report.trajectories, walls())
    return {who: gap for who, gap in found.items() if gap < margin - NEAR}


QUICK = (2, 3, 8)
"""Groups that come closer where the margin is half of what is asked, and are found soon."""


@pytest.mark.parametrize(
    ("seeds", "margin"),
    [(QUICK, 0.3), *(pytest.param((4, 8), m, marks=pytest.mark.long) for m in (0.1, 0.3))],
)
def test_groups_keep_the_margin(seeds, margin):
    answers = [too_close(seed, margin) for seed in seeds]
    assert None not in answers
    assert not any(answers)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "margin"), [(6, 0.1), (9, 0.3)])
def test_copies_of_others_near_an_end_make_it_no_smaller(seed, margin):
    """Detours are sought around copies of those that would be met."""
    assert not too_close(seed, margin)


@pytest.mark.long
@pytest.mark.parametrize("margin", [0.05, 0.1, 0.3])
def test_many_groups_keep_the_margin(margin):
    answers = {seed: too_close(seed, margin) for seed in range(100, 180)}
    assert sum(answer is not None for answer in answers.values()) >= 40
    assert {seed: answer for seed, answer in answers.items() if answer} == {}


def apart_in_knots(case, kind, margin):
    """Return who comes closer than the margin in a tight place, while one of them moves; None where
    nothing was found. Who stands closer to another at an end may keep half of that; who stands
    closer to a wall may come as close.
    """
    traffic = tight.CASES[case].build(tight.BODIES[kind]())
    service = MotionService(traffic.grid, margin=margin)
    motions = traffic.query.motions
    report = service.coordinate(traffic.query, Deadline.after(60))
    if report.outcome is not Outcome.FOUND:
        return None
    asked = {}
    for one, other in itertools.combinations(motions, 2):
        ends = itertools.product(
            one.poses[:: len(one.poses) - 1], other.poses[:: len(other.poses) - 1]
        )
        gap = min(placed(one.body, a).distance(placed(other.body, b)) for a, b in ends)
        asked[one.object, other.object] = min(margin, max(0.5 * gap, gap - 0.02))
    floor = blocked(traffic.grid)
    for m in motions:
        if min(placed(m.body, pose).distance(floor) for pose in m.poses) < margin:
            asked[m.object] = 0.0
    found = closest(motions, (), report.trajectories, floor)
    return {who: gap for who, gap in found.items() if gap < asked.get(who, margin) - NEAR}


def blocked(grid):
    """Return the walls of a grid as a shape."""
    cells = np.argwhere(grid.blocked)
    half = 0.5 * grid.resolution
    corners = [grid.point_of(r, c) for r, c in cells]
    return shapely.union_all(
        [shapely.box(x - half, y - half, x + half, y + half) for x, y in corners]
    )


def test_joint_moves_keep_the_margin():
    assert apart_in_knots("full ring of three", "omni", 0.05) == {}


@pytest.mark.long
@pytest.mark.parametrize("margin", [0.03, 0.05])
@pytest.mark.parametrize("case", tight.CASES)
def test_joint_moves_keep_the_margin_everywhere(case, margin):
    kinds = tight.CASES[case].bodies
    answers = {kind: apart_in_knots(case, kind, margin) for kind in kinds}
    assert {kind: answer for kind, answer in answers.items() if answer} == {}
