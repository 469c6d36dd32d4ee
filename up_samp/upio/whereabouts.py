"""Which fluents tell where objects are: the one reading of it, however a problem writes it.

Sites write ``robot_at(r0)``, ``r0_at`` or ``at_3``, drives that end at a parameter, and values that
mean "on the road" while a robot drives. What they have in common: only what moves an object sets
the fluent, and each drive sets it to where the drive ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from unified_planning.model import Effect, Fluent, FNode, Timing
from unified_planning.model.motion import ActivityWaypoints, MotionActivity, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.upio.movers import settle_movers


def whereabouts(problem: SchedulingMotionProblem) -> Mapping[FNode, str]:
    """Return the ground fluents that tell where an object is, with its name.

    Assumed of each: effects of activities alone set it, all of them move the object, and each sets
    it to the configuration that it brings the object to (beside other values, perhaps).
    """
    settled = settle_movers(problem)
    source = problem if settled is None else settled.problem
    assigned, loose = changes_of(source)
    reached = {activity.name: brought(activity) for activity in source.activities}
    found: dict[FNode, str] = {}
    for fluent, changes in assigned.items():
        set_to: dict[str, set[FNode]] = {}
        for activity, _, effect in changes:
            plain = effect.is_assignment() and effect.condition.is_true()
            set_to.setdefault(activity.name, set()).update([effect.value] if plain else [])
        told = {
            who
            for name, values in set_to.items()
            for who in {o for o, goal in reached[name].items() if goal in values} or {""}
        }
        if fluent.fluent() not in loose and len(told) == 1 and "" not in told:
            (found[fluent],) = told
    return found


FluentChanges = dict[FNode, list[tuple[Activity, Timing, Effect]]]
"""Fluent expression -> what activities do to it, and when."""


def changes_of(problem: SchedulingProblem) -> tuple[FluentChanges, frozenset[Fluent]]:
    """Return what activities change, and the fluents that something sets without an activity, or
    with arguments that are decided.
    """
    found: FluentChanges = {}
    loose = set()
    for timing, effect, activity in problem.all_effects():
        if activity is None or not all(a.is_constant() for a in effect.fluent.args):
            loose.add(effect.fluent.fluent())
        if activity is not None:
            found.setdefault(effect.fluent, []).append((activity, timing, effect))
    return found, frozenset(loose)


def brought(activity: Activity) -> dict[str, FNode]:
    """Return the objects that an activity moves, with the configurations that it brings them to."""
    if not isinstance(activity, MotionActivity):
        return {}
    return {m.object().name: goal for m, goal in _moved(activity) if m.is_object_exp()}


def _moved(activity: MotionActivity) -> Iterator[tuple[FNode, FNode]]:
    told = (c for c in activity.motion_constraints if isinstance(c, ActivityWaypoints))
    yield from ((c.movable, c.waypoints[-1]) for c in told)
    yield from activity.motion_effects.items()
