"""Handing over a place: one object arrives where another one leaves, and cannot do so at once.

Two objects share a place if they would overlap there. Who arrives then comes a *gap* after the
other one's departure has begun. The gap is *proven* by the footprints and the accelerations alone
(the last metres of the one and the first metres of the other). Between the motions that the
planner takes for the fastest it is mostly more; but a slower motion may make way sooner, so that
this gap is a guess: it guides the search once a candidate has failed, and no bound rests on it.
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
    Deadline,
    FixedMotion,
    PathQuery,
    TimedMotion,
    check_time,
)
from up_samp.model.refinement import Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.facts import MotionCase, Signature, are_apart
from up_samp.search.knowledge import Knowledge
from up_samp.search.motions import Motions

PAIRS = 1500
"""Of motions, whose gaps are stated at once at most; others when they meet."""

LONG_BEFORE = 1000.0
"""Seconds by which who arrives may have set out before the other one leaves."""
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
        gap = proven_gap(facts.signature(leaving), facts.signature(coming))
        units = facts.units(gap)
        if units > 0:
            found.append(_stated(leaving, coming, units, Strength.PROVEN))
    return found


def guessed_handovers(motions: Motions, knowledge: Knowledge) -> list[Refinement]:
    """Return the gaps between the fastest motions at all shared places; none the second time."""
    if knowledge.handovers_guessed:
        return []
    knowledge.handovers_guessed = True
    pairs = list(itertools.islice(_pairs(motions), PAIRS + 1))
    if len(pairs) > PAIRS:
        return []
    deadline = motions.budget.part("gaps at shared places")
    found = []
    for leaving, coming in pairs:
        cut = handover(motions, knowledge, (leaving, coming), deadline)
        found += [] if cut is None else [cut]
    return found


def handover(
    motions: Motions,
    knowledge: Knowledge,
    pair: tuple[MotionCase, MotionCase],
    deadline: Deadline,
) -> Refinement | None:
    """Return the gap between who leaves and who comes as a statement: the larger of the two, if
    there is any.

    Past the deadline only the proven one is known.
    """
    facts = motions.facts
    signatures = facts.signature(pair[0]), facts.signature(pair[1])
    strength = Strength.PROVEN
    units = facts.units(proven_gap(*signatures))
    if signatures not in knowledge.handovers and not deadline.expired():
        gap = _gap_of_the_fastest(motions, *signatures, deadline)
        if gap is not None or not motions.budget.deadline.expired():
            knowledge.handovers[signatures] = gap
    gap = knowledge.handovers.get(signatures)
    if gap is not None and facts.units(gap) > units:
        units, strength = facts.units(gap), Strength.HEURISTIC
    return _stated(*pair, units, strength) if units > 0 else None


def _stated(leaving: MotionCase, coming: MotionCase, units: int, strength: Strength) -> Refinement:
    cut = rules.handed_over(
        leaving.activity,
        coming.activity,
        units,
        f"{coming.task.object} arrives where {leaving.task.object} leaves",
        strength=strength,
    )
    return rules.only_given(cut, tuple(sorted({*leaving.given, *coming.given})))


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
            if not _planar(here[0], there[0]) or not motions.service.overlap(*here, *there):
                continue
            for one in going:
                for other in arriving:
                    if are_apart(one, other):
                        yield one, other


def _planar(*bodies: Body) -> bool:
    return all(not b.flies for b in bodies)


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


def _gap_of_the_fastest(
    motions: Motions, leaving: Signature, coming: Signature, deadline: Deadline
) -> float | None:
    """Return how long (s) after one's departure the other one arrives at the earliest, the first
    being as fast as can be and the second waiting where it likes; None where it was not found.
    """
    body, poses = leaving
    limit = deadline.within(motions.budget.query_seconds)
    report = motions.service.plan(PathQuery(body, poses), limit)
    if report.trajectory is None or not report.complete:
        return None
    leader = FixedMotion(
        "leaving", "leaving", body, report.trajectory, -math.inf, report.trajectory.end
    )
    follower = TimedMotion(
        "coming", "coming", coming[0], coming[1], -LONG_BEFORE, math.inf, -math.inf, math.inf
    )
    arrival = motions.arrival(follower, fixed=(leader,), deadline=deadline)
    return None if arrival is None or arrival <= 0 else arrival
