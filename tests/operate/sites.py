"""Small sites to operate, and a day on them."""

import numpy as np

from up_samp import Fleet
from up_samp.geometry.maps import write_map


def hall(folder, robots=3, *, width=24.0, height=14.0, v_max=1.5, a_max=0.7, home=True):
    """A hall with two rows of shelves, docks, and a home for each robot, where it ends its day if
    ``home``.
    """
    cell = 0.1
    cells = np.zeros((round(height / cell), round(width / cell)), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    for x in (9.0, 15.0):
        cells[round(4 / cell) : round(10 / cell), round(x / cell) : round((x + 1.5) / cell)] = True
    yaml = write_map(folder, "hall", cells, cell)
    fleet = Fleet(yaml, name="hall", margin=0.12)
    fleet.add_robot_type(
        "agv", footprint=(0.8, 0.6), model="diff", v_max=v_max, a_max=a_max, omega_max=v_max
    )
    for k in range(robots):
        fleet.add_place(f"home{k}", 1.5, 1.5 + 1.6 * k)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}" if home else None)
    for k in range(3):
        fleet.add_place(f"shelf{k}", 12.5 + 1.6 * (k % 2), 5.0 + 2.0 * k)
        fleet.add_place(f"rack{k}", 19.0, 3.0 + 3.5 * k)
        fleet.add_place(f"dock{k}", 6.0, 3.0 + 3.5 * k, 3.14159)
    return fleet
