"""Handing over a place: one object arrives where another one leaves, and cannot do so at once.

Two objects share a place if they would overlap there. Who arrives then comes a *gap* after the
other one's departure has begun. The gap is *proven* by the footprints and the accelerations alone
(the last metres of the one and the first metres of the other).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator

import shapely

from up_samp.model import (
    Body,
    Configuration,
    check_time,
)
from up_samp.model.refinement import Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.facts import MotionCase, Signature, are_apart
from up_samp.search.motions import Motions

PAIRS = 1500
"""Of motions, whose gaps are stated, at most."""
ALLOWANCE = 0.95
"""Accelerations are judged with a little tolerance: proven gaps are that much shorter."""


def proven_handovers(motions: Motions) -> list[Refinement]:
    """Return the proven gaps at all shared places, before the first schedule."""
    facts = motions.facts
    pairs = list(itertools.islice(_pairs(motions), PAIRS + 1))
    if len(pairs) > PAIRS:
        return []
    found = []
    for leaving, coming in pairs:
        units = facts.units(proven_gap(facts.signature(leaving), facts.signature(coming)))
        if units > 0:
            cut = rules.handed_over(
                leaving.activity,
                coming.activity,
                units,
                f"{coming.task.object} arrives where {leaving.task.object} leaves",
                strength=Strength.PROVEN,
            )
            given = tuple(sorted({*leaving.given, *coming.given}))
            found.append(rules.only_given(cut, given))
    return found


def _pairs(motions: Motions) -> Iterator[tuple[MotionCase, MotionCase]]:
    """Yield (who leaves a place, who comes to it) for all motions that are known."""
    signatures = motions.facts.by_signature
    leaving: dict[tuple[Body, Configuration], list[MotionCase]] = {}
    coming: dict[tuple[Body, Configuration], list[MotionCase]] = {}
    for (body, poses), cases in sorted(signatures.items(), key=lambda i: str(i[0][1])):
        leaving.setdefault((body, poses[0]), []).extend(cases)
        coming.setdefault((body, poses[-1]), []).extend(cases)
    for here, going in leaving.items():
        for there, arriving in coming.items():
            check_time()
            if here[0].flies or there[0].flies or not motions.service.overlap(*here, *there):
                continue
            pairs = itertools.product(going, arriving)
            yield from (pair for pair in pairs if are_apart(*pair))


def proven_gap(leaving: Signature, coming: Signature) -> float:
    """Return a lower bound (s) on the time from one's departure to the other's arrival.

    Both footprints hold a disc. From rest the first one's has moved ``A t^2`` at most after t
    (``A`` half of its acceleration), the second one's has ``B (T - t)^2`` left before it comes to
    rest at T. The two discs are apart at every t only if T is long enough: the least of ``A t^2 +
    B (T - t)^2`` is ``T^2 A B / (A + B)``. Top speeds are left out.
    """
    (one, from_poses), (other, to_poses) = leaving, coming
    best = 0.0
    for first, second in itertools.product(_discs(one), _discs(other)):
        p, q = _at(first, from_poses[0]), _at(second, to_poses[-1])
        way = first[2] + second[2] - math.dist(p, q)
        a, b = _pull(one, first), _pull(other, second)
        if way > 0 and a is not None and b is not None:
            best = max(best, ALLOWANCE * math.sqrt(way * (a + b) / (a * b)))
    return best


def _pull(body: Body, disc: tuple[float, float, float]) -> float | None:
    """Return half of the acceleration (m/s^2) of a disc's centre, at most; None: not bounded."""
    kinematics, off = body.kinematics, math.hypot(disc[0], disc[1])
    if kinematics.mobility.steers:
        return kinematics.a_max / 2 * (1 + off / kinematics.turning_radius)
    if kinematics.mobility.sideways and off < 1e-3:
        return kinematics.a_max / 2
    return None


@functools.lru_cache(maxsize=256)
def _discs(body: Body) -> tuple[tuple[float, float, float], ...]:
    """Return centres (body frame) and radii (m) of discs inside the footprint: the largest one,
    and the largest around the reference point, which moves no faster than the body.
    """
    shape = shapely.Polygon(body.footprint)
    line = shapely.maximum_inscribed_circle(shape, tolerance=1e-3)
    (x, y), rim = line.coords[0], line.coords[-1]
    found = [(x, y, math.dist((x, y), rim) - 2e-3)]
    if shape.contains(shapely.Point(0.0, 0.0)):
        found.append((0.0, 0.0, shape.exterior.distance(shapely.Point(0.0, 0.0))))
    return tuple(found)


def _at(disc: tuple[float, float, float], pose: Configuration) -> tuple[float, float]:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * disc[0] - s * disc[1], pose[1] + s * disc[0] + c * disc[1]
