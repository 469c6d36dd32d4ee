"""The records that compiled collision checks take: grids and their frames, footprints, bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernel_cache import KernelCache
from up_samp.model.arrays import FloatArray, Int32Array, IntArray

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile ``function`` without Python objects, once per machine (kept on disk, see
    :mod:`up_samp.geometry.kernel_cache`).

    Divisions follow IEEE 754 (no ZeroDivisionError), which halves the code to compile.
    """
    return _kept(function, True)


def lean_kernel(function: F) -> F:
    """Compile ``function`` like a :func:`kernel`, but count no uses of arrays.

    Each array that it takes out of a record would be counted twice, which takes about as long as
    all the rest of a collision check. For what neither makes arrays (numba refuses to compile that)
    nor calls what returns some: nobody would give these back.
    """
    return _kept(function, False)


def _kept(function: F, counts: bool) -> F:
    compiled = numba.njit(error_model="numpy", no_cfunc_wrapper=True, _nrt=counts)(function)
    if hasattr(compiled, "_cache"):  # not where numba is switched off
        compiled._cache = KernelCache(function)
        compiled._compiler.compile = compiled._cache.watched(compiled._compiler.compile)
    return cast(F, compiled)


def inner(function: F) -> F:
    """Compile ``function`` for use inside kernels only: no Python face, nothing on disk of its
    own.
    """
    return _within(function, True)


def lean_inner(function: F) -> F:
    """Compile ``function`` for use inside kernels only, like a :func:`lean_kernel`."""
    return _within(function, False)


def _within(function: F, counts: bool) -> F:
    # said of each: what is not said, a function takes over from the one that calls it first
    compiled: F = numba.njit(
        error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=counts
    )(function)
    return compiled


Coordinate = TypeVar("Coordinate", float, FloatArray)


class GridFrame(NamedTuple):
    """Where a grid lies: its corner ``x``, ``y`` (m); ``cos``, ``sin`` and ``yaw`` (rad) of its
    columns' axis; the ``size`` (m) of a cell.
    """

    x: float
    y: float
    cos: float
    sin: float
    yaw: float
    size: float


def along(frame: GridFrame, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
    """Return how far (m) a point lies from the grid's corner along its columns and its rows."""
    dx, dy = x - frame.x, y - frame.y
    return frame.cos * dx + frame.sin * dy, frame.cos * dy - frame.sin * dx


grid_along = lean_inner(along)
"""The same within kernels."""


@lean_inner
def grid_point(frame: GridFrame, gx: float, gy: float) -> tuple[float, float]:
    """Return the point so far (m) along a grid's columns and rows from its corner."""
    return (
        frame.x + frame.cos * gx - frame.sin * gy,
        frame.y + frame.sin * gx + frame.cos * gy,
    )


class GridData(NamedTuple):
    """A map for the kernels.

    ``sums``: int32 (rows + 1, cols + 1), summed-area table of the blocked cells. ``clearance``:
    float32 (rows, cols), the smallest distance (m) between any point of the cell and any blocked
    cell or the outside of the map. Without a map both arrays have no rows.
    """

    sums: Int32Array
    clearance: npt.NDArray[np.float32]
    frame: GridFrame


class RuleData(NamedTuple):
    """Rules of ways (:mod:`up_samp.geometry.kernels`) by convex parts of the floor: ``verts`` (n,
    corners, 2), counter-clockwise, ``counts`` (n,); ``rules`` (n, 3): the unit direction against
    which nothing may move there (0, 0: any), and whether nothing turns on the spot (1).
    """

    verts: FloatArray
    counts: IntArray
    rules: FloatArray


class ShapeData(NamedTuple):
    """A footprint for the kernels.

    ``verts``: (levels, parts, corners, 2) convex parts, counter-clockwise, in the body frame; level
    0 bare, level 1 inflated by the margin, level k by the margin and ``slack[k]`` (ascending).
    ``counts``: (levels, parts). ``discs``: (k, 3) x, y, r that cover it.
    ``radius``: of the circumscribed disc about the reference point; ``margin``; both in m.
    ``ways``: rules that its motions keep.
    """

    verts: FloatArray
    counts: IntArray
    slack: FloatArray
    discs: FloatArray
    radius: float
    margin: float
    ways: RuleData


class PolyData(NamedTuple):
    """Convex obstacles in the world frame: ``verts`` (n, corners, 2) counter-clockwise, ``counts``
    (n,), ``centres`` (n, 3) x, y, r of a covering disc, ``owner`` (n,) index of the object.
    """

    verts: FloatArray
    counts: IntArray
    centres: FloatArray
    owner: IntArray


class WorldData(NamedTuple):
    """A footprint and all that it can collide with: the map and the resting objects."""

    grid: GridData
    polys: PolyData
    shape: ShapeData


NO_FRAME = GridFrame(0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
"""The frame of a grid that is not there."""


def open_plane() -> GridData:
    """Return the map without walls."""
    return GridData(np.zeros((1, 1), np.int32), np.zeros((0, 0), np.float32), NO_FRAME)
