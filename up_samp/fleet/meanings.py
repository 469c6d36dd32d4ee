"""Meanings of the activities of a fleet's UP problem, what its site calls them, and constraints
that several parts state of them in one way.
"""

from __future__ import annotations

import enum
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import LE, Not, Or

from up_samp.fleet.loads import MARK
from up_samp.fleet.records import FleetRecords
from up_samp.upio.expressions import present


class Kind(enum.Enum):
    """What happens in an activity, or what a robot is at a place for."""

    START = "start"
    END = "end"
    PARK = "park"
    MOVE = "move"
    CARRY = "carry"
    RIDE = "ride"
    PICKUP = "pick"
    DELIVERY = "deliver"
    TASK = "task"
    OPEN = "open"
    CLOSE = "close"
    CHARGE = "charge"
    BREAK = "break"
    SKIP = "skip"
    LEAVE = "leave out"


@dataclass(frozen=True)
class Meaning:
    """``what`` (an order, a task, a door, a charger's place; none for moves) happens, by ``robot``
    (none: by no robot).
    """

    kind: Kind
    what: str = ""
    robot: str = ""


@dataclass(frozen=True, eq=False)
class Written:
    """A fleet's UP problem, and what its activities (by name) stand for."""

    problem: SchedulingMotionProblem
    meanings: Mapping[str, Meaning]

    def happening(self, activities: Iterable[Mapping[str, Any]]) -> Iterator[tuple[Meaning, Any]]:
        """Yield what a plan's ``activities`` (dictionaries) stand for, with each of them."""
        return ((self.meanings[a["name"]], a) for a in activities)


# ------------------ What several parts of a fleet problem state of activities, in one way


def only_with(problem: SchedulingMotionProblem, a: Activity, b: Activity) -> None:
    """State that ``a`` is there only where ``b`` is."""
    problem.add_constraint(Or(Not(a.present), b.present))


def together(
    problem: SchedulingMotionProblem, some: Sequence[Activity], others: Sequence[Activity]
) -> None:
    """State that one of ``some`` is there where one of ``others`` is, and the other way round."""
    for a in some:
        problem.add_constraint(Or(Not(a.present), *(b.present for b in others)))
    for b in others:
        problem.add_constraint(Or(Not(b.present), *(a.present for a in some)))


def ends_before(problem: SchedulingMotionProblem, a: Activity, b: Activity) -> None:
    """State that ``a`` ends before ``b`` starts, where both are there."""
    problem.add_constraint(LE(a.end, b.start), present(a, b))


def exactly_one(problem: SchedulingMotionProblem, activities: Sequence[Activity]) -> None:
    """State that one of ``activities`` is there, and no two are."""
    problem.add_constraint(Or([a.present for a in activities]))
    for a, b in itertools.combinations(activities, 2):
        problem.add_constraint(Or(Not(a.present), Not(b.present)))


def one_at_a_time(
    problem: SchedulingMotionProblem, who: str, activities: Sequence[Activity]
) -> None:
    """State that no two of ``activities`` overlap: they take a resource of one unit."""
    if len(activities) > 1:
        busy = problem.add_resource(f"busy{MARK}{who}", 1)
        for a in activities:
            a.uses(busy)


# ------------------ A site's own words for what its robots do, and where: for exports


ACTIONS = {Kind.PICKUP: "pick", Kind.DELIVERY: "drop", Kind.CHARGE: "startCharging"}
"""What VDA 5050 calls it, where the site says nothing else; the others are their kinds."""
_STOPS = {Kind.PICKUP: "pickup", Kind.DELIVERY: "delivery"}


def words_of(records: FleetRecords, written: Written) -> dict[str, Any]:
    """Return ``actions``, by activity its ``type`` and ``parameters`` (what it is ``for``), and
    ``places``, by name their pose in the world frame and the ``height`` of their floor (m).
    """
    heights = {name: floor.height for name, floor in records.floors.items()}
    return {
        "actions": {
            name: {"type": _action(records, meaning), "parameters": {"for": meaning.what}}
            for name, meaning in written.meanings.items()
        },
        "places": {
            name: {"pose": list(place.pose), "height": heights.get(place.floor, 0.0)}
            for name, place in records.places.items()
        },
    }


def _action(records: FleetRecords, meaning: Meaning) -> str:
    """Return what the site calls it: what its file says, or what is usual."""
    job = records.job_of.get(meaning.what)
    part = getattr(job, _STOPS.get(meaning.kind, ""), job)
    return getattr(part, "action", None) or ACTIONS.get(meaning.kind, meaning.kind.value)
