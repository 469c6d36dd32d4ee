"""Which kernels a problem needs: they are compiled before the clock runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from unified_planning.model.motion import MotionModels, MovableObject, SchedulingMotionProblem

from up_samp.model import MotionModel

if TYPE_CHECKING:
    from up_samp.motion.compile import Compilation


def begin_compiling(problem: SchedulingMotionProblem) -> Compilation:
    """Begin to compile what the problem's bodies need, once per machine, before the clock runs and
    beside the imports.
    """
    from up_samp.motion.compile import begin

    movers = _movers(problem)
    kinds = [o.motion_model for o in movers if isinstance(o.motion_model, MotionModels)]
    models = {MotionModel[k.name] for k in kinds}  # the others are refused by name later
    return begin(models, several=len(movers) > 1)


def _movers(problem: SchedulingMotionProblem) -> set[MovableObject]:
    """Return what is moved by a motion constraint (doors and loads change place in one instant)."""
    moved = (c.movable for a in problem.motion_activities for c in a.motion_constraints)
    return {expression.object() for expression in moved if expression.is_object_exp()}
