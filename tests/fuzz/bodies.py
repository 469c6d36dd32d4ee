"""Bodies of robots and loads of random problems: footprints, meshes, how they move."""

from __future__ import annotations

import functools
import math

from unified_planning.model.motion import MotionModels

BOX = ((-0.35, -0.25), (0.35, -0.25), (0.35, 0.25), (-0.35, 0.25))
LONG = ((-0.5, -0.2), (0.5, -0.2), (0.5, 0.2), (-0.5, 0.2))
SQUARE = ((-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3))
FOOTPRINTS = {"box": BOX, "long": LONG, "square": SQUARE}
CRATE = ((-0.15, -0.2), (0.15, -0.2), (0.15, 0.2), (-0.15, 0.2))
LIMITS = {"v_max": 1.0, "a_max": 0.5}
BODIES = {
    "car": {
        "motion_model": MotionModels.REEDSSHEPP,
        "motion_parameters": LIMITS | {"turning_radius": 0.6},
    },
    "pivot": {
        "motion_model": MotionModels.REEDSSHEPP,
        "motion_parameters": LIMITS | {"turning_radius": 0.0},
    },
    "omni": {"motion_model": MotionModels.SE2, "motion_parameters": LIMITS},
    "bicycle": {
        "motion_model": MotionModels.REEDSSHEPP,
        "motion_parameters": LIMITS,
        "control_parameters": {"v_min": -1.0, "v_max": 1.0, "phi_min": -0.8, "phi_max": 0.8},
    },
}
"""How robots move; flyers (see :func:`flyer`) are in the air, all of them."""


def planar_body(moves: str, shape: str) -> dict:
    """Return the body of a robot that drives: how it moves, and its footprint."""
    corners = list(FOOTPRINTS[shape])
    given = {"footprint": corners, **BODIES[moves]}
    if moves == "bicycle":
        length = max(x for x, _ in corners) - min(x for x, _ in corners)
        given["control_model"] = functools.partial(_bicycle, length)
    return given


def _bicycle(length: float, q, u, qdot) -> None:
    qdot[0], qdot[1] = u[0] * math.cos(q[2]), u[0] * math.sin(q[2])
    qdot[2] = u[0] * math.tan(u[1]) / length


def flyer(folder, shape: str) -> dict:
    """Return the body of a flyer as large as a footprint; its mesh is written into ``folder``."""
    import trimesh

    corners = FOOTPRINTS[shape]
    size = (2 * corners[1][0], 2 * corners[2][1], 0.3)
    file = folder / f"{shape}.stl"
    if not file.exists():
        trimesh.creation.box(size).export(file)
    return {
        "geometric_model": str(file),
        "motion_model": MotionModels.SE3,
        "motion_parameters": LIMITS | {"omega_max": 1.0},
    }
