"""Floor plans of the benchmark families, drawn by code, as ROS ``map_server`` files.

Maps have 0.1 m per pixel; the world frame's origin is the map's lower-left corner, x points right
and y up, lengths are metres. Free cells are white, occupied cells black. The plans that the paper's
instances use lie beside this module in ``data/``; any other one is drawn on request into a cache
folder (``UP_SAMP_CACHE``, else ``XDG_CACHE_HOME/up_samp``, else ``~/.cache/up_samp``).
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

RESOLUTION, WALL = 0.1, 0.5
"""Metres per pixel, and thickness of an outer wall (m)."""

DATA = Path(__file__).parent / "data"
"""Folder of the files that are frozen with the package."""

Rectangle = tuple[float, float, float, float]
"""``(x_min, y_min, x_max, y_max)`` in m."""


def draw(size: tuple[float, float], walls: Sequence[Rectangle]) -> npt.NDArray[np.bool_]:
    """Return the occupancy grid of ``walls``: shape (rows, columns), row 0 at the *top*."""
    columns, rows = (round(v / RESOLUTION) for v in size)
    occupied = np.zeros((rows, columns), dtype=np.bool_)
    for x0, y0, x1, y1 in walls:
        c0, c1, r0, r1 = (round(v / RESOLUTION) for v in (x0, x1, y0, y1))
        occupied[rows - r1 : rows - r0, c0:c1] = True
    return occupied


def write_map(folder: Path, name: str, occupied: npt.NDArray[np.bool_]) -> Path:
    """Write ``NAME.png`` (1 bit) and ``NAME.yaml`` into ``folder``; return the YAML's path.

    Both are written under temporary names and then moved, so that processes which draw the same
    map at the same time never read half a file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    png, yaml = folder / f"{name}.png", folder / f"{name}.yaml"
    scratch = folder / f".{name}.{os.getpid()}"
    Image.fromarray(~occupied).save(scratch, format="PNG", optimize=True)
    os.replace(scratch, png)
    scratch.write_text(
        f"image: {png.name}\nresolution: {RESOLUTION}\norigin: [0.0, 0.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.3\nfree_thresh: 0.1\n",
        encoding="utf-8",
    )
    os.replace(scratch, yaml)
    return yaml


def cache_folder() -> Path:
    """Return the folder for maps that are not frozen with the package."""
    own = os.environ.get("UP_SAMP_CACHE")
    if own:
        return Path(own) / "maps"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "up_samp" / "maps"


def drawn_map(name: str, size: tuple[float, float], walls: Sequence[Rectangle]) -> Path:
    """Return the YAML file of a map of that size (m) with ``walls``: the one that is frozen with
    the package under that name, else one that is drawn once per machine.
    """
    frozen = DATA / f"{name}.yaml"
    if frozen.exists():
        return frozen
    told = zlib.crc32(repr((size, *walls)).encode())  # who draws something else reads nothing old
    cached = cache_folder() / f"{name}-{told:08x}.yaml"
    return cached if cached.exists() else write_map(cached.parent, cached.stem, draw(size, walls))


def outer_wall(width: float, height: float) -> list[Rectangle]:
    """Return the four sides of the wall around a map of that size (m)."""
    return [
        (0.0, 0.0, width, WALL),
        (0.0, height - WALL, width, height),
        (0.0, 0.0, WALL, height),
        (width - WALL, 0.0, width, height),
    ]
