"""Where activities without a drive of their own are done, as their conditions say.

A fluent that every drive of a robot sets to where it ends tells where that robot is. An activity
with the condition that it equals some place is done there, by that robot.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model.snapshot import Snapshot, TermKind

Stand = tuple[str, str]
"""A robot and the configuration in which it is."""


def stands_of(problem: SchedulingMotionProblem, snapshot: Snapshot) -> dict[str, Stand]:
    """Return who is where during the activities whose conditions tell that.

    Assumes: a condition holds all through an activity, and its fluent tells where one robot is.
    """
    whose = _whereabouts(problem, snapshot)
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


def _whereabouts(problem: SchedulingMotionProblem, snapshot: Snapshot) -> Mapping[FNode, str]:
    """Return the fluents that tell where a robot is: all its drives set them to where they end."""
    drives: dict[str, dict[str, str]] = defaultdict(dict)
    for task in snapshot.tasks:
        if task.terms[-1].kind is TermKind.CONSTANT:
            drives[task.activity][task.object] = task.terms[-1].name
    told: dict[FNode, set[str]] = defaultdict(set)
    for activity in problem.activities:
        for effects in activity.effects.values():
            for effect in effects:
                if not (effect.is_assignment() and effect.value.is_object_exp()):
                    continue
                place = effect.value.object().name
                mine = [r for r, goal in drives.get(activity.name, {}).items() if goal == place]
                told[effect.fluent] |= set(mine) or {""}
    return {
        fluent: next(iter(who)) for fluent, who in told.items() if len(who) == 1 and "" not in who
    }


def stand_told(condition: FNode, whose: Mapping[FNode, str]) -> Stand | None:
    """Return what a condition of the form "fluent equals place" tells."""
    if condition.node_type is not Op.EQUALS:
        return None
    for fluent, place in (condition.args, condition.args[::-1]):
        if fluent in whose and place.is_object_exp():
            return whose[fluent], place.object().name
    return None
