"""A problem file to begin with: ``up-samp new``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError

CELL = 0.1
WIDTH, HEIGHT = 30.0, 16.0

PROBLEM = """\
# A fleet problem. Lengths in m, angles in rad, times in s; a pose is [x, y, heading] in the map's
# frame. Then:   up-samp check problem.yaml     (is everything reachable? with a picture)
#                up-samp solve problem.yaml --out plan
format: up-samp-problem
version: 1
name: warehouse
map: warehouse.yaml          # a ROS map_server file beside this one: put your own here

robot_types:
  agv:
    footprint: [1.2, 0.8]    # length, width; or the corners [[x, y], ...] of any polygon
    model: car               # car (turns on curves, may reverse), diff (turns on the spot) or omni
    turning_radius: 0.8
    v_max: 2.0
    a_max: 0.5
    capacity: {item: 1}      # loads of each kind at a time

robots:
  r1: {type: agv, start: home1, end: home1}    # without end: it may stay anywhere
  r2: {type: agv, start: home2, end: home2}

places:                      # where robots stand while something is done
  home1: [3, 3, 0]
  home2: [3, 13, 0]
  dockA: [9, 3, 0]
  dockB: [9, 13, 0]
  button: [11, 8, 0]
  shelf1: [25, 4, 0]
  shelf2: [25, 8, 0]
  shelf3: [25, 12, 0]

doors:
  gate: {leaf: [0.6, 3.8], closed: [15, 8, 0], open: [15, 12, 0], opened_from: button, seconds: 2}

orders:
  - {id: o1, pickup: shelf1, delivery: dockA}
  - {id: o2, pickup: {at: [shelf2, shelf3], service: 3}, delivery: {at: dockB, service: 2}}
  - {id: o3, pickup: shelf3, delivery: {at: [dockA, dockB], window: [0, 300]}}

# tasks:
#   - {id: clean, at: dockB, duration: 20, after: o2}

objective: makespan          # all done as early as possible
"""


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
