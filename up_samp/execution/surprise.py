"""What has changed on the floor, and what is left of the problem then."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Schedule

from up_samp.execution.state import Phase, State
from up_samp.model import Configuration, ProblemError
from up_samp.scheduling.partial_order.differences import Planned

Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Surprise:
    """What has changed on the floor. ``broken`` maps robots that are out of order to where they
    stand, ``cancelled`` and ``shut`` name activities, and objects that stay where they are; ``new``
    are functions that add tasks to the problem. ``same_choices``: who does what stays as planned
    (optional activities that the plan leaves out stay out), which is much quicker to solve.
    """

    broken: Mapping[str, Pose] = field(default_factory=dict)
    cancelled: Sequence[str] = ()
    shut: Sequence[str] = ()
    new: Sequence[Callable[[SchedulingMotionProblem], None]] = ()
    same_choices: bool = False


@dataclass(frozen=True)
class Remaining:
    """``problem`` starts at ``since`` (units of the old clock), with robots standing at ``poses``.

    Robots under way stop there: these are the points at which they can. ``hint`` is what is left of
    the old plan, as a UP schedule of the new problem. ``notes`` say which constraints fell away.
    ``params`` are parameters of an engine that the new plan has to have in common with the old one:
    the length of a unit, and the clearance.
    """

    problem: SchedulingMotionProblem
    since: int
    poses: Mapping[str, Configuration]
    stops: Mapping[str, float]
    """How far robots under way still go in the motion that they are in (m), before they stand."""
    hint: Schedule | None
    notes: tuple[str, ...]
    params: Mapping[str, float] = field(default_factory=dict)


def check_names(surprise: Surprise, source: SchedulingMotionProblem, state: State) -> None:
    """Raise :class:`ProblemError` where a surprise speaks of what is not there, or has begun."""
    activities = {a.name for a in source.activities}
    objects = {o.name for o in source.all_objects}
    for name in surprise.cancelled:
        if name not in activities:
            raise ProblemError(f"cancelled '{name}' is no activity of '{source.name}'")
        if state.phase.get(name) in (Phase.DONE, Phase.RUNNING):
            raise ProblemError(f"'{name}' cannot be cancelled: it has begun")
    for name in (*surprise.broken, *surprise.shut):
        if name not in objects:
            raise ProblemError(f"'{name}' is no object of '{source.name}'")


def rest_of_plan(
    target: SchedulingMotionProblem, planned: Planned, state: State, since: int
) -> Schedule | None:
    """Return the rest of the old plan on the new clock, to begin from (it need not be valid);
    ``None`` where it lacks something that has to be done.
    """
    here = [a for a in target.activities if a.name in planned.times]
    wanted = {a.name for a in target.activities if not a.optional}
    if not wanted <= {a.name for a in here}:
        return None
    if any(a.parameters for a in here) or target.base_variables:
        return None
    assignment: dict[Any, Any] = {}
    for activity in here:
        start, end = planned.times[activity.name]
        begun = state.phase[activity.name] is Phase.RUNNING
        first = 0 if begun else max(0, start - since)
        assignment[activity.start] = first
        assignment[activity.end] = first + (max(1, end - since) if begun else end - start)
    return Schedule(here, assignment, target.environment)
