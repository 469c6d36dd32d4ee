"""Where the objects of a candidate rest, and who has to be gone before another one stays."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from up_samp.model import Body, Configuration, MotionModel, ScheduledMotion
from up_samp.search.facts import Facts
from up_samp.upio import Itinerary

if TYPE_CHECKING:
    from up_samp.motion import MotionService


@dataclass(frozen=True)
class Visit:
    """An object rests at a pose, from its motion ``arrival`` (None: from the start) until its
    motion ``departure`` (None: for good). ``since`` is when it arrives in the candidate (units).
    """

    object: str
    body: Body
    pose: Configuration
    arrival: str | None
    departure: str | None
    since: int


def visits_of(facts: Facts, itinerary: Itinerary) -> list[Visit]:
    """Return where the objects that drive rest, in a candidate."""
    by_object: dict[str, list[ScheduledMotion]] = defaultdict(list)
    for motion in itinerary.motions:
        by_object[motion.object].append(motion)
    snapshot = facts.snapshot
    found = []
    for name in sorted(facts.drivers):
        body = snapshot.objects[name].body
        chain = by_object[name]
        pose = snapshot.configurations[snapshot.initial[name]]
        arrival, since = None, -1
        for motion in chain:
            found.append(Visit(name, body, pose, arrival, motion.activity, since))
            arrival, since, pose = motion.activity, motion.end, motion.poses[-1]
        found.append(Visit(name, body, pose, arrival, None, since))
    return found


def others_first(facts: Facts, service: MotionService, itinerary: Itinerary) -> dict[str, set[str]]:
    """Return for each motion to a place where its object stays for good which motions of others
    have to leave that place before.

    Who leaves again keeps nobody away for long: there, whoever can come first does.
    """
    found: dict[str, set[str]] = defaultdict(set)
    avoid = {m.activity: m.avoid for m in itinerary.motions}
    for pair in _meeting(service, visits_of(facts, itinerary)):
        for one, other in (pair, pair[::-1]):
            if one.departure is not None or one.arrival is None or other.departure is None:
                continue
            listed = avoid[one.arrival]
            if listed is None or other.object in listed:
                found[one.arrival].add(other.departure)
    return found


def contested(facts: Facts, service: MotionService, itinerary: Itinerary) -> set[str]:
    """Return the motions that end where another object has to be, too, at some time."""
    pairs = _meeting(service, visits_of(facts, itinerary))
    return {visit.arrival for pair in pairs for visit in pair if visit.arrival is not None}


def _meeting(service: MotionService, visits: list[Visit]) -> list[tuple[Visit, Visit]]:
    """Return the pairs of visits of two objects whose poses overlap."""
    at: dict[tuple[Body, Configuration], list[Visit]] = defaultdict(list)
    for visit in visits:
        at[visit.body, visit.pose].append(visit)
    found: list[tuple[Visit, Visit]] = []
    for (key, some), (other, others) in itertools.combinations_with_replacement(at.items(), 2):
        if not near(*key, *other) or not service.overlap(*key, *other):
            continue
        if key == other:
            found += itertools.combinations(some, 2)
        else:
            found += itertools.product(some, others)
    return [(a, b) for a, b in found if a.object != b.object]


def near(body: Body, pose: Configuration, other: Body, there: Configuration) -> bool:
    """Return whether two placed bodies may overlap at all: a cheap test before the exact one."""
    if MotionModel.SE3 in (body.kinematics.model, other.kinematics.model):
        return True
    reach = sum(max(math.hypot(*p) for p in b.footprint) for b in (body, other))
    return math.hypot(pose[0] - there[0], pose[1] - there[1]) <= reach
