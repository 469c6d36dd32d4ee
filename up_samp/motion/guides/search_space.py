"""What searches over poses share: the box they search, and how close to things they may go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from up_samp.geometry import Scene, Shape
from up_samp.model import Body, Configuration, Placed
from up_samp.model.arrays import FloatArray

MARGIN_SHARES = (1.0, 0.25, 0.06, 0.015, 0.004, 0.001)
"""Shares of the clearance margin tried where a start or goal is closer to something than that."""

TOUCHES = "the start or the goal touches the map or an obstacle"
"""Why there is no motion where not even the least of these can be kept."""

OUT_OF_TIME = "out of time"
DRY = "no path at the finest resolution"
STUCK = f"{DRY} within fixed effort"
"""Why a search over poses found none."""


class Space(NamedTuple):
    """The box and the resolution of a search over poses, as the kernels take it.

    ``x``, ``y``: its low corner (m); ``cell`` (m), ``cols``, ``rows``; ``bins`` of headings.
    ``weight``: of what is left of the way. Of a car's search ``extra``: expansions to go on for
    after the first solution; ``near``: range (m) in which Reeds-Shepp times guide. Of a search by
    straight moves ``tight``: where a step does not go all the way, slide up to what is in the way,
    and half as far: so the tree gets into gaps that are narrower than its steps.
    """

    x: float
    y: float
    cell: float
    cols: int
    rows: int
    bins: int
    weight: float = 1.0
    extra: int = 0
    near: float = 0.0
    tight: bool = False


def widest_shape(
    scene: Scene, body: Body, poses: Sequence[Configuration], obstacles: tuple[Placed, ...]
) -> Shape | None:
    """Return the footprint with the largest margin that all ``poses`` can keep (None: they
    touch).
    """
    for share in MARGIN_SHARES:
        shape = scene.shape(body, scene.margin * share)
        least = 0.1 * shape.data.slack[2]
        if all(scene.clearance(shape, obstacles, pose) >= least for pose in poses):
            return shape
    return None


def search_box(
    scene: Scene, poses: Sequence[Configuration], obstacles: tuple[Placed, ...], reach: float
) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the map, or without one of what is known and ``reach`` m around it."""
    if scene.grid is not None:
        return scene.grid.box
    points = np.array([p[:2] for p in poses])
    polys = scene.polys(obstacles)
    if len(polys.counts):
        centres, radii = polys.centres[:, :2], polys.centres[:, 2:]
        points = np.concatenate([points, centres - radii, centres + radii])
    return points.min(axis=0) - reach, points.max(axis=0) + reach


def pose_space(
    scene: Scene,
    poses: Sequence[Configuration],
    obstacles: tuple[Placed, ...],
    reach: float,
    cell: float,
    bins: int,
) -> Space:
    """Return the box and the resolution of a search (``cell`` m)."""
    low, high = search_box(scene, poses, obstacles, reach)
    cols, rows = np.ceil((high - low) / cell).astype(int) + 1
    corner = float(low[0]), float(low[1]), float(cell)
    return Space(*corner, int(cols), int(rows), bins)
