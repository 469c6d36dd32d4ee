"""A plan as a recording of ROS 2 messages (MCAP), which Foxglove, Lichtblick and rerun replay.

Topics: ``/map`` (nav_msgs/OccupancyGrid), ``/tf`` (tf2_msgs/TFMessage), ``/footprints`` and
``/activities`` (visualization_msgs/MarkerArray), ``/NAME/path`` (nav_msgs/Path) for each robot.
Times are seconds from the plan's start. Needs the extra ``[mcap]``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from importlib import resources
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np

from up_samp.export.steps import quaternion, robots_of
from up_samp.geometry.maps import OccupancyGrid, load_map
from up_samp.io import PlanDict
from up_samp.io.floors import heights_of, map_at, maps_in_turn, maps_of, named_maps
from up_samp.io.precision import PRECISION
from up_samp.model.frames import PlacedMap
from up_samp.plotting.tracks import ObjectTrack, flat, horizon, tracks_of
from up_samp.system.imports import extra

_RULE = "\n" + "=" * 80 + "\n"
"""Between definitions, as ROS 2 has it."""


def _definitions() -> dict[str, str]:
    """Return by type the definitions of the messages that are written (``pkg/msg/Name``), each
    followed by those of all that it is made of (``pkg/Name``).
    """
    text = resources.files("up_samp.export").joinpath("ros2_messages.txt").read_text("utf-8")
    parts = {}
    for block in text.rstrip().split(_RULE):
        name, _, fields = block.removeprefix("MSG: ").partition("\n")
        parts[name] = fields

    def needed(fields: str) -> Iterator[str]:
        for line in fields.splitlines():
            name = line.split()[0].removesuffix("[]")
            if name in parts:
                yield name
                yield from needed(parts[name])

    return {
        top: _RULE.join([fields, *(f"MSG: {n}\n{parts[n]}" for n in dict.fromkeys(needed(fields)))])
        for top, fields in parts.items()
        if "/msg/" in top
    }


DEFINITIONS = _definitions()


# ------------------ A plan as a recording of ROS 2 messages


FRAME = "map"

Message = dict[str, Any]
Timed = tuple[float, str, str, Message]
"""Time (s), topic, name of the definition, message."""


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``plan.mcap``."""
    with extra("an MCAP file", "mcap", "mcap mcap-ros2-support"):
        from mcap_ros2.writer import Writer
    path = folder / "plan.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas = {name: writer.register_msgdef(name, text) for name, text in DEFINITIONS.items()}
        for time, topic, kind, message in sorted(messages(plan), key=lambda m: m[:2]):
            stamp = round(time * 1e9)
            writer.write_message(topic, schemas[kind], message, stamp, stamp)
        writer.finish()
    return [path]


def messages(plan: PlanDict) -> Iterator[Timed]:
    """Yield all messages, topic by topic."""
    maps = maps_of(plan)
    for placed, name in zip(maps, named_maps(plan), strict=False):
        topic = f"/map/{name}" if len(maps) > 1 else "/map"
        yield 0.0, topic, "nav_msgs/msg/OccupancyGrid", _grid(load_map(placed.file), placed)
    tracks, turns = tracks_of(plan), maps_in_turn(plan)
    for robot in robots_of(plan):
        yield 0.0, f"/{robot}/path", "nav_msgs/msg/Path", _path(plan, robot, turns[robot])
    outlines = list(starmap(_outline, enumerate(tracks)))
    yield 0.0, "/footprints", "visualization_msgs/msg/MarkerArray", {"markers": outlines}
    yield from _transforms(plan, tracks)
    yield from _activities(plan)


def _stamp(time: float) -> Message:
    seconds = math.floor(time)
    return {"sec": seconds, "nanosec": min(999_999_999, round((time - seconds) * 1e9))}


def _header(time: float, frame: str = FRAME) -> Message:
    return {"stamp": _stamp(time), "frame_id": frame}


