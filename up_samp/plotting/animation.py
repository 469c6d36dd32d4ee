"""A plan as an animation: a web page that needs nothing else, or a GIF."""

from __future__ import annotations

import base64
import html
import io
import json
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from up_samp.plotting.background import background_of
from up_samp.plotting.scene import scene_of
from up_samp.plotting.tracks import stops_of, tracks_of

_WIDEST = 1600


def animation_html(
    plan: dict[str, Any], *, places: Mapping[str, tuple[float, ...]] | None = None
) -> str:
    """Return a web page that plays the plan: map, footprints, doors and a Gantt strip.

    It holds everything (map, data, script) and loads nothing from anywhere. ``places`` maps names
    to poses (:func:`up_samp.plotting.places_of`): those where motions start or end are named.
    """
    ground = background_of(plan)
    buffer = io.BytesIO()
    picture = ground.image(_WIDEST)
    picture.quantize(32).save(buffer, format="PNG", optimize=True)
    scene = scene_of(plan)
    scene["places"] = [
        {"name": " / ".join(stop.names), "at": [round(v, 3) for v in stop.pose[:2]]}
        for stop in stops_of(tracks_of(plan), places or {})
    ]
    scene["extent"] = [round(v, 4) for v in ground.extent]
    scene["map"] = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    # "</" would end the script element from within a string
    data = json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    page = resources.files("up_samp.plotting").joinpath("animation.html").read_text("utf-8")
    return page.replace("{{title}}", html.escape(plan["problem"])).replace("{{scene}}", data)


def write_html(
    plan: dict[str, Any],
    path: str | os.PathLike[str],
    *,
    places: Mapping[str, tuple[float, ...]] | None = None,
) -> Path:
    """Write the page of :func:`animation_html` to a file."""
    target = Path(path)
    target.write_text(animation_html(plan, places=places), encoding="utf-8")
    return target
