"""Small sites to operate: a hall that is always the same, and halls drawn at random."""

import math

import numpy as np

from up_samp import Fleet
from up_samp.geometry.maps import write_map


def hall(folder, robots=3, *, width=24.0, height=14.0, v_max=1.5, a_max=0.7, home=True, **kind):
    """A hall with two rows of shelves, docks, and a home for each robot, where it ends its day if
    ``home``. To drive backwards is as good as ahead (robots of :func:`anywhere` would rather not):
    to seek a way ahead besides, for each leg, takes most of the time of a day.
    """
    cell = 0.1
    cells = np.zeros((round(height / cell), round(width / cell)), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    for x in (9.0, 15.0):
        cells[round(4 / cell) : round(10 / cell), round(x / cell) : round((x + 1.5) / cell)] = True
    yaml = write_map(folder, "hall", cells, cell)
    fleet = Fleet(yaml, name="hall", margin=0.12)
    fleet.add_robot_type(
        "agv", footprint=(0.8, 0.6), model="diff", v_max=v_max, a_max=a_max, omega_max=v_max,
        reverse_cost=1.0, **kind,
    )  # fmt: skip
    for k in range(robots):
        fleet.add_place(f"home{k}", 1.5, 1.5 + 1.6 * k)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}" if home else None)
    for k in range(3):
        fleet.add_place(f"shelf{k}", 12.5 + 1.6 * (k % 2), 5.0 + 2.0 * k)
        fleet.add_place(f"rack{k}", 19.0, 3.0 + 3.5 * k)
        fleet.add_place(f"dock{k}", 6.0, 3.0 + 3.5 * k, 3.14159)
    return fleet


KINDS = {
    "agv": {"footprint": (0.8, 0.6), "model": "diff", "v_max": 1.5, "a_max": 0.7},
    "slow": {
        "footprint": (1.1, 0.7), "model": "diff", "v_max": 0.8, "a_max": 0.4,
        "capacity": {"item": 2},
    },
    "round": {"footprint": (0.6, 0.6), "model": "omni", "v_max": 1.2, "a_max": 1.0},
    "cart": {
        "footprint": (0.9, 0.5), "model": "car", "turning_radius": 0.8, "v_max": 1.2, "a_max": 0.6,
    },
}  # fmt: skip
CELL = 0.1
APART = 1.7
"""m between two places."""


def anywhere(folder, rng, robots=3):
    """A hall drawn by ``rng``: its size, shelves, often a wall with one gap or two (one of them
    with a door, where there are two), up to four kinds of robots, and places anywhere between.

    What it is called (``home``, ``shelf``, ``rack``, ``dock``) is listed in any order.
    """
    width, height = rng.uniform(14, 26), rng.uniform(10, 18)
    free = np.zeros((round(height / CELL), round(width / CELL)), dtype=bool)
    free[2:-2, 2:-2] = True
    gates = _walled(rng, free) if rng.random() < 0.6 else []
    for _ in range(rng.randrange(4)):
        x, y = rng.uniform(3, width - 5), rng.uniform(3, height - 5)
        w, h = rng.uniform(0.5, 2), rng.uniform(0.5, 3)
        if all(math.dist((x + w / 2, y + h / 2), g) > 4.5 for g in gates):
            free[
                round(y / CELL) : round((y + h) / CELL), round(x / CELL) : round((x + w) / CELL)
            ] = False
    fleet = Fleet(write_map(folder, "anywhere", ~free, CELL), name="anywhere", margin=0.12)
    kinds = rng.sample([*KINDS], rng.randint(1, len(KINDS)))
    for kind in kinds:
        fleet.add_robot_type(kind, omega_max=1.5, **KINDS[kind])
    taken = list(gates)

    def spot():
        """A place with room to turn, apart from all others."""
        for _ in range(3000):
            x, y = rng.uniform(1, width - 1), rng.uniform(1, height - 1)
            r, c, room = round(y / CELL), round(x / CELL), 10
            window = free[max(0, r - room) : r + room, max(0, c - room) : c + room]
            apart = all(math.dist((x, y), t) >= APART for t in taken)
            if apart and window.all() and window.size == 4 * room * room:
                taken.append((x, y))
                return round(x, 2), round(y, 2), round(rng.uniform(-3.1, 3.1), 2)
        raise ValueError("a hall with no room for its places")

    if len(gates) == 2:
        _door(fleet, rng, gates[0], taken, spot)
    names = [f"home{k}" for k in range(robots)]
    names += [f"{what}{k}" for what in ("shelf", "rack", "dock") for k in range(2)]
    rng.shuffle(names)
    for name in names:
        fleet.add_place(name, *spot())
    numbers = [*range(robots)]
    rng.shuffle(numbers)
    for k in numbers:
        end = f"home{k}" if rng.random() < 0.8 else None
        fleet.add_robot(f"r{k}", rng.choice(kinds), start=f"home{k}", end=end)
    return fleet


GAP = 2.4
"""m of a gap in a wall."""


def _walled(rng, free):
    """Put a wall with a gap or two across a hall; return the middles of the gaps."""
    rows, columns = free.shape
    x = rng.uniform(0.4, 0.6) * columns * CELL
    free[:, round(x / CELL) - 1 : round(x / CELL) + 2] = False
    ys = [rng.uniform(2.0, rows * CELL / 2 - 2.0)]
    if rng.random() < 0.7:
        ys.append(rng.uniform(rows * CELL / 2 + 2.0, rows * CELL - 2.0))
        rng.shuffle(ys)
    for y in ys:
        low, high = round((y - GAP / 2) / CELL), round((y + GAP / 2) / CELL)
        free[low:high, round(x / CELL) - 1 : round(x / CELL) + 2] = True
    return [(x, y) for y in ys]


def _door(fleet, rng, gate, taken, spot):
    """Close a gap by a leaf that swings open to either side, opened from a place."""
    (x, y), side = gate, rng.choice((-1, 1))
    leaf = GAP - 0.3
    opened = (x + side * (leaf / 2 + 0.1), y + GAP / 2, math.pi / 2)
    taken.append(opened[:2])
    fleet.add_place("button", *spot())
    fleet.add_door(
        "gate", leaf=(0.2, leaf), closed=(x, y, 0.0), open=opened, opened_from="button",
        seconds=rng.randint(2, 20),
    )  # fmt: skip
