"""Bodies in space (SE3) on their paths, and where they meet others that fly or drive below them.

A body that drives reaches up to its height, or to the sky. Surfaces are compared as meshes in the
middle of each cell, with what any point moves in half a cell; what is near is halved and looked at
again (conservative advancement; Mirtich 1996).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from up_samp.geometry.meshes import contains, mesh_of, rotation, surface_distance, transform
from up_samp.model import Body, check_time
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.fleet.conflicts import runs_in

TOUCH = 5e-5
"""Clearance (m) that counts as none; path planners keep more."""
SKY = 1e4
"""How far (m) bodies that move in the plane reach down and, where they have no height, up."""
HALVES = 16
"""Rows of a cell's tree from which on its parts are not halved again: eighths of it."""
ROUND = 1.02
"""By how much more than between samples a point may move along the curve through them."""


class SolidPlace(NamedTuple):
    """Where a solid is: coal's transform, its ``pose`` (7,) and its first corner (3,)."""

    at: Any
    pose: FloatArray
    corner: FloatArray


class SweptSolid:
    """A body's surface along its path.

    :param edges: the path's cells, by parameter (m).
    :param poses_at: the poses (k, 3 or 7) at parameters (k,).
    :param ratio: how far (m) any point moves per metre of the parameter, at most.
    """

    def __init__(
        self,
        body: Body,
        radius: float,
        edges: FloatArray,
        poses_at: Callable[[FloatArray], FloatArray],
        ratio: float,
    ) -> None:
        self.flies, self.reach = body.flies, radius
        first = poses_at(edges[:1])[0]
        pose = tuple(first.tolist()) if body.flies else (0.0, 0.0, 0.0)
        self.mesh = mesh_of(body, pose, -SKY, SKY)[0]
        self.low = np.concatenate([edges[:1], edges])
        self.high = np.concatenate([edges, edges[-1:]])
        self.extents = 0.5 * ratio * (self.high - self.low)
        self.centres = in_space(poses_at(0.5 * (self.low + self.high)))[:, :3]
        self._poses_at = poses_at
        self._places: dict[tuple[int, int], SolidPlace] = {}

    def place(self, cell: int, row: int) -> SolidPlace:
        """Return where it is in the middle of a part of a cell: row 1 is all of it, rows 2k and
        2k + 1 are the halves of row k.
        """
        key = cell, row
        if key not in self._places:
            parts = 1 << (row.bit_length() - 1)
            share = (row - parts + 0.5) / parts
            s = self.low[cell] + share * (self.high[cell] - self.low[cell])
            pose = in_space(self._poses_at(np.array([s])))[0]
            corner = rotation(pose[3:].tolist()) @ self.mesh.vertices[0] + pose[:3]
            self._places[key] = SolidPlace(transform(pose), pose, corner)
        return self._places[key]

    def extent(self, cell: int, row: int) -> float:
        """Return how far (m) any point is at most from where it is in the middle of such a part."""
        return float(self.extents[cell]) / (1 << (row.bit_length() - 1))

    def holds(self, here: SolidPlace, corner: FloatArray, size: int) -> bool:
        """Return whether a point is inside; ``size``: in so many dimensions it may be far."""
        if np.linalg.norm(corner[:size] - here.pose[:size]) > self.reach:
            return False
        return contains(self.mesh, rotation(here.pose[3:].tolist()).T @ (corner - here.pose[:3]))


def in_space(poses: FloatArray) -> FloatArray:
    """Return poses (k, 7): upright on the floor, where they are in the plane."""
    if poses.shape[1] == 7:
        return poses
    found = np.zeros((len(poses), 7))
    found[:, :2] = poses[:, :2]
    found[:, 5], found[:, 6] = np.sin(0.5 * poses[:, 2]), np.cos(0.5 * poses[:, 2])
    return found


def gap(a: SweptSolid, p: SolidPlace, b: SweptSolid, q: SolidPlace) -> float:
    """Return the distance (m) of two solids; 0 where they cross, or one is inside the other."""
    found = surface_distance(a.mesh, p.at, b.mesh, q.at)
    size = 3 if a.flies and b.flies else 2
    inside = found > 0.0 and (a.holds(p, q.corner, size) or b.holds(q, p.corner, size))
    return 0.0 if inside else found


def gaps_at_ends(a: SweptSolid, b: SweptSolid) -> list[float]:
    """Return the distances (m) of two solids at the ends of their paths."""
    cells = itertools.product((0, len(a.low) - 1), (0, len(b.low) - 1))
    return [gap(a, a.place(i, 1), b, b.place(j, 1)) for i, j in cells]


def meeting_cells(a: SweptSolid, b: SweptSolid, margin: float) -> IntArray:
    """Return the cells of two paths in which the solids may come closer than ``margin`` (m), as
    rows (i, j first, j last).
    """
    # what drives is a column: there only the distance along the floor tells how far away it is
    size = 3 if a.flies and b.flies else 2
    away = np.linalg.norm(a.centres[:, None, :size] - b.centres[None, :, :size], axis=2)
    near = away - a.extents[:, None] - b.extents[None, :] <= a.reach + b.reach + margin
    for i, j in np.argwhere(near).tolist():
        check_time()
        near[i, j] = _may_meet(a, i, b, j, margin)
    return runs_in(near)


def _may_meet(a: SweptSolid, i: int, b: SweptSolid, j: int, margin: float) -> bool:
    """Return whether two solids in two cells are not shown to keep ``margin`` (m) apart."""
    todo = [(1, 1)]
    while todo:
        p, q = todo.pop()
        mine, other = a.extent(i, p), b.extent(j, q)
        clear = gap(a, a.place(i, p), b, b.place(j, q)) - margin
        if clear > mine + other + TOUCH or (clear > TOUCH and mine + other == 0.0):
            continue
        if clear <= TOUCH or (p >= HALVES and q >= HALVES):
            return True
        if q >= HALVES or (p < HALVES and mine >= other):
            todo += [(2 * p, q), (2 * p + 1, q)]
        else:
            todo += [(p, 2 * q), (p, 2 * q + 1)]
    return False
