"""A plan, thinned out, as an animation: a web page that needs nothing else."""

from __future__ import annotations

import base64
import html
import io
import json
import os
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from up_samp.model.arrays import FloatArray
from up_samp.plotting.background import ground_of
from up_samp.plotting.gantt import Row, rows_of, title_of
from up_samp.plotting.style import (
    AREA_FILL,
    FIXTURE,
    color_of,
    ink_on,
    mixed,
    with_short_names,
)
from up_samp.plotting.tracks import ObjectTrack, horizon, stops_of, tracks_of
from up_samp.system.files import write_whole


def scene_of(plan: dict[str, Any]) -> dict[str, Any]:
    """Return objects with key frames, rows with bars, the title and the length (s) of a plan.

    Key frames are ``[t, x, y, yaw]``, between which the object moves linearly, true to 1 cm and
    0.01 rad; a change of configuration in one instant is two key frames at the same time.
    """
    objects, movers = [], 0
    for track in tracks_of(plan):
        if track.initial is None and not track.moves and not track.changes:
            continue
        color = color_of(movers) if track.moves else AREA_FILL if track.area else FIXTURE
        movers += track.moves
        objects.append(
            {
                "name": track.name,
                "color": color,
                "ink": ink_on(color),
                "moves": track.moves,
                "footprint": [list(c) for c in track.footprint],
                "keys": key_frames(track),
            }
        )
    return {
        "title": title_of(plan),
        "problem": plan["problem"],
        "horizon": round(horizon(plan), 3),
        "objects": objects,
        "rows": [_row(row) for row in rows_of(plan)],
    }


def _row(row: Row) -> dict[str, Any]:
    return {
        "name": row.name,
        "color": row.color,
        "pale": mixed(row.color, 0.75),
        "ink": ink_on(row.color),
        "object": row.track is not None,
        "lanes": row.lanes,
        "changes": [] if row.track is None or row.track.moves else row.changes,
        "bars": [
            {
                "name": b.activity,
                "labels": list(b.labels),
                "span": [round(b.start, 3), round(b.end, 3)],
                "lane": b.lane,
                "driving": [[round(s, 3), round(e, 3)] for s, e in b.driving],
                "motion": b.motion,
            }
            for b in row.bars
        ],
    }


def key_frames(track: ObjectTrack, near: float = 0.01) -> list[list[float]]:
    """Return ``[[t, x, y, yaw], ...]`` of an object, thinned to within ``near`` m and rad."""
    events: list[tuple[float, FloatArray]] = [
        (float(leg.times[0]), np.column_stack([leg.times, leg.poses])) for leg in track.legs
    ]
    events += [(t, np.array([[t, *pose]])) for t, pose in track.changes]
    frames: list[list[float]] = []
    if track.initial is not None:
        frames.append([0.0, *track.initial])
    for start, table in sorted(events, key=lambda e: e[0]):
        if frames and frames[-1][0] < start:
            frames.append([start, *frames[-1][1:]])
        frames += [list(map(float, row)) for row in table[_needed(table, near)]]
    return [[round(f[0], 3), *(round(v, 3) for v in f[1:3]), round(f[3], 4)] for f in frames]


def _needed(table: FloatArray, near: float) -> list[int]:
    """Return the rows to keep so that linear interpolation in time stays within ``near``.

    Ramer (1972), Douglas & Peucker (1973), with the distance taken at equal times.
    """
    keep = {0, len(table) - 1}
    open_spans = [(0, len(table) - 1)]
    while open_spans:
        a, b = open_spans.pop()
        if b - a < 2:
            continue
        share = (table[a + 1 : b, 0] - table[a, 0]) / (table[b, 0] - table[a, 0])
        line = table[a, 1:] + share[:, None] * (table[b, 1:] - table[a, 1:])
        off = np.abs(table[a + 1 : b, 1:] - line).max(axis=1)
        worst = int(off.argmax())
        if off[worst] > near:
            middle = a + 1 + worst
            keep.add(middle)
            open_spans += [(a, middle), (middle, b)]
    return sorted(keep)


# ------------------ A plan as an animation: a web page that needs nothing else


def animation_html(
    plan: dict[str, Any], *, places: Mapping[str, tuple[float, ...]] | None = None
) -> str:
    """Return a web page that plays the plan: map, footprints, doors and a Gantt strip.

    It holds everything (map, data, script) and loads nothing from anywhere. ``places`` maps names
    to poses (:func:`up_samp.plotting.places_of`): those where motions start or end are named.
    """
    laid = ground_of(with_short_names(plan))
    plan = laid.plan
    buffer = io.BytesIO()
    picture = Image.fromarray(laid.pixels, "RGB")
    picture.thumbnail((1600, 1600), Image.Resampling.BOX)
    picture.quantize(32).save(buffer, format="PNG", optimize=True)
    scene = scene_of(plan)
    scene["places"] = [
        {"name": " / ".join(names), "at": [round(v, 3) for v in pose[:2]]}
        for _, pose, names in stops_of(tracks_of(plan), laid.places(places))
    ]
    scene["floors"] = [
        {
            "name": floor.name,
            "extent": [round(v, 4) for v in floor.extent],
            "shift": [round(floor.frame.x, 4), round(floor.frame.y, 4)],
        }
        for floor in laid.floors
    ]
    scene["extent"] = [round(v, 4) for v in laid.extent]
    scene["map"] = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    fields = {"title": html.escape(plan["problem"]), "scene": _script_data(scene)}
    page = resources.files("up_samp.plotting").joinpath("animation.html").read_text("utf-8")
    # in one go: a name may look like a field
    return re.sub(r"\{\{(\w+)\}\}", lambda found: fields[found[1]], page)


def _script_data(value: object) -> str:
    """Return a value as JSON within a script element: nothing in it can end or begin one."""
    data = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        data = data.replace(character, f"\\u{ord(character):04x}")
    return data


def write_html(
    plan: dict[str, Any],
    path: str | os.PathLike[str],
    *,
    places: Mapping[str, tuple[float, ...]] | None = None,
) -> Path:
    """Write the page of :func:`animation_html` to a file."""
    return write_whole(Path(path), animation_html(plan, places=places))
