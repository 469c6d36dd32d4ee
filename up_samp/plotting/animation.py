"""A plan as an animation: a web page that needs nothing else, or a GIF."""

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

from up_samp.plotting.background import ground_of
from up_samp.plotting.names import with_short_names
from up_samp.plotting.scene import scene_of
from up_samp.plotting.sizes import SIZES
from up_samp.plotting.tracks import stops_of, tracks_of
from up_samp.system.files import write_whole


def animation_html(
    plan: dict[str, Any], *, places: Mapping[str, tuple[float, ...]] | None = None
) -> str:
    """Return a web page that plays the plan: map, footprints, doors and a Gantt strip.

    It holds everything (map, data, script) and loads nothing from anywhere. ``places`` maps names
    to poses (:func:`up_samp.plotting.places_of`): those where motions start or end are named.
    """
    laid = ground_of(with_short_names(plan))
    plan, ground = laid.plan, laid.background
    buffer = io.BytesIO()
    picture = ground.image(SIZES.map_width)
    picture.quantize(32).save(buffer, format="PNG", optimize=True)
    scene = scene_of(plan)
    scene["places"] = [
        {"name": " / ".join(stop.names), "at": [round(v, 3) for v in stop.pose[:2]]}
        for stop in stops_of(tracks_of(plan), laid.places(places))
    ]
    scene["places"] += [
        {"name": name, "at": [round(v, 3) for v in corner]} for name, corner in laid.labels
    ]
    scene["extent"] = [round(v, 4) for v in ground.extent]
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
