"""A plan as legs for Nav2: for each robot a YAML file with its paths, and what to wait for.

Each leg holds a ``nav_msgs/Path`` (for ``FollowPath``), field by field, or an activity to do. A
path's stamps are when the plan has the robot there, from its start; Nav2 does not heed them, so
``wait_for`` says what has to happen first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from up_samp.export.legs import FloatArray, quaternion
from up_samp.export.steps import RobotStep, steps_of
from up_samp.export.vda5050 import file_names
from up_samp.io import PlanDict
from up_samp.io.floors import named_maps
from up_samp.io.precision import PRECISION


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``ROBOT.yaml`` for each robot, and ``others.yaml`` where activities need none."""
    written = []
    everything = steps_of(plan)
    names, maps = file_names(everything), named_maps(plan)
    for robot, steps in everything.items():
        legs = [_leg(number, step, list(maps)) for number, step in enumerate(steps)]
        path = folder / f"{names[robot]}.yaml"
        whole = {"robot": robot, "frame_id": "map", "maps": maps, "legs": legs}
        text = yaml.safe_dump(whole, sort_keys=False)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written


def _leg(number: int, step: RobotStep, maps: Sequence[str]) -> dict[str, Any]:
    leg: dict[str, Any] = {
        "leg": number,
        "activity": step.activity,
        "wait_for": [{"event": list(w.event), "seconds": w.lag, "why": w.why} for w in step.waits],
        "happens": [list(e) for e in step.happens],
    }
    if step.lands:
        row = np.array([0.0, *step.lands])
        leg["lands"] = {"map": maps[step.floor], "pose": _pose(row)["pose"]}
    if step.piece is None:
        return leg | {"do": step.activity, "seconds": step.seconds}
    poses = [_pose(row) for row in _spaced(step.piece.rows)]
    return leg | {
        "map": maps[step.floor],
        "direction": step.piece.direction,
        "top_speed": round(step.piece.top_speed, 3),
        "path": {"header": poses[0]["header"], "poses": poses},
    }


def _spaced(rows: FloatArray) -> FloatArray:
    """Return rows (t, x, y, theta) about ``PRECISION.spacing`` m apart, with both ends."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rows[:, 1:3], axis=0).T))])
    count = max(1, math.ceil(float(along[-1]) / PRECISION.spacing))
    wanted = np.linspace(0.0, float(along[-1]), count + 1)
    if along[-1] == 0.0:  # a turn on the spot
        return rows[[0, -1]]
    columns = [np.interp(wanted, along, rows[:, k]) for k in range(4)]
    return np.column_stack(columns)


def _pose(row: FloatArray) -> dict[str, Any]:
    """Return a row (t, x, y, theta) as the fields of a ``geometry_msgs/PoseStamped``."""
    _, _, z, w = quaternion(float(row[3]))
    nanoseconds = round(1e9 * float(row[0]))
    stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
    return {
        "header": {"stamp": stamp, "frame_id": "map"},
        "pose": {
            "position": {"x": round(float(row[1]), 4), "y": round(float(row[2]), 4)},
            "orientation": {"z": round(z, 6), "w": round(w, 6)},
        },
    }
