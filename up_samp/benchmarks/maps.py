"""Floor plans of the benchmark families, drawn by code, as ROS ``map_server`` files.

Maps have 0.1 m per pixel; the world frame's origin is the map's lower-left corner, x points right
and y up, lengths are metres. Free cells are white, occupied cells black. The plans that the paper's
instances use lie beside this module in ``data/``; any other size is drawn on request into a cache
folder (``UP_SAMP_CACHE``, else ``XDG_CACHE_HOME/up_samp``, else ``~/.cache/up_samp``).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
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


LOGISTICS_SIZE = (100.0, 65.0)
LOGISTICS_SHELVES: tuple[Rectangle, ...] = ((52.0, 35.0, 100.0, 40.0), (52.0, 20.0, 100.0, 25.0))


@dataclass(frozen=True)
class JobShopPlan:
    """The job shop's floor plan (m): rooms side by side above one hall."""

    room_width: float = 50.0
    hall_top: float = 31.5
    """Where the hall ends and the wall begins (y)."""
    room_floor: float = 32.5
    """Where the wall ends and the rooms begin (y)."""
    gap: float = 5.0
    """Width of a gap in the wall."""
    height: float = 50.0


SHOP = JobShopPlan()


def logistics_walls() -> list[Rectangle]:
    """Return what is occupied on the logistics map: the outer wall and two long shelves."""
    return [*outer_wall(*LOGISTICS_SIZE), *LOGISTICS_SHELVES]


def job_shop_walls(cells: int) -> list[Rectangle]:
    """Return what is occupied on a job-shop map of ``cells`` machine rooms above one hall.

    The wall between hall and rooms is 1 m thick around y = 32 and has one gap of 5 m per room.
    """
    width = SHOP.room_width * cells
    walls = outer_wall(width, SHOP.height)
    left = 0.0
    for i in range(cells):
        centre = SHOP.room_width * i + SHOP.room_width / 2
        walls.append((left, SHOP.hall_top, centre - SHOP.gap / 2, SHOP.room_floor))
        left = centre + SHOP.gap / 2
    walls.append((left, SHOP.hall_top, width, SHOP.room_floor))
    for i in range(1, cells):
        x = SHOP.room_width * i
        walls.append((x - WALL, SHOP.room_floor, x + WALL, SHOP.height))
    return walls


def job_shop_size(cells: int) -> tuple[float, float]:
    """Return width and height, m, of a job-shop map with ``cells`` machine rooms."""
    return (SHOP.room_width * cells, SHOP.height)


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


def logistics_map() -> Path:
    """Return the YAML file of the logistics map."""
    return DATA / "logistics.yaml"


def job_shop_map(cells: int) -> Path:
    """Return the YAML file of the job-shop map with ``cells`` machine rooms."""
    if cells < 1:
        raise ValueError(f"a job shop needs at least one machine, not {cells}")
    frozen = DATA / f"jobshop-{cells}.yaml"
    if frozen.exists():
        return frozen
    return drawn_map(f"jobshop-{cells}", job_shop_size(cells), job_shop_walls(cells))


def drawn_map(name: str, size: tuple[float, float], walls: Sequence[Rectangle]) -> Path:
    """Return the YAML file of a map of that size (m) with ``walls``, drawn once per machine."""
    cached = cache_folder() / f"{name}.yaml"
    if cached.exists():
        return cached
    return write_map(cached.parent, cached.stem, draw(size, walls))


def outer_wall(width: float, height: float) -> list[Rectangle]:
    """Return the four sides of the wall around a map of that size (m)."""
    return [
        (0.0, 0.0, width, WALL),
        (0.0, height - WALL, width, height),
        (0.0, 0.0, WALL, height),
        (width - WALL, 0.0, width, height),
    ]
