"""Floor plans of the benchmark families, drawn by code, as ROS ``map_server`` files.

Maps have 0.1 m per pixel; the world frame's origin is the map's lower-left corner, x points right
and y up, lengths are metres. Free cells are white, occupied cells black. The plans that the paper's
instances use lie beside this module in ``data/``; any other one is drawn on request into the cache
folder.
"""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from up_samp.geometry.maps import write_map
from up_samp.system.files import cache_folder

RESOLUTION, WALL = 0.1, 0.5
"""Metres per pixel, and thickness of an outer wall (m)."""

DATA = Path(__file__).parent / "data"
"""Folder of the files that are frozen with the package."""

Rectangle = tuple[float, float, float, float]
"""``(x_min, y_min, x_max, y_max)`` in m."""


def draw(size: tuple[float, float], walls: Sequence[Rectangle]) -> npt.NDArray[np.bool_]:
    """Return the occupancy grid of ``walls``: shape (rows, columns), row 0 lowest y."""
    columns, rows = (round(v / RESOLUTION) for v in size)
    occupied = np.zeros((rows, columns), dtype=np.bool_)
    for x0, y0, x1, y1 in walls:
        c0, c1, r0, r1 = (round(v / RESOLUTION) for v in (x0, x1, y0, y1))
        occupied[r0:r1, c0:c1] = True
    return occupied


def drawn_map(name: str, size: tuple[float, float], walls: Sequence[Rectangle]) -> Path:
    """Return the YAML file of a map of that size (m) with ``walls``: the one that is frozen with
    the package under that name, else one that is drawn once per machine.
    """
    frozen = DATA / f"{name}.yaml"
    if frozen.exists():
        return frozen
    told = zlib.crc32(repr((size, *walls)).encode())  # who draws something else reads nothing old
    folder = (cache_folder() or Path(tempfile.gettempdir()) / "up-samp") / "maps"
    cached = folder / f"{name}-{told:08x}.yaml"
    if not cached.exists():
        write_map(folder, cached.stem, draw(size, walls), RESOLUTION)
    return cached


def outer_wall(width: float, height: float) -> list[Rectangle]:
    """Return the four sides of the wall around a map of that size (m)."""
    return [
        (0.0, 0.0, width, WALL),
        (0.0, height - WALL, width, height),
        (0.0, 0.0, WALL, height),
        (width - WALL, 0.0, width, height),
    ]
