"""Obstacles given by fluents: what a static one's fluent says must be where it is.

A static obstacle rests at its fluent's value all through a motion. Where the fluent is the
object's state and is set a unit early, the two agree at every instant. Where it is set at the end
of what moves the object, they differ for one instant, and the motion must not start just then.
Any other fluent is compared with the state at the motion's start, and stays until its end.
Dynamic obstacles' fluents ask nothing more (``up_samp.validation.semantics``, rule 19).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from unified_planning.model import Fluent, FNode, Object, Timing
from unified_planning.model.motion import MotionActivity
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import RightOpenTimeInterval, TimePointInterval

from up_samp.model import ProblemError

if TYPE_CHECKING:
    from up_samp.upio.relaxation import Relaxation


def hold_told(relaxation: Relaxation, source: MotionActivity) -> None:
    """State for a motion activity of the problem what its static obstacles' fluents ask."""
    activity = relaxation.activities[source.name]
    for constraint in source.motion_constraints:
        told = constraint.static_obstacles
        if not isinstance(told, dict):
            continue
        for movable, value in told.items():
            node = told_by(source.name, movable, value)
            _hold(relaxation, activity, movable.name, relaxation.rewriter(node))


def told_by(activity: str, obstacle: Object, value: Any) -> FNode:
    """Return the expression that tells where an obstacle is: what the problem gives, and a fluent
    of one parameter that is the obstacle, of that obstacle.

    :raises ProblemError: for a fluent of other parameters.
    """
    if not isinstance(value, Fluent):
        return obstacle.environment.expression_manager.auto_promote(value)[0]
    types = [p.type for p in value.signature]
    if not types:
        return value()
    if len(types) == 1 and types[0].is_compatible(obstacle.type):
        return value(obstacle)
    raise ProblemError(
        f"activity '{activity}': the fluent '{value.name}' of its obstacle '{obstacle.name}' has "
        f"{len(types)} parameters; say which, as in {value.name}(...)"
    )


def _hold(relaxation: Relaxation, activity: Activity, name: str, told: FNode) -> None:
    manager = relaxation.problem.environment.expression_manager
    state = relaxation.state.get(name)
    if state is not None and told == state:
        if not relaxation.early[name]:
            _not_just_set(relaxation, activity, name)
        return
    place: FNode
    if state is not None:
        place = state
    elif name in relaxation.snapshot.initial:
        place = manager.ObjectExp(relaxation.problem.object(relaxation.snapshot.initial[name]))
    else:
        return
    equal = manager.Equals(told, place)
    activity.add_condition(TimePointInterval(Timing(0, activity.start)), equal)
    span = RightOpenTimeInterval(Timing(0, activity.start), Timing(-1, activity.end))
    activity.add_condition(span, equal)


def _not_just_set(relaxation: Relaxation, activity: Activity, name: str) -> None:
    """Let ``activity`` not start at the very instant at which the object is set elsewhere."""
    manager = relaxation.problem.environment.expression_manager
    snapshot = relaxation.snapshot
    for other in sorted(snapshot.movers[name] - {activity.name}):
        rival = relaxation.activities[other]
        apart = manager.Or(
            manager.LT(rival.end, activity.start), manager.LT(activity.start, rival.end)
        )
        scope = [a.present for a in (activity, rival) if a.optional]
        relaxation.problem.add_constraint(apart, scope)
