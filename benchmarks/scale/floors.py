"""Fleets on floors that others drew: what traffic costs there.

``python benchmarks/scale/floors.py [MAP ROBOTSxORDERS SEED SECONDS]`` draws docks, shelves and
stations at random on a map (ROS YAML, or Moving AI's ``.map`` with cells of 1.5 m), solves for so
many seconds of computing, and prints a row: the makespan, the least one found where robots heed
each other at shared places only, and the relative bound.
``NAV2_MAPS`` and ``LORR_MAPS`` are the folders where Nav2's and the League of Robot Runners' maps
lie.
"""

from __future__ import annotations

import math
import os
import random
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from unified_planning.shortcuts import AnytimePlanner, get_environment

from up_samp import Fleet
from up_samp.fleet.importers.common import Options
from up_samp.fleet.importers.grids import import_movingai
from up_samp.geometry.maps import load_map
from up_samp.model.deadline import computing_time

CELL = 1.5
"""m, of Moving AI's grids."""
TYPES: dict[str, dict[str, Any]] = {
    "car": {"model": "car", "turning_radius": 1.0},
    "turner": {"model": "diff", "omega_max": 1.5},
    "glider": {"model": "omni", "omega_max": 1.5},
}
"""A third of the fleet each."""
CLEAR, APART = 1.2, 2.5
"""m to walls, wherever a way leads from place to place (two robots pass each other there), and
from place to place, at least."""
SERVICE = (2, 3, 5)
"""s that loading and unloading may take."""


def drawn_places(file: Path, many: int, rng: random.Random) -> list[tuple[float, float]]:
    """Return places at random on the largest free part of a map, apart from each other (m)."""
    grid = load_map(file)
    walls = np.pad(grid.blocked, 1, constant_values=True)
    free = (distance_transform_edt(~walls) * grid.resolution > CLEAR)[1:-1, 1:-1]
    parts, _ = label(free)
    largest = int(np.argmax(np.bincount(parts[parts > 0])))
    rows, columns = np.nonzero(parts == largest)
    cells = list(zip(rows.tolist(), columns.tolist(), strict=True))
    rng.shuffle(cells)
    found: list[tuple[float, float]] = []
    for i, j in cells:
        x, y = grid.point_of(i, j)
        if all(math.hypot(x - a, y - b) >= APART for a, b in found):
            found.append((round(x, 2), round(y, 2)))
        if len(found) == many:
            return found
    raise ValueError(f"{file} has no room for {many} places that are {APART} m apart")


def fleet_on(file: Path, robots: int, orders: int, seed: int) -> Fleet:
    """Return a fleet on a map: docks, shelves and half as many stations as robots."""
    rng = random.Random(seed)
    stations = max(2, robots // 2)
    places = drawn_places(file, robots + stations + orders, rng)
    fleet = Fleet(file, name=f"{file.stem}-r{robots}-o{orders}")
    for name, kind in TYPES.items():
        fleet.add_robot_type(name, footprint=(1.2, 0.8), v_max=1.5, a_max=1.0, **kind)
    for n in range(robots):
        fleet.add_place(f"dock{n}", *places.pop())
        fleet.add_robot(f"r{n}", [*TYPES][n % len(TYPES)], start=f"dock{n}")
    for n in range(stations):
        fleet.add_place(f"station{n}", *places.pop())
    for n in range(orders):
        fleet.add_place(f"shelf{n}", *places.pop())
        shelf = {"at": f"shelf{n}", "service": rng.choice(SERVICE)}
        station = {"at": f"station{rng.randrange(stations)}", "service": rng.choice(SERVICE)}
        fleet.add_order(f"order{n}", shelf, station)
    return fleet


def map_of(name: str, folder: Path) -> Path:
    """Return a map's file: Nav2's by their name, the League's turned into ROS maps."""
    nav2 = Path(os.environ.get("NAV2_MAPS", "/opt/ros/jazzy/share/nav2_bringup/maps"))
    if (nav2 / f"{name}.yaml").exists():
        return nav2 / f"{name}.yaml"
    league = Path(os.environ.get("LORR_MAPS", "."))
    import_movingai(league / f"{name}.map", folder, Options(cell=CELL))
    return folder / "map.yaml"


def measured(case: str, seconds: float) -> dict[str, float | None]:
    """Return what comes of a case ("warehouse, 10x30, seed 0") in so many seconds of computing."""
    name, size, seed = case.split(", ")
    robots, orders = map(int, size.split("x"))
    get_environment().credits_stream = None
    told: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, computing_time():
        fleet = fleet_on(map_of(name, Path(folder)), robots, orders, int(seed.split()[1]))
        with AnytimePlanner(name="samp-refine[cpsat]", params={"seed": 0}) as engine:
            for result in engine.get_solutions(fleet.problem, timeout=seconds):
                told = dict(result.metrics or {}) if result.plan is not None else told
    keys = ("makespan", "without_traffic", "lower_bound")
    makespan, alone, bound = (float(told[key]) if key in told else None for key in keys)
    return {"makespan": makespan, "without_traffic": alone, "bound": bound}


def main(
    name: str = "warehouse", size: str = "10x30", seed: str = "0", seconds: str = "100"
) -> None:
    """Print a row."""
    told = measured(f"{name}, {size}, seed {seed}", float(seconds))
    print("| map, fleet, seed | makespan | without traffic | bound |")
    print("|---|---|---|---|")
    values = " | ".join(f"{value:g}" if value else "-" for value in told.values())
    print(f"| {name}, {size}, {seed} | {values} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
