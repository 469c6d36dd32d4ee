"""Shapes on the floor: corners of footprints and where they are at a pose."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from up_samp.fleet.records import Outline, Pose, RobotType
from up_samp.model import Body, Kinematics, MotionModel

MODELS = {"car": MotionModel.REEDSSHEPP, "omni": MotionModel.SE2}


def corners(outline: Outline) -> list[tuple[float, float]]:
    """Return the corners of a footprint, m."""
    if len(outline) == 2 and not isinstance(outline[0], tuple):
        length, width = outline
        x, y = float(length) / 2, float(width) / 2  # type: ignore[arg-type]
        return [(-x, -y), (x, -y), (x, y), (-x, y)]
    return [(float(x), float(y)) for x, y in outline]  # type: ignore[misc]


def placed(outline: Outline, pose: Pose) -> npt.NDArray[np.float64]:
    """Return an outline's corners at a pose, shape (n, 2)."""
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    return np.asarray([(x + c * u - s * v, y + s * u + c * v) for u, v in corners(outline)])


def body_of(kind: RobotType) -> Body:
    """Return what robots of a type are to the motion planners."""
    model = MODELS[kind.model]
    limits = Kinematics(model, kind.turning_radius, kind.v_max, kind.a_max, kind.omega_max)
    return Body(tuple(corners(kind.footprint)), limits)


def still(outline: Outline) -> Body:
    """Return the body of something that does not drive."""
    return Body(tuple(corners(outline)), Kinematics(MotionModel.SE2))
