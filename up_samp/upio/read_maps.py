"""Read occupancy maps and their frames of reference.

Poses are in the world frame. A map's reference frame is where the map's own frame, in which its
YAML states the ``origin``, lies in the world: the map is moved by it, the poses are not.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import Configuration, MotionModel, Movable, ProblemError, UnsupportedError
from up_samp.model.errors import short
from up_samp.model.frames import Frame, PlacedMap
from up_samp.upio.limits import LIMITS


def read_maps(
    problem: SchedulingMotionProblem, configurations: Mapping[str, Configuration]
) -> tuple[tuple[PlacedMap, ...], dict[str, int]]:
    """Return a problem's maps, in the order in which its configurations name them, and the number
    of each configuration's map. Maps of types without configurations count if there are no others.
    """
    found: dict[PlacedMap, int] = {}
    map_of = {}
    for name in configurations:
        placed = _placed(problem.object(name).type)
        map_of[name] = found.setdefault(placed, len(found))
    if not found:
        for user_type in problem.user_types:
            if user_type.is_configuration_type():
                found.setdefault(_placed(user_type), len(found))
    return tuple(found), map_of


def check_flat(maps: Sequence[PlacedMap], objects: Mapping[str, Movable]) -> None:
    """Raise :class:`UnsupportedError` where something in space meets several maps."""
    flyers = [n for n, o in objects.items() if o.body.kinematics.model is MotionModel.SE3]
    if len(maps) > 1 and flyers:
        raise UnsupportedError(
            f"object '{min(flyers)}' is in space (SE3) and the problem has several maps "
            f"({', '.join(m.label for m in maps)}): floors are for bodies that move in the plane"
        )


def map_driven(starting: Any, known: Sequence[PlacedMap]) -> int:
    """Return the number of the map that a motion drives on: its starting configuration's (UP
    allows no motion between configurations of two types).
    """
    placed = _placed(starting.type)
    return known.index(placed) if placed in known else 0


def _placed(user_type: Any) -> PlacedMap:
    given = user_type.occupancy_map
    frame, height = _frame(user_type.name, given.reference_frame)
    return PlacedMap(os.fspath(given.filename), frame, height)


def _frame(type_name: str, given: Any) -> tuple[Frame, float]:
    """Return a reference frame: ``SE2``, ``SE3``, or a bare tuple such as ``(0, 0)``."""
    what = f"configuration type '{type_name}': its map's reference frame"
    try:
        values = tuple(float(v) for v in given)
    except (TypeError, ValueError, OverflowError) as error:
        raise ProblemError(f"{what} must be numbers, not {short(given)}") from error
    if len(values) not in (2, 3, 7):
        raise ProblemError(f"{what} has {len(values)} numbers; SE2 has 3, SE3 has 7")
    if not all(math.isfinite(v) and abs(v) <= LIMITS.farthest for v in values):
        raise ProblemError(f"{what} is {short(values)}: up to {LIMITS.farthest:g} m makes sense")
    if len(values) < 7:
        return Frame(*values), 0.0
    x, y, z, qx, qy, qz, qw = values
    if not any(values):
        return Frame(), 0.0
    if abs(math.hypot(qx, qy, qz, qw) - 1.0) > 1e-3:
        raise ProblemError(f"{what} has the quaternion {short(values[3:])}, which is no rotation")
    if max(abs(qx), abs(qy)) > 1e-9:
        raise UnsupportedError(f"{what} is tilted: only turns about the upright axis are supported")
    return Frame(x, y, 2.0 * math.atan2(qz, qw)), z
