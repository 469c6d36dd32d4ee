"""Where activities without a drive of their own are done, as their conditions say.

An activity with the condition that a robot's fluent (:mod:`up_samp.upio.whereabouts`) equals some
place is done there, by that robot.
"""

from __future__ import annotations

from collections.abc import Mapping

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model.snapshot import Snapshot
from up_samp.upio.whereabouts import whereabouts

Stand = tuple[str, str]
"""A robot and the configuration in which it is."""


def stands_of(problem: SchedulingMotionProblem, snapshot: Snapshot) -> dict[str, Stand]:
    """Return who is where during the activities whose conditions tell that.

    Assumes: a condition holds all through an activity, and its fluent tells where one robot is.
    """
    drivers = {task.object for task in snapshot.tasks}
    whose = {f: who for f, who in whereabouts(problem).items() if who in drivers}
    found: dict[str, Stand] = {}
    driving = {task.activity for task in snapshot.tasks}
    for activity in problem.activities:
        if activity.name in driving:
            continue
        told = {
            stand
            for conditions in activity.conditions.values()
            for condition in conditions
            if (stand := stand_told(condition, whose)) is not None
        }
        if len(told) == 1:
            (found[activity.name],) = told
    return found


def stand_told(condition: FNode, whose: Mapping[FNode, str]) -> Stand | None:
    """Return what a condition of the form "fluent equals place" tells."""
    if condition.node_type is not Op.EQUALS:
        return None
    for fluent, place in (condition.args, condition.args[::-1]):
        if fluent in whose and place.is_object_exp():
            return whose[fluent], place.object().name
    return None
