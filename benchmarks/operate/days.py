"""A floor to spend days on, and three ways to plan them in the same loop: the figure ``days`` of
``scripts/figures.py``.

``rolling`` is what ``up-samp operate`` does; ``token`` gives each order, in the order of coming, to
the free robot that could be there first, and plans nothing twice: who comes later goes first only
where nobody has to wait for that (token passing: Ma et al., "Lifelong multi-agent path finding for
online pickup and delivery tasks", AAMAS 2017). ``anew`` plans all that is not begun from nothing
whenever an order comes. All days are judged by what was driven.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from up_samp import Fleet
from up_samp.geometry.maps import write_map

WAYS = {
    "rolling": {"commit": "begun"},
    "token": {"commit": "all"},
    "anew": {"commit": "none"},
}


def warehouse(folder: Path, robots: int) -> Fleet:
    """A floor with rows of racks, docks on the left, and a home for each robot on the right."""
    cell, height = 0.1, max(18.0, 3.0 + 1.6 * robots)
    cells = np.zeros((round(height / cell), round(36 / cell)), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    rows = [4.0 + 4.0 * k for k in range(int((height - 6.0) / 4.0))]
    for y in rows:
        for x in (9.0, 19.0):
            cells[
                round(y / cell) : round((y + 1.0) / cell), round(x / cell) : round((x + 7) / cell)
            ] = True
    fleet = Fleet(write_map(folder, "warehouse", cells, cell), name="warehouse", margin=0.12)
    fleet.add_robot_type(
        "agv", footprint=(0.8, 0.6), model="diff", v_max=1.5, a_max=0.7, omega_max=1.5
    )
    for k in range(robots):
        fleet.add_place(f"home{k}", 34.0, 1.5 + 1.6 * k, np.pi)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    docks = [f"dock{k}" for k in range(len(rows) + 1)]
    for k, name in enumerate(docks):
        fleet.add_place(name, 2.5, 2.5 + 4.0 * k, np.pi)
    for k, y in enumerate(rows):
        for i, x in enumerate((10.5, 13.5, 20.5, 23.5)):
            fleet.add_place(f"rack{k}_{i}", x, y - 0.8)
            delivery = {"at": docks[(k + i) % len(docks)], "service": 5}
            fleet.add_order(f"o{k}_{i}", {"at": f"rack{k}_{i}", "service": 5}, delivery)
    return fleet
