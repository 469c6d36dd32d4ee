"""Loads that travel with what carries them (rule 18): which they are, and where that takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from up_samp.model.arrays import FloatArray
from up_samp.validation.collisions import JudgedShape, placed
from up_samp.validation.tolerances import TOLERANCES

Pose = tuple[float, ...]


@dataclass(frozen=True)
class CarriedLoad:
    """``load`` travels with the carrier of the task ``task``: it stands at ``offset`` in the
    carrier's frame all the while, and at configuration ``goal`` after that.
    """

    activity: str
    task: str
    load: str
    goal: str
    offset: Pose


def offset_between(carrier: Pose, load: Pose) -> Pose:
    """Return a load's pose in its carrier's frame."""
    turn = complex(math.cos(carrier[2]), -math.sin(carrier[2]))
    way = turn * complex(load[0] - carrier[0], load[1] - carrier[1])
    return way.real, way.imag, load[2] - carrier[2]


def is_same(one: Pose, other: Pose) -> bool:
    """Return whether two offsets are the same, but for rounding."""
    turned = abs(complex(math.cos(one[2]), math.sin(one[2])) - complex(
        math.cos(other[2]), math.sin(other[2])))  # fmt: skip
    return max(math.hypot(one[0] - other[0], one[1] - other[1]), turned) <= TOLERANCES.rigid


def carried_along(poses: FloatArray, offset: Pose) -> FloatArray:
    """Return the poses (n, 3) of a load on a carrier at ``poses`` (n, 3)."""
    points = placed(np.array([offset[:2]]), poses)[:, 0]
    return np.column_stack((points, poses[:, 2] + offset[2]))


def between(carrier: JudgedShape, loads: Sequence[tuple[JudgedShape, Pose]]) -> JudgedShape | None:
    """Return what holds a carrier and its loads together, in the carrier's frame: nothing where
    they are one polygon without holes, else their convex hull.
    """
    parts = [shapely.Polygon(carrier.corners)]
    for shape, offset in loads:
        parts.append(shapely.Polygon(placed(shape.corners, np.array([offset]))[0]))
    grown = shapely.union_all([p.buffer(TOLERANCES.closed_gap, join_style="mitre") for p in parts])
    if grown.geom_type == "Polygon" and all(
        shapely.Polygon(hole).buffer(-TOLERANCES.closed_gap).is_empty for hole in grown.interiors
    ):
        return None
    hull = shapely.union_all(parts).convex_hull
    height = max(carrier.height, *(shape.height for shape, _ in loads))
    return JudgedShape(f"{carrier.name} with its load", np.array(hull.exterior.coords)[:-1], height)
