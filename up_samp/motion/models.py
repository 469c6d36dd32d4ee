"""How motions of each motion model are planned: one row each."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from up_samp.model import MotionModel


@dataclass(frozen=True)
class PlannedBy:
    """How motions of one motion model are planned.

    ``planners``: asked in this order when nothing else is asked for, each where the ones before
    found nothing. ``kernels``: the parts that it needs compiled (:mod:`up_samp.motion.compile`).
    ``ompl``: what plans a leg with any of OMPL's planners, as ``module:function``.
    """

    planners: tuple[str, ...]
    kernels: tuple[str, ...] = ()
    ompl: str = ""


_HOME = "up_samp.motion.planners"
MODELS: dict[MotionModel, PlannedBy] = {
    MotionModel.REEDSSHEPP: PlannedBy(
        ("car", "RRTConnect"),
        kernels=("paths", "shortcuts", "bounds", "groups", "knots"),
        ompl=f"{_HOME}.ompl:planar_leg",
    ),
    MotionModel.SE2: PlannedBy(
        ("planar", "RRTConnect"),
        kernels=("planar", "bounds", "groups", "knots"),
        ompl=f"{_HOME}.ompl:planar_leg",
    ),
    MotionModel.PIVOT: PlannedBy(
        ("pivot",),
        kernels=("paths", "shortcuts", "planar", "bounds", "groups", "knots"),
    ),
    MotionModel.SE3: PlannedBy(("se3",), ompl=f"{_HOME}.flyer:flyer_leg"),
    MotionModel.CONTROL: PlannedBy(("control",), ompl=f"{_HOME}.control:control_leg"),
}
"""How each motion model is planned: the one place that a new one is added to, beside what its
bodies can do (:class:`up_samp.model.bodies.Mobility`) and the planner itself.
"""


def made_by(where: str | Callable[..., Any]) -> Any:
    """Return what stands at ``module:name``, imported when it is first asked for."""
    if not isinstance(where, str):
        return where
    module, _, name = where.partition(":")
    return getattr(importlib.import_module(module), name)
