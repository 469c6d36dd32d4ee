"""Who plans for what: motion planners by name, imported when they are needed."""

from __future__ import annotations

import functools
import importlib.util
import logging
from collections.abc import Callable

from up_samp.extensions import parts
from up_samp.geometry import Scene
from up_samp.model import Body, ProblemError, UnsupportedError
from up_samp.motion.models import MODELS, made_by
from up_samp.motion.protocol import MotionPlanner

log = logging.getLogger(__name__)

Factory = Callable[[Scene, int], MotionPlanner]

PLANNERS: dict[str, str | Factory] = {
    "car": "up_samp.motion.planners.car:CarPlanner",
    "pivot": "up_samp.motion.planners.car:PivotPlanner",
    "planar": "up_samp.motion.planners.omni:PlanarPlanner",
    "se3": "up_samp.motion.planners.ompl:flyer_planner",
    "control": "up_samp.motion.planners.ompl:control_planner",
}
"""Planners by name: ``module:factory`` (imported when needed) or a factory(scene, seed). Beside
these, OMPL's planners are known by their own names (see :mod:`up_samp.motion.planners.ompl`), and
those from outside (:mod:`up_samp.extensions`); one of these that has a ``default_for`` plans for
these motion models, one that has a ``quick`` has a form of it that gives up after little work.
"""


def make_planner(name: str, scene: Scene, seed: int) -> MotionPlanner:
    """Return the planner called ``name`` for a scene."""
    planners = PLANNERS | parts("planners")
    if name not in planners:
        from up_samp.motion.planners.ompl import PLANNERS as OMPL
        from up_samp.motion.planners.ompl import OmplPlanner

        try:
            return OmplPlanner(name, scene, seed)
        except ProblemError as error:
            known = ", ".join((*sorted(planners), *OMPL))
            raise ProblemError(
                f"there is no motion planner '{name}'; known are default, {known}"
            ) from error
    planner: MotionPlanner = made_by(planners[name])(scene, seed)
    return planner


def planner_names(name: str, body: Body) -> tuple[str, ...]:
    """Return which planners to ask for ``body``, in order (``"default"``: by its motion model)."""
    known = PLANNERS | parts("planners")
    if name != "default":
        if body.kinematics.ways and name not in known:
            raise UnsupportedError(
                f"the motion planner '{name}' knows of no zones with a direction, or without turns"
            )
        return (name,)
    model = body.kinematics.model
    added = parts("planners").items()
    replaced = {m: n for n, made in added for m in getattr(made, "default_for", ())}
    first, *others = MODELS[model].planners
    if body.kinematics.ways or (others and not has_ompl()):
        others = [n for n in others if n in PLANNERS]
    return (replaced.get(model, first), *others)


@functools.cache
def has_ompl() -> bool:
    """Return whether OMPL is installed; say once what is left out where it is not."""
    if importlib.util.find_spec("ompl") is not None:
        return True
    log.warning("OMPL is not installed: no second opinions where a motion planner finds nothing")
    return False
