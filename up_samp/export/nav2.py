"""A plan as legs for Nav2: for each robot a YAML file with its paths, and what to wait for.

Each leg holds a ``nav_msgs/Path`` (for ``FollowPath``), field by field, or an activity to do. A
path's stamps are when the plan has the robot there, from its start; Nav2 does not heed them, so
``wait_for`` says what has to happen first. Legs that nobody waits between are one behaviour tree,
in a file of its own: nodes and ports are those of Nav2's ``nav2_tree_nodes.xml``, and paths are
written as ``convertFromString`` of its ``bt_utils.hpp`` reads them.
:mod:`up_samp.export.follow_legs` drives the legs without trees, and goes along as it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from importlib import resources
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from up_samp.execution.files import event_to_list
from up_samp.execution.graph import Event
from up_samp.export.steps import RobotStep, quaternion, steps_of
from up_samp.export.vda5050 import file_names
from up_samp.io import PlanDict
from up_samp.io.floors import named_maps
from up_samp.io.precision import PRECISION
from up_samp.model.arrays import FloatArray


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``ROBOT.yaml`` for each robot, and ``others.yaml`` where activities need none; the
    robots' trees, ``ROBOT/tree-NNN.xml``; and ``follow_legs.py``.
    """
    written = []
    everything = steps_of(plan)
    names, maps = file_names(everything), named_maps(plan)
    awaited = {w.event for steps in everything.values() for step in steps for w in step.waits}
    for robot, steps in everything.items():
        legs = [_leg(number, step, list(maps)) for number, step in enumerate(steps)]
        for number, tree in enumerate(_trees(steps, awaited) if robot else ()):
            path = folder / names[robot] / f"tree-{number:03}.xml"
            path.parent.mkdir(exist_ok=True)
            path.write_text(_tree([legs[k] for k in tree]), encoding="utf-8")
            written.append(path)
            for k in tree:
                legs[k]["tree"] = f"{names[robot]}/{path.name}"
        path = folder / f"{names[robot]}.yaml"
        whole = {"robot": robot, "frame_id": "map", "maps": maps, "legs": legs}
        text = yaml.safe_dump(whole, sort_keys=False)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    script = resources.files("up_samp.export").joinpath("follow_legs.py").read_text("utf-8")
    written.append(folder / "follow_legs.py")
    written[-1].write_text(script, encoding="utf-8")
    return written


def _trees(steps: Sequence[RobotStep], awaited: Set[Event]) -> list[list[int]]:
    """Return the numbers of the steps of each tree: it waits for others before its first step
    alone, and others for nothing but its begin and its end. Rides are in none: no node of Nav2's
    changes maps.
    """
    found: list[list[int]] = []
    joined = False
    for number, step in enumerate(steps):
        if step.lands:
            joined = False
            continue
        if joined and not step.waits and awaited.isdisjoint(step.begins):
            found[-1].append(number)
        else:
            found.append([number])
        joined = awaited.isdisjoint(step.happens)
    return found


def _tree(legs: Sequence[Mapping[str, Any]]) -> str:
    """Return legs as a tree of BehaviorTree.CPP 4; what is done on the spot is waited for."""
    root = ElementTree.Element("root", BTCPP_format="4", main_tree_to_execute="legs")
    tree = ElementTree.SubElement(root, "BehaviorTree", ID="legs")
    sequence = ElementTree.SubElement(tree, "Sequence")
    for leg in legs:
        title = f"leg {leg['leg']}: {leg['activity']}"
        if "path" not in leg:
            seconds = str(leg["seconds"])
            ElementTree.SubElement(sequence, "Wait", name=title, wait_duration=seconds)
            continue
        poses = [";".join(map(str, _fields(p["pose"]))) for p in leg["path"]["poses"]]
        path = ";".join(["0", "map", *poses])
        ElementTree.SubElement(sequence, "FollowPath", name=title, path=path)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _fields(pose: Mapping[str, Any]) -> list[Any]:
    """Return a stamp of no time, a frame, a position and a quaternion, as trees have poses."""
    at, turn = pose["position"], pose["orientation"]
    return [0, "map", at["x"], at["y"], 0.0, 0.0, 0.0, turn["z"], turn["w"]]


def _leg(number: int, step: RobotStep, maps: Sequence[str]) -> dict[str, Any]:
    leg: dict[str, Any] = {
        "leg": number,
        "activity": step.activity,
        "wait_for": [wait.told for wait in step.waits],
        "begins": [*map(event_to_list, step.begins)],
        "happens": [*map(event_to_list, step.happens)],
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
