"""A plan as Open-RMF's states of a fleet: where each robot is to be, second by second.

Each line is a ``fleet_state_update`` of ``rmf_api_msgs`` (JSON Schemas of Open-RMF), as dashboards
read them. Times are ms from the plan's start.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from up_samp.export.legs import robots_of
from up_samp.io import PlanDict
from up_samp.io.floors import map_at, maps_in_turn, named_maps, own_frames
from up_samp.io.precision import PRECISION
from up_samp.plotting.rows import Row, rows_of


def export(plan: PlanDict, folder: Path, step: float = 1.0) -> list[Path]:
    """Write ``fleet_states.jsonl``: a line for every ``step`` s, and one for the end."""
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
        for k in range(math.ceil(end / step) + 1):
            time = min(k * step, end)
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
