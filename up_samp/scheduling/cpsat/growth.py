"""May a model grow by what was appended to its problem, or has it to be built anew?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.durations import constant_bounds, constants, least
from up_samp.scheduling.cpsat.problem import Additions

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


def only_tightened(model: ScheduleModel, parts: Additions) -> bool:
    """Return whether every schedule of the problem was one before (bounds stay valid).

    New effects may support conditions, new objects widen domains, longer durations may end
    what shorter ones may not, and new activities move the global end for what speaks of it.

    Assumes: what is appended takes schedules away: no effects, objects or longer reach of
    durations.
    """
    if parts.rewritten or parts.effects or parts.new_objects:
        return False
    if parts.activities and (model.states.final is not None or model.world.makespan_used):
        return False
    return all(model.variables.narrower(a) for a in parts.durations)


def can_grow(model: ScheduleModel, parts: Additions) -> bool:
    """Return whether the additions fit into the model as it is."""
    if not only_tightened(model, parts):
        return False
    if any(None in constant_bounds(a.duration) for a in parts.activities):
        return False
    horizon = model.horizon
    before = horizon.bound()
    for activity in parts.activities:
        horizon.total += 2 * (4 + least(activity.duration))
    for span, _, _ in parts.conditions:
        horizon.beside(int(abs(span.lower.delay) + abs(span.upper.delay)))
    for activity in parts.durations:
        horizon.total += least(activity.duration)
    horizon.total += sum(constants(c) for c, _, _ in parts.constraints)
    return horizon.bound() <= max(model.limit, before)
