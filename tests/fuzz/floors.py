"""Floors to drive on: small maps with places whose bodies fit, drawn by chance."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np
from PIL import Image

RESOLUTION = 0.1
Pose = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Floor:
    """Cells that are occupied, places by name, and (perhaps) a doorway: where its leaf stands when
    shut and when open, and its length (m).
    """

    kind: str
    occupied: np.ndarray
    places: dict[str, Pose]
    doorway: tuple[Pose, Pose, float] | None = None
    resolution: float = RESOLUTION

    def write(self, folder):
        """Write image and YAML; return the YAML's path."""
        picture = np.where(self.occupied[::-1], 0, 255).astype(np.uint8)
        Image.fromarray(picture).save(folder / f"{self.kind}.png")
        path = folder / f"{self.kind}.yaml"
        path.write_text(
            f"image: {self.kind}.png\nresolution: {self.resolution}\norigin: [0, 0, 0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )
        return path


def walled(width: float, height: float) -> np.ndarray:
    cells = np.zeros((round(height / RESOLUTION), round(width / RESOLUTION)), dtype=bool)
    cells[:1] = cells[-1:] = True
    cells[:, :1] = cells[:, -1:] = True
    return cells


def block(cells: np.ndarray, left: float, bottom: float, right: float, top: float) -> None:
    rows = slice(round(bottom / RESOLUTION), round(top / RESOLUTION))
    cells[rows, round(left / RESOLUTION) : round(right / RESOLUTION)] = True


def hall(rng: random.Random) -> Floor:
    """An open hall, with pillars."""
    cells = walled(12, 8)
    for x, y in rng.sample([(4, 3), (8, 3), (4, 5), (8, 5), (6, 4)], rng.randint(0, 3)):
        block(cells, x - 0.3, y - 0.3, x + 0.3, y + 0.3)
    spots = [(x, y) for x in (1.5, 6.0, 10.5) for y in (1.5, 6.5)]
    return Floor("hall", cells, _places(rng, spots))


def rooms(rng: random.Random) -> Floor:
    """Two rooms joined by a doorway."""
    cells = walled(11, 6)
    block(cells, 5.4, 0, 5.6, 2.2)
    block(cells, 5.4, 3.8, 5.6, 6)
    spots = [(1.5, 1.2), (1.5, 4.8), (3.2, 3.0), (9.5, 1.2), (9.5, 4.8), (7.8, 3.0)]
    door = ((5.5, 3.0, 0.0), (5.5, 4.9, 0.0), 1.6)
    return Floor("rooms", cells, _places(rng, spots), door)


def corridor(rng: random.Random) -> Floor:
    """Two bays joined by a corridor with a pocket at its side."""
    cells = walled(14, 6)
    block(cells, 4, 0, 10, 2.2)
    block(cells, 4, 3.8, 10, 6)
    cells[round(3.8 / RESOLUTION) : round(5.4 / RESOLUTION), 62:78] = False
    spots = [(1.5, 1.5), (1.5, 4.5), (12.5, 1.5), (12.5, 4.5), (2.8, 3.0), (11.2, 3.0)]
    return Floor("corridor", cells, _places(rng, spots))


def closed(rng: random.Random) -> Floor:
    """A hall with a chamber that nobody can enter."""
    cells = walled(10, 6)
    block(cells, 6, 0, 6.2, 6)
    spots = [(1.2, 1.2), (1.2, 4.8), (4.6, 1.2), (4.6, 4.8), (8.2, 3.0)]
    return Floor("closed", cells, _places(rng, spots))


def _places(rng: random.Random, spots: list[tuple[float, float]]) -> dict[str, Pose]:
    turns = (0.0, math.pi / 2, math.pi, -math.pi / 2)
    return {f"p{k}": (x, y, rng.choice(turns)) for k, (x, y) in enumerate(spots)}


FLOORS = (hall, hall, rooms, rooms, rooms, corridor, corridor, closed)
