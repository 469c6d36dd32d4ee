"""A problem file to begin with: ``up-samp new``."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError

CELL = 0.1
WIDTH, HEIGHT = 30.0, 16.0
PROBLEM = resources.files("up_samp.fleet").joinpath("starter.yaml").read_text("utf-8")


def write_starter(folder: Path) -> list[Path]:
    """Write ``problem.yaml`` and a map of two rooms into ``folder``; return the files.

    :raises ProblemError: where one of them is there already.
    """
    files = [folder / name for name in ("problem.yaml", "warehouse.yaml", "warehouse.png")]
    there = [f for f in files if f.exists()]
    if there:
        raise ProblemError(f"'{there[0]}' is there already; name another folder")
    folder.mkdir(parents=True, exist_ok=True)
    write_map(folder, "warehouse", two_rooms(), CELL)
    files[0].write_text(PROBLEM, encoding="utf-8")
    return files


def two_rooms() -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Return the cells of two rooms, side by side, joined by a gap of 4 m; row 0 has lowest y."""
    rows, cols = round(HEIGHT / CELL), round(WIDTH / CELL)
    occupied = np.zeros((rows, cols), dtype=np.bool_)
    wall = round(0.3 / CELL)
    occupied[:wall], occupied[-wall:] = True, True
    occupied[:, :wall], occupied[:, -wall:] = True, True
    middle = cols // 2
    occupied[:, middle - 1 : middle + 2] = True
    occupied[round(6 / CELL) : round(10 / CELL), middle - 1 : middle + 2] = False
    return occupied
