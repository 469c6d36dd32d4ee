"""A plan as tables (CSV): the schedule, the trajectories, the changes; and second by second, as
Open-RMF's states of a fleet: where each robot is to be.

Each of these states is a ``fleet_state_update`` of ``rmf_api_msgs`` (JSON Schemas of Open-RMF), as
dashboards read them. Their times are ms from the plan's start.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from up_samp.export.steps import quaternion, robots_of
from up_samp.io import PlanDict
from up_samp.io.floors import map_at, map_number, maps_in_turn, maps_of, named_maps, own_frames
from up_samp.io.precision import PRECISION
from up_samp.io.sampling import in_formation

if TYPE_CHECKING:
    from up_samp.plotting.gantt import Row

Cell = str | float


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``schedule.csv`` (s), ``trajectories.csv`` (s, m, rad; also of robots that keep
    formation with others) and ``changes.csv``, which name the map of each pose where there are
    several.
    """
    unit = plan["seconds_per_unit"]
    motions, driven = [*plan["motions"], *in_formation(plan)], dict[str, list[str]]()
    for motion in motions:
        driven.setdefault(motion["activity"], []).append(motion["object"])
    schedule = [
        (a["name"], a["start"] * unit, a["end"] * unit, " ".join(driven.get(a["name"], ())))
        for a in plan["activities"]
    ]
    spatial = any(len(m["samples"][0]) == 8 for m in plan["motions"])
    pose = ("x", "y", "z", "qx", "qy", "qz", "qw") if spatial else ("x", "y", "theta")
    labels = [m.label for m in maps_of(plan)]
    several = len(labels) > 1

    def where(entry: Mapping[str, Any]) -> list[str]:
        """Return the map that poses are on, where there are several."""
        return labels[map_number(entry) :][:several]

    rows = [
        (m["object"], m["activity"], *where(m), *_spatial(row, spatial=spatial))
        for m in motions
        for row in m["samples"]
    ]
    changes = [
        (
            c["object"],
            c["activity"],
            *where(c),
            *_spatial([c["time"], *c["configuration"]], spatial=spatial),
        )
        for c in plan["changes"]
    ]
    head = ("object", "activity", *["map"][:several], "t", *pose)
    return [
        _write(folder / "schedule.csv", ("activity", "start", "end", "drives"), schedule),
        _write(folder / "trajectories.csv", head, rows),
        _write(folder / "changes.csv", head, changes),
    ]


def _spatial(row: Sequence[float], *, spatial: bool) -> list[float]:
    """Return a row ``[t, *pose]`` with the pose of a body in the plane told in space, if asked."""
    if not spatial or len(row) == 8:
        return list(row)
    return [row[0], row[1], row[2], 0.0, *quaternion(row[3])]


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path


# ------------------ States of an Open-RMF fleet


def export_states(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``fleet_states.jsonl``: a line for every second, and one for the end."""
    from up_samp.plotting.gantt import rows_of  # matplotlib is slow

    end = plan["makespan"] * plan["seconds_per_unit"]
    rows = {row.name: row for row in rows_of(plan) if row.track is not None}
    robots = [rows[name] for name in robots_of(plan)]
    turns, frames, maps = maps_in_turn(plan), own_frames(plan), list(named_maps(plan))

    def location(row: Row, time: float) -> dict[str, Any]:
        """Return where a robot is, in the frame of its map's file."""
        assert row.track is not None
        pose = row.track.at(time)
        assert pose is not None, f"{row.name} drives, so it has a place at first"
        number = map_at(turns[row.name], time)
        x, y, yaw = (round(v, PRECISION.decimals) for v in frames[number].of(pose))
        return {"map": maps[number], "x": x, "y": y, "yaw": yaw}

    path = folder / "fleet_states.jsonl"
    with path.open("w", encoding="utf-8") as file:
        for k in range(math.ceil(end) + 1):
            time = min(float(k), end)
            states = {
                row.name: _state(plan, row, time) | {"location": location(row, time)}
                for row in robots
            }
            data = {"name": plan["problem"], "robots": states}
            file.write(json.dumps({"type": "fleet_state_update", "data": data}) + "\n")
    return [path]


def _state(plan: PlanDict, row: Row, time: float) -> dict[str, Any]:
    """Return what a robot is to do at a time (s)."""
    doing = next((bar.activity for bar in row.bars if bar.start <= time < bar.end), "")
    told = plan.get("words", {}).get("actions", {}).get(doing, {})
    status = "charging" if told.get("type") == "startCharging" else "working" if doing else "idle"
    return {
        "name": row.name,
        "status": status,
        "task_id": told.get("parameters", {}).get("for") or doing,
        "unix_millis_time": round(1000 * time),
        "issues": [],
    }
