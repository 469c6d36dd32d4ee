"""Pictures of a job's plan, with the map that came with its request."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from up_samp.server.requests import MAP_NAME, MapUpload


def animation_of(plan: dict[str, Any], map_upload: dict[str, Any]) -> str:
    """Return the page that plays ``plan`` on its map."""
    from up_samp.plotting.animation import animation_html

    with tempfile.TemporaryDirectory(prefix="up-samp-draw-") as folder:
        MapUpload(**map_upload).write(Path(folder), MAP_NAME)
        return animation_html({**plan, "map": {"yaml": str(Path(folder) / MAP_NAME)}})
