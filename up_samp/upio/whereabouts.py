"""Which fluents tell where objects are: the one reading of it, however a problem writes it.

Sites write ``robot_at(r0)``, ``r0_at`` or ``at_3``, drives that end at a parameter, and values that
mean "on the road" while a robot drives. What they have in common: only what moves an object sets
the fluent, and each drive sets it to where the drive ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from unified_planning.model import FNode
from unified_planning.model.motion import ActivityWaypoints, MotionActivity, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.upio.movers import settle_movers


def whereabouts(problem: SchedulingMotionProblem) -> Mapping[FNode, str]:
    """Return the ground fluents that tell where an object is, with its name.

    Assumed of each: effects of activities alone set it, all of them move the object, and each sets
    it to the configuration that it brings the object to (beside other values, perhaps).
    """
    settled = settle_movers(problem)
    source = problem if settled is None else settled.problem
    loose = {effect.fluent.fluent() for _, effect in source.base_effects}
    told: dict[FNode, set[str]] = {}
    for activity in source.activities:
        reached = brought(activity)
        set_to: dict[FNode, set[FNode]] = {}
        for effects in activity.effects.values():
            for effect in effects:
                plain = effect.is_assignment() and effect.condition.is_true()
                set_to.setdefault(effect.fluent, set()).update([effect.value] if plain else [])
        for fluent, values in set_to.items():
            if not all(a.is_object_exp() for a in fluent.args):
                loose.add(fluent.fluent())
            told.setdefault(fluent, set()).update(
                {who for who, goal in reached.items() if goal in values} or {""}
            )
    return {
        fluent: next(iter(who))
        for fluent, who in told.items()
        if len(who) == 1 and "" not in who and fluent.fluent() not in loose
    }


def brought(activity: Activity) -> dict[str, FNode]:
    """Return the objects that an activity moves, with the configurations that it brings them to."""
    if not isinstance(activity, MotionActivity):
        return {}
    return {m.object().name: goal for m, goal in _moved(activity) if m.is_object_exp()}


def _moved(activity: MotionActivity) -> Iterator[tuple[FNode, FNode]]:
    for constraint in activity.motion_constraints:
        if isinstance(constraint, ActivityWaypoints):
            yield constraint.movable, constraint.waypoints[-1]
    yield from activity.motion_effects.items()
