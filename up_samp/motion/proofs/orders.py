"""Who is behind whom: proofs that no motions, however many, lead two bodies somewhere together.

Where there is no room to pass, a row of robots keeps its order. The largest discs inside two bodies
never overlap, so their centres keep their radii apart. The cells in which centres may be are joined
to blocks; two blocks are a joint position where some points in them are far enough apart. Bodies go
from one joint position to those in which one of them is in a block beside its own (who passes a
corner, or at once with the other, is in all of them at that instant). What is not reached so is not
reached at all: blocks are closed, and hold more than is free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from up_samp.geometry import OccupancyGrid
from up_samp.model import check_time
from up_samp.model.arrays import BoolArray, FloatArray, IntArray

POSITIONS = 250_000
"""Joint positions that are looked at: with more of them nothing is proven."""

Blocks = tuple[IntArray, FloatArray, IntArray]
"""The block of each cell (-1: none), what it spans (x and y from, x and y to; cells) and the blocks
beside it (its own, where there are fewer)."""


def too_many(barred: Sequence[BoolArray], reaches: Sequence[float]) -> bool:
    """Return whether there are more joint positions than are looked at even in blocks in which two
    discs may just be.
    """
    cells = [float(np.count_nonzero(~some)) / 2 / min(reaches) ** 2 for some in barred]
    return max(barred[0].size, math.prod(cells)) > POSITIONS


def finer(grid: OccupancyGrid, radius: float) -> OccupancyGrid:
    """Return a grid of the same walls in cells that are small beside a disc."""
    parts = math.ceil(16 * grid.resolution / radius)
    walls = grid.blocked.repeat(parts, axis=0).repeat(parts, axis=1)
    return OccupancyGrid(walls, grid.resolution / parts, grid.origin)


def joint_positions(
    walls: BoolArray, barred: Sequence[BoolArray], reaches: Sequence[float]
) -> list[Blocks]:
    """Return the blocks of each body (none: no proof is made), as small as can be looked at.

    ``barred``: where the centre of each body's disc, that ``reaches`` so far (cells), can nowhere
    be among ``walls`` and what else there is.
    """
    spans = [_spans(walls, *some) for some in zip(barred, reaches, strict=True)]
    for size in range(1, int(min(reaches) * math.sqrt(2)) + 1):
        # no block has more cells
        if math.prod(np.count_nonzero(room) / size**2 for _, room in spans) <= POSITIONS:
            found = [_blocks(*some, size) for some in spans]
            if math.prod(len(whole) for _, whole, _ in found) <= POSITIONS:
                return found
    return []


def _spans(walls: BoolArray, barred: BoolArray, reach: float) -> tuple[FloatArray, BoolArray]:
    """Return where a centre may be in each cell (x and y from, x and y to; cells), as far from the
    walls in its own row and column as the disc reaches, and which cells have room for it.
    """
    low, high = [], []
    for axis, along in enumerate(np.indices(walls.shape)):
        last = np.maximum.accumulate(np.where(walls, along, -1), axis)
        end = walls.shape[axis]
        back = np.flip(np.where(walls, along, end), axis)
        following = np.flip(np.minimum.accumulate(back, axis), axis)
        low.append(np.maximum(last + 1 + reach, along))
        high.append(np.minimum(following - reach, along + 1))
    spans = np.stack([low[1], low[0], high[1], high[0]], axis=-1)
    return spans, ~barred & np.all(spans[..., :2] <= spans[..., 2:], axis=-1)


def _blocks(spans: FloatArray, room: BoolArray, size: int) -> Blocks:
    """Return blocks of ``size`` cells along each side."""
    rows, cols = np.nonzero(room)
    _, own = np.unique((rows // size) * room.shape[1] + cols // size, return_inverse=True)
    count = int(own.max(initial=-1)) + 1
    ids = np.full((room.shape[0] + 1, room.shape[1] + 2), -1)
    ids[rows, cols + 1] = own
    whole = np.repeat([[np.inf, np.inf, -np.inf, -np.inf]], count, axis=0)
    np.minimum.at(whole[:, :2], own, spans[rows, cols, :2])
    np.maximum.at(whole[:, 2:], own, spans[rows, cols, 2:])
    near = np.eye(count, dtype=np.bool_)
    for row, col in ((0, 1), (1, -1), (1, 0), (1, 1)):
        other = ids[rows + row, cols + 1 + col]
        near[own[other >= 0], other[other >= 0]] = True
    near |= near.T
    beside = np.argsort(~near, axis=1, kind="stable")[:, : near.sum(axis=1).max(initial=1)]
    own_ones = np.arange(count)[:, None]
    beside = np.where(near[own_ones, beside], beside, own_ones)
    return ids[:-1, 1:-1], whole, beside


def reached(blocks: Sequence[Blocks], reaches: Sequence[float], start: Sequence[int]) -> BoolArray:
    """Return which joint positions are reached from one of them (a block of each body).

    :raises OutOfTimeError: where the deadline in force comes before.
    """
    shape = [len(spans) for _, spans, _ in blocks]
    free = _farthest(*(whole for _, whole, _ in blocks)) >= sum(reaches)
    seen = np.zeros(shape, dtype=np.bool_)
    new = np.ravel_multi_index([np.array([at]) for at in start], shape)
    while len(new):
        check_time()
        seen.flat[new] = True
        at, steps = np.unravel_index(new, shape), []
        for axis, (_, _, beside) in enumerate(blocks):
            moved = [part[:, None] for part in at]
            moved[axis] = beside[at[axis]]
            steps.append(np.ravel_multi_index(np.broadcast_arrays(*moved), shape).ravel())
        new = np.unique(np.concatenate(steps))
        new = new[free.flat[new] & ~seen.flat[new]]
    return seen


def _farthest(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return how far apart (cells) points of two blocks are at most, for each two."""
    ahead = one[:, None, 2:] - other[None, :, :2]
    behind = other[None, :, 2:] - one[:, None, :2]
    return np.hypot.reduce(np.maximum(ahead, behind), axis=2)
