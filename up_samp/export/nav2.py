"""A plan as legs for Nav2: for each robot a YAML file with its paths, and what to wait for.

Each leg holds the poses of a ``nav_msgs/Path`` (for ``FollowPath``) or an activity to do. Stamps
inside paths have no agreed meaning, so there are none: ``wait_for`` says what has to happen first.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from up_samp.export.legs import FloatArray, quaternion
from up_samp.export.steps import Step, steps_of
from up_samp.export.vda5050 import file_names
from up_samp.io import PlanDict

SPACING = 0.05
"""Distance (m) between poses of a path, about."""


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``ROBOT.yaml`` for each robot, and ``others.yaml`` where activities need none."""
    written = []
    everything = steps_of(plan)
    names = file_names(everything)
    for robot, steps in everything.items():
        legs = [_leg(number, step) for number, step in enumerate(steps)]
        path = folder / f"{names[robot]}.yaml"
        text = yaml.safe_dump({"robot": robot, "frame_id": "map", "legs": legs}, sort_keys=False)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _leg(number: int, step: Step) -> dict[str, Any]:
    leg: dict[str, Any] = {
        "leg": number,
        "activity": step.activity,
        "wait_for": [{"event": list(w.event), "seconds": w.lag, "why": w.why} for w in step.waits],
        "happens": [list(e) for e in step.happens],
    }
    if step.piece is None:
        return leg | {"do": step.activity, "seconds": step.seconds}
    path = [_pose(row) for row in _spaced(step.piece.rows[:, 1:])]
    return leg | {
        "direction": step.piece.direction,
        "top_speed": round(step.piece.top_speed, 3),
        "path": path,
    }


def _spaced(poses: FloatArray) -> FloatArray:
    """Return poses about :data:`SPACING` m apart, with both ends."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    count = max(1, math.ceil(float(along[-1]) / SPACING))
    wanted = np.linspace(0.0, float(along[-1]), count + 1)
    if along[-1] == 0.0:  # a turn on the spot
        return poses[[0, -1]]
    columns = [np.interp(wanted, along, poses[:, k]) for k in range(3)]
    return np.column_stack(columns)


def _pose(row: FloatArray) -> dict[str, Any]:
    _, _, z, w = quaternion(float(row[2]))
    return {
        "position": {"x": round(float(row[0]), 4), "y": round(float(row[1]), 4)},
        "orientation": {"z": round(z, 6), "w": round(w, 6)},
    }
