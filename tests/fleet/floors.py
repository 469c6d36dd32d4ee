"""Floors of random fleets: a hall, or two rooms with a door between them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

from shapely.geometry import Polygon, box

from up_samp.fleet.importers import map_from_polygons

LEFT = [(x, y) for x in (1.6, 4.2, 6.6) for y in (1.5, 4.5, 7.5)]
RIGHT = [(x, y) for x in (9.4, 11.8, 14.4) for y in (1.5, 4.5, 7.5)]
WALL = (box(7.9, 0, 8.1, 3.5), box(7.9, 5.5, 8.1, 9))
LEAF, CLOSED, OPEN = (0.2, 1.96), (8.0, 4.5, 0.0), (8.0, 6.6, 0.0)


def map_with(walls: Sequence[Polygon], folder: Path) -> Path:
    """Return the map file of a floor of 16 m x 9 m; it is written once for each folder."""
    name = "rooms" if walls else "hall"
    path = folder / f"{name}.yaml"
    if not path.exists():
        free = box(0, 0, 16, 9)
        for wall in walls:
            free = free.difference(wall)
        map_from_polygons(free, folder, name, 0.1)
    return path


def zone_of(rng: random.Random) -> Polygon:
    """Return a rectangle somewhere between the places."""
    x, y = rng.choice([4.2, 8.0, 11.8]), rng.choice([2.5, 4.5, 7.5])
    w, h = rng.choice([0.8, 2.2]), rng.choice([0.8, 1.8])
    return box(x - w, y - h, x + w, y + h)
