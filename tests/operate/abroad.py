"""Floors that others drew, to operate on: a shop and a depot of robot simulators, and cut-outs
of grids of the League of Robot Runners, laid anywhere, with fleets of mixed kinds by a seed.
"""

import math

import numpy as np
from scipy import ndimage

from tests.operate.sites import APART, KINDS
from up_samp import Fleet
from up_samp.fleet.importers.grids import read_movingai_map
from up_samp.geometry.maps import OccupancyGrid, load_map, write_map

MORE = {
    **KINDS,
    "ahead": {
        "footprint": (0.9, 0.5), "model": "car", "turning_radius": 0.7, "v_max": 1.0,
        "a_max": 0.5, "reverse": "never",
    },
    "scanner": {
        "footprint": (0.7, 0.5), "model": "diff", "v_max": 1.0, "a_max": 0.5, "reverse": "never",
    },
    "hasty": {"footprint": (0.7, 0.5), "model": "omni", "v_max": 2.0, "a_max": 1.5},
}  # fmt: skip
PLANS = ("bookstore/map.yaml", "nav2/depot.yaml")
GRIDS = {
    "random-64-64-10.map": 1.2,
    "room-64-64-16.map": 1.4,
    "warehouse_long_corridor_large.map": 1.5,
}
"""m that a cell of a grid is wide."""
SIDE = 14
"""Cells of a side of a cut-out."""
PLACE, WAY = 0.85, 0.6
"""m from a place, and from ways that lead to all places, to the nearest wall."""


def walls_of(data, name, rng):
    """Return blocked cells of a map in a folder, and m a cell."""
    if name in PLANS:
        grid = load_map(data / name)
        return grid.blocked, grid.resolution
    walls = read_movingai_map(data / "lorr" / name)
    row, col = (rng.randrange(max(1, n - SIDE)) for n in walls.shape)
    part = np.kron(walls[row : row + SIDE, col : col + SIDE], np.ones((10, 10), dtype=bool))
    return np.pad(part, 2, constant_values=True), GRIDS[name] / 10


def abroad(data):
    """Return what makes a site of maps in a folder (``folder, rng, robots``)."""

    def site(folder, rng, robots):
        while True:
            fleet = drawn(data, folder, rng, robots)
            if fleet is not None:
                return fleet

    return site


def drawn(data, folder, rng, robots):
    """Return one site, or None where the floor drawn has too little room."""
    floor = rng.choice([*PLANS, *GRIDS])
    cells, cell = walls_of(data, floor, rng)
    turned = rng.choice([0.0, 0.0, rng.uniform(-3, 3)])
    origin = (rng.uniform(-40, 40), rng.uniform(-40, 40), turned)
    grid = OccupancyGrid(cells, cell, origin)
    room = (
        ndimage.distance_transform_edt(~np.pad(cells, 1, constant_values=True))[1:-1, 1:-1] * cell
    )
    parts, _ = ndimage.label(room >= WAY)
    sizes = np.bincount(parts[room >= PLACE], minlength=2)
    sizes[0] = 0
    good = np.argwhere((parts == sizes.argmax()) & (room >= PLACE))
    names = [f"home{k}" for k in range(robots)]
    names += [f"{what}{k}" for what in ("shelf", "rack", "dock") for k in range(2)]
    rng.shuffle(names)
    spots = []
    for row, col in rng.sample(good.tolist(), min(len(good), 2000)):
        point = grid.point_of(row, col)
        if all(math.dist(point, other) >= APART for other in spots):
            spots.append(point)
        if len(spots) == len(names):
            break
    else:
        return None
    fleet = Fleet(write_map(folder, "abroad", cells, cell, origin), name="abroad", margin=0.12)
    # where cars cannot turn round there are places that they never reach
    some = [k for k in MORE if floor in PLANS or MORE[k]["model"] != "car"]
    kinds = rng.sample(some, rng.randint(1, 3))
    for kind in kinds:
        fleet.add_robot_type(kind, omega_max=1.5, **MORE[kind])
    for name, (x, y) in zip(names, spots, strict=True):
        fleet.add_place(name, x, y, rng.uniform(-3.1, 3.1))
    for k in rng.sample(range(robots), robots):
        end = f"home{k}" if rng.random() < 0.8 else None
        fleet.add_robot(f"r{k}", rng.choice(kinds), start=f"home{k}", end=end)
    return fleet