def _pose(x: float, y: float, yaw: float, z: float = 0.0) -> Message:
    qx, qy, qz, qw = quaternion(yaw)
    return {
        "position": {"x": x, "y": y, "z": z},
        "orientation": {"x": qx, "y": qy, "z": qz, "w": qw},
    }


def _grid(grid: OccupancyGrid, placed: PlacedMap) -> Message:
    cells = grid.occupied.astype(np.int8)
    cells *= 100
    cells[grid.unknown] = -1
    rows, cols = grid.occupied.shape
    x, y, yaw = placed.frame.of(grid.origin)
    return {
        "header": _header(0.0),
        "info": {
            "map_load_time": _stamp(0.0),
            "resolution": float(grid.resolution),
            "width": cols,
            "height": rows,
            "origin": _pose(x, y, yaw, placed.height),
        },
        "data": cells.ravel().tolist(),
    }


def _path(plan: PlanDict, robot: str, maps: Sequence[tuple[float, int]]) -> Message:
    heights = heights_of(plan)
    rows = (row for m in plan["motions"] if m["object"] == robot for row in m["samples"])
    poses = [
        {"header": _header(t), "pose": _pose(*flat(pose), heights[map_at(maps, t)])}
        for t, *pose in sorted(rows)
    ]
    return {"header": _header(0.0), "poses": poses}


def _outline(number: int, track: ObjectTrack) -> Message:
    corners = [*track.footprint, *track.footprint[:1]]
    color = (0.1, 0.5, 0.6) if track.moves else (0.6, 0.3, 0.1)
    return {
        "header": _header(0.0, track.name),
        "ns": "footprints",
        "id": number,
        "type": 4,  # LINE_STRIP
        "action": 0,
        "pose": _pose(0.0, 0.0, 0.0),
        "scale": {"x": 0.05, "y": 0.0, "z": 0.0},
        "color": {"r": color[0], "g": color[1], "b": color[2], "a": 1.0},
        "lifetime": {"sec": 0, "nanosec": 0},
        "frame_locked": True,
        "points": [{"x": x, "y": y, "z": 0.0} for x, y in corners],
        "colors": [],
        "text": track.name,
        "mesh_resource": "",
        "mesh_use_embedded_materials": False,
    }


def _transforms(plan: PlanDict, tracks: list[ObjectTrack]) -> Iterator[Timed]:
    """Yield who is where, at steps of ``PRECISION.step`` s; in between viewers interpolate."""
    end, maps, heights = horizon(plan), maps_in_turn(plan), heights_of(plan)
    for k in range(math.ceil(end / PRECISION.step) + 1):
        time = min(k * PRECISION.step, end)
        placed = []
        for track in tracks:
            pose = track.at(time)
            if pose is not None:
                at = _pose(*pose, heights[map_at(maps[track.name], time)])
                move = {"translation": at["position"], "rotation": at["orientation"]}
                placed.append(
                    {"header": _header(time), "child_frame_id": track.name, "transform": move}
                )
        yield time, "/tf", "tf2_msgs/msg/TFMessage", {"transforms": placed}


def _activities(plan: PlanDict) -> Iterator[Timed]:
    """Yield the names of what goes on, above the robots that do it, whenever that changes."""
    from up_samp.plotting.gantt import rows_of

    rows = [r for r in rows_of(plan) if r.track is not None]
    times = sorted({t for r in rows for b in r.bars for t in (b.start, b.end)})
    for time in times:
        markers = []
        for number, row in enumerate(rows):
            names = [b.labels[0] for b in row.bars if b.start <= time < b.end]
            marker = {
                **_outline(number, row.track),  # type: ignore[arg-type]
                "ns": "activities",
                "type": 9,  # TEXT_VIEW_FACING
                "action": 0 if names else 2,  # 2: delete
                "scale": {"x": 0.0, "y": 0.0, "z": 0.8},
                "points": [],
                "text": ", ".join(names),
            }
            markers.append(marker)
        yield time, "/activities", "visualization_msgs/msg/MarkerArray", {"markers": markers}
