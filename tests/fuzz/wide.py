"""Random problems of all sorts: more maps, bodies, robots, styles and decisions than
:mod:`tests.fuzz.problems` draws, which keeps its seeds.
"""

from __future__ import annotations

import functools
import importlib.util
import math
import random
from pathlib import Path

import numpy as np
from PIL import Image

from tests.fuzz.cases import Case, Load, Robot, Style
from tests.fuzz.floors import FLOORS, RESOLUTION, Floor, Pose, _places, block, walled

MESHES = all(importlib.util.find_spec(name) for name in ("coal", "trimesh"))
"""Whether there are packages for bodies that fly."""
APART = 1.9
"""Metres between places at least: whatever body stands there, and its load, they do not meet."""


def doors(rng: random.Random) -> Floor:
    """Three rooms in a row; the first doorway has a door, the second is open."""
    cells = walled(15, 6)
    block(cells, 5.0, 0, 5.2, 2.2)
    block(cells, 5.0, 3.8, 5.2, 6)
    block(cells, 10.0, 0, 10.2, 1.4)
    block(cells, 10.0, 3.0, 10.2, 6)
    spots = [(1.4, 1.3), (1.4, 4.7), (7.6, 1.3), (7.6, 4.7), (13.6, 1.3), (13.6, 4.7), (3.3, 3.0)]
    door = ((5.1, 3.0, 0.0), (5.1, 4.9, 0.0), 1.6)
    return Floor("doors", cells, _places(rng, spots), door)


def pillars(rng: random.Random) -> Floor:
    """A hall full of pillars, somewhere each."""
    cells = walled(13, 9)
    spots = [(x, y) for x in (1.5, 4.8, 8.2, 11.5) for y in (1.5, 7.5)]
    for _ in range(rng.randint(4, 9)):
        x, y = rng.uniform(2.5, 10.5), rng.uniform(3.1, 5.9)
        size = rng.uniform(0.1, 0.4)
        block(cells, x - size, y - size, x + size, y + size)
    return Floor("pillars", cells, _places(rng, spots))


def bays(rng: random.Random) -> Floor:
    """An aisle with bays on both sides, each for one robot."""
    cells = walled(12, 7)
    for x in (3.0, 6.0, 9.0):
        block(cells, x - 0.1, 0, x + 0.1, 2.4)
        block(cells, x - 0.1, 4.6, x + 0.1, 7)
    spots = [(x, y) for x in (1.5, 4.5, 7.5, 10.5) for y in (1.2, 5.8)]
    return Floor("bays", cells, _places(rng, spots))


WIDE_FLOORS = (*FLOORS[1:], doors, doors, pillars, pillars, bays)


