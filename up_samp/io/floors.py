"""The maps of a plan dictionary: where they lie, and plans with their floors taken apart."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

from up_samp.io.plan_dict import PlanDict
from up_samp.io.precision import PRECISION
from up_samp.model.frames import Frame, PlacedMap

Box = tuple[float, float, float, float]
"""(left, bottom, right, top), m."""

GAP = 2.0
"""Distance (m) between floors that are drawn or looked at side by side."""


def maps_of(plan: Mapping[str, Any]) -> list[PlacedMap]:
    """Return the maps of a plan (none: the open plane)."""
    entries = plan.get("maps") or [plan["map"]]
    return [
        PlacedMap(e["yaml"], Frame(*e.get("frame", (0.0, 0.0, 0.0))), float(e.get("height", 0.0)))
        for e in entries
        if e.get("yaml") is not None
    ]


def named_maps(plan: Mapping[str, Any]) -> dict[str, str]:
    """Return the maps' files by names for other tools, in order (none: "plane"): a file's own name,
    with the map's number where another has that.
    """
    found: dict[str, str] = {}
    for k, placed in enumerate(maps_of(plan)):
        stem = Path(placed.file).stem
        found[f"{stem}-{k}" if stem in found else stem] = placed.file
    return found or {"plane": ""}


def own_frames(plan: Mapping[str, Any]) -> list[Frame]:
    """Return for each map (at least one) what takes poses to the frame of its file."""
    return [m.frame.inverse for m in maps_of(plan)] or [Frame()]


def map_entries(plan: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the entries of a plan that name a map file, for whoever has to change the path."""
    return [plan["map"], *plan.get("maps", ())]


def map_number(entry: Mapping[str, Any]) -> int:
    """Return the number of the map of an object's first pose, a motion or a change."""
    return int(entry.get("map", 0))


def maps_in_turn(plan: Mapping[str, Any]) -> dict[str, list[tuple[float, int]]]:
    """Return for each object since when (s) it is on which map, by number."""
    found = {o["name"]: [(-math.inf, map_number(o))] for o in plan["objects"]}
    for motion in plan["motions"]:
        found[motion["object"]].append((motion["samples"][0][0], map_number(motion)))
    for change in plan["changes"]:
        found[change["object"]].append((change["time"], map_number(change)))
    return {name: sorted(events) for name, events in found.items()}


def heights_of(plan: Mapping[str, Any]) -> list[float]:
    """Return how high (m) each map is."""
    return [m.height for m in maps_of(plan)] or [0.0]


def map_at(turn: Sequence[tuple[float, int]], time: float) -> int:
    """Return the number of the map on which something is at a time (s)."""
    return turn[bisect.bisect(turn, (time, math.inf)) - 1][1]


def moved(plan: Mapping[str, Any], frames: Sequence[Frame]) -> PlanDict:
    """Return a plan with all poses moved: those on map k lie in ``frames[k]``."""

    def put(pose: Sequence[float], k: int) -> list[float]:
        if len(pose) != 3:  # in space: the frames are those of floors
            return list(pose)
        return [round(v, PRECISION.decimals) + 0.0 for v in frames[k].of(pose)]

    heights = {m.height: k for k, m in enumerate(maps_of(plan))}

    def lies(zone: Mapping[str, Any]) -> dict[str, Any]:
        """Maps of one height are moved alike."""
        frame = frames[heights.get(zone.get("height", 0.0), 0)]
        way = {"one_way": zone["one_way"] + frame.yaw} if "one_way" in zone else {}
        dock = {"dock": list(frame.of(zone["dock"]))} if "dock" in zone else {}
        return {**zone, "polygon": frame.points(zone["polygon"]).tolist(), **way, **dock}

    objects = [
        {**o, "zones": [lies(zone) for zone in o["zones"]]} if "zones" in o else o
        for o in plan["objects"]
    ]
    objects = [
        o if o["initial"] is None else {**o, "initial": put(o["initial"], map_number(o))}
        for o in objects
    ]
    motions = [
        {**m, "samples": [[r[0], *put(r[1:], map_number(m))] for r in m["samples"]]}
        for m in plan["motions"]
    ]
    changes = [
        {**c, "configuration": put(c["configuration"], map_number(c))} for c in plan["changes"]
    ]
    return {**plan, "objects": objects, "motions": motions, "changes": changes}


def side_by_side(
    plan: Mapping[str, Any], boxes: Sequence[Box] = ()
) -> tuple[PlanDict, list[Frame]]:
    """Return a plan whose floors lie beside each other in one plane, and where each map went.

    Maps of one height stay together. ``boxes`` are what the maps take up (by default as much as the
    plan's poses need). With one map the plan is returned as it is.
    """
    maps = maps_of(plan)
    if len(maps) < 2:
        return dict(plan), [Frame()] * max(1, len(maps))
    levels = sorted({m.height for m in maps})
    taken: dict[float, Box] = {}
    for k, box in (*enumerate(boxes), *_poses(plan)):
        old = taken.get(maps[k].height, box)
        taken[maps[k].height] = (*map(min, old[:2], box[:2]), *map(max, old[2:], box[2:]))  # type: ignore[assignment]
    nothing: Box = (0.0, 0.0, 0.0, 0.0)
    wide = max(b[2] - b[0] for b in (nothing, *taken.values()))
    tall = max(b[3] - b[1] for b in (nothing, *taken.values()))
    x, y = taken.get(levels[0], nothing)[:2]
    shifts: dict[float, Frame] = {}
    for height in levels:
        left, bottom, right, top = taken.get(height, nothing)
        shifts[height] = Frame(x - left, y - bottom)
        if wide >= tall:
            y += top - bottom + GAP
        else:
            x += right - left + GAP
    frames = [shifts[m.height] for m in maps]
    return moved(plan, frames), frames


def _poses(plan: Mapping[str, Any]) -> Iterator[tuple[int, Box]]:
    """Yield what each pose takes up, with the number of its map."""
    corners = {o["name"]: o["footprint"] for o in plan["objects"]}
    reach = {
        o["name"]: max(starmap(math.hypot, o["footprint"]), default=0.0) for o in plan["objects"]
    }

    def around(name: str, x: float, y: float) -> Box:
        r = reach[name]
        return x - r, y - r, x + r, y + r

    def taken(name: str, pose: Sequence[float]) -> Box:
        """A zone may lie far from its reference point."""
        if len(pose) != 3 or not corners[name]:
            return around(name, *pose[:2])
        points = Frame(*pose).points(corners[name])
        return (*map(float, points.min(axis=0)), *map(float, points.max(axis=0)))  # type: ignore[return-value]

    for item in plan["objects"]:
        if item["initial"] is not None:
            yield map_number(item), taken(item["name"], item["initial"])
    for motion in plan["motions"]:
        for row in motion["samples"]:
            yield map_number(motion), around(motion["object"], *row[1:3])
    for change in plan["changes"]:
        yield map_number(change), taken(change["object"], change["configuration"])