@functools.cache
def _real(path: str) -> tuple[np.ndarray, float, np.ndarray]:
    """Return a real map's occupied cells (row 0 at the bottom), its resolution, and the distance of
    each cell to the next occupied one (m).
    """
    from scipy.ndimage import distance_transform_edt

    lines = dict(line.split(":", 1) for line in Path(path).read_text().splitlines() if ":" in line)
    resolution = float(lines["resolution"])
    image = Image.open(Path(path).parent / lines["image"].strip()).convert("L")
    shade = 1.0 - np.asarray(image, dtype=float)[::-1] / 255.0
    cells = shade > float(lines["free_thresh"])
    step = max(1, round(RESOLUTION / resolution))
    rows, columns = (n // step * step for n in cells.shape)
    coarse = cells[:rows, :columns].reshape(rows // step, step, columns // step, step)
    cells = coarse.any(axis=(1, 3))
    return cells, resolution * step, distance_transform_edt(~cells) * resolution * step


def real(rng: random.Random, files: tuple[str, ...]) -> Floor | None:
    """Return a piece of 14 m x 14 m of a real map with places in it, or None where it has few."""
    path = rng.choice(files)
    cells, resolution, clear = _real(path)
    roomy = np.argwhere(clear > 0.95)
    if len(roomy) == 0:
        return None
    r, c = roomy[rng.randrange(len(roomy))]
    half = round(7.0 / resolution)
    top, left = max(0, r - half), max(0, c - half)
    window = cells[top : r + half, left : c + half].copy()
    window[:1] = window[-1:] = True
    window[:, :1] = window[:, -1:] = True
    inside = clear[top : r + half, left : c + half]
    free = [
        (x * resolution, y * resolution)
        for y, x in np.argwhere(inside > 0.95)
        if 10 < y < window.shape[0] - 10 and 10 < x < window.shape[1] - 10
    ]
    rng.shuffle(free)
    spots: list[tuple[float, float]] = []
    for x, y in free:
        if all(math.hypot(x - u, y - v) > APART for u, v in spots):
            spots.append((x, y))
        if len(spots) == 8:
            break
    if len(spots) < 4:
        return None
    floor = Floor(f"real_{Path(path).stem}", window, _places(rng, spots))
    return Floor(floor.kind, window, floor.places, None, resolution)


def wide_case(seed: int, maps: tuple[str, ...] = ()) -> Case:
    """Return the problem of a seed; ``maps`` are YAML files of real maps to be drawn from, too."""
    rng = random.Random(f"wide {seed}")
    floor = real(rng, maps) if maps and rng.random() < 0.2 else None
    floor = floor or rng.choice(WIDE_FLOORS)(rng)
    places = list(floor.places)
    most = max(1, len(places) - 1)
    count = min(rng.choice((1, 1, 2, 2, 2, 3, 3, 4, 5, 6)), most)
    flying = rng.random() < 0.04 and floor.kind in ("hall", "pillars") and MESHES
    count = min(count, 2) if flying else count
    starts = rng.sample(places[:-1] if floor.kind == "closed" else places, count)
    ends = rng.sample(places, count) if rng.random() < 0.75 else [None] * count
    style = _style(rng)
    robots = tuple(
        _robot(rng, k, start, end, places, flying=flying)
        for k, (start, end) in enumerate(zip(starts, ends, strict=True))
    )
    door = None
    if floor.doorway and not flying:
        door = rng.choice((None, "open", "once", "once", "once", "shut", "twice", "closing"))
    limit = rng.choice((None,) * 6 + (4, 8, 12, 25))
    loads = tuple(
        Load(f"load_{r.name}", ((r.name, 0),), r.shape)
        for r in robots
        if not flying
        and style.obstacles != "dict"
        and r.moves != "bicycle"
        and len(r.goals[0]) == 1
        and rng.random() < 0.15
    )
    idle = tuple(r.name for r in robots if rng.random() < 0.12)
    opens = rng.choice((0, 0, 3, 5))
    return Case(seed, floor, robots, style, door, opens, limit, loads, idle)


def _robot(
    rng: random.Random, k: int, start: str, end: str | None, places: list[str], *, flying: bool
) -> Robot:
    goals: list[tuple[str, ...]] = []
    here = {start}
    for _ in range(rng.choice((0, 0, 0, 1, 1, 2))):
        free = [p for p in places if p not in here and p != end]
        if not free:
            break
        goals.append(tuple(sorted(rng.sample(free, min(len(free), rng.choice((1, 1, 1, 2)))))))
        here = set(goals[-1])
    if end is None or end in here:
        end = rng.choice([p for p in places if p not in here])
    more = [p for p in places if p not in here and p != end]
    also = rng.sample(more, 1) if more and rng.random() < 0.25 else []
    goals.append(tuple(sorted((end, *also))))
    body = "flyer" if flying else rng.choice(("car", "car", "omni", "omni", "pivot", "bicycle"))
    shape = rng.choice(("box", "long", "square"))
    service = rng.choice((0, 0, 0, 1, 3))
    return Robot(f"r{k}", body == "car", shape, start, tuple(goals), service, body)


def _style(rng: random.Random) -> Style:
    return Style(
        rng.choice(("all", "list", "dict")),
        rng.choice(("fluents", "order")),
        rng.choice((0, 0, 1)),
        rng.choice(("optional", "optional", "parameter", "variable")),
        rng.choice(("pairs", "pairs", "uses", "uses", "all")),
        rng.choice(("deadline", "constraint")),
        rng.choice(("or", "implies")),
        rng.choice(("wide", "wide", "close")),
    )


__all__ = ["Pose", "wide_case"]
