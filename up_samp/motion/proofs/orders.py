"""Who is behind whom: proofs that no motions, however many, lead two bodies somewhere together.

Where there is no room to pass, a row of robots keeps its order. The largest discs inside two bodies
never overlap, so their centres keep their radii apart. The cells in which centres may be are joined
to blocks; two blocks are a joint position where some points in them are far enough apart. Bodies go
from one joint position to those in which one of them is in a block beside its own (who passes a
corner, or at once with the other, is in all of them at that instant). What is not reached so is not
reached at all: blocks are closed, and hold more than is free.

On a ring two reach every joint position, but neither goes round more often than the other. How much
more often one has crossed a ray from an island is kept with each joint position, with ``turns`` of
the blocks beside each. Of three, these numbers have to add up: who is between whom cannot change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from up_samp.geometry import OccupancyGrid
from up_samp.geometry.cells import distances_to, label_regions
from up_samp.model import check_time
from up_samp.model.arrays import BoolArray, FloatArray, IntArray

POSITIONS = 250_000
"""Joint positions that are looked at, on rings four times as many: with more nothing is proven."""

Blocks = tuple[IntArray, FloatArray, IntArray, IntArray]
"""The block of each cell (-1: none), what it spans (x and y from, x and y to; cells), the blocks
beside it (its own, where there are fewer), and how often (1, 0 or -1) the ray from an island is
crossed on the way to each of these."""
Hub = tuple[int, int]
"""A corner of cells (row, column) inside an island: from there a ray leads along the columns."""
PASSED = 2
"""Who has gone round so much more often than the other one has passed it."""


def too_many(barred: Sequence[BoolArray], reaches: Sequence[float]) -> bool:
    """Return whether there are more joint positions than are looked at even in blocks in which two
    discs may just be.
    """
    cells = [float(np.count_nonzero(~some)) / 2 / min(reaches) ** 2 for some in barred]
    return max(barred[0].size, math.prod(cells)) > POSITIONS


def parts_of(grid: OccupancyGrid, radius: float) -> int:
    """Return into how many parts to divide cells along each side to make them small beside a
    disc.
    """
    return math.ceil(16 * grid.resolution / radius)


def finer(grid: OccupancyGrid, parts: int) -> OccupancyGrid:
    """Return a grid of the same walls in cells of a part of their sides."""
    walls = grid.blocked.repeat(parts, axis=0).repeat(parts, axis=1)
    return OccupancyGrid(walls, grid.resolution / parts, grid.origin)


def hubs_of(barred: BoolArray) -> list[Hub]:
    """Return corners deep inside islands, in which no centre can be, that ways may lead round."""
    inside = np.pad(barred, 1, constant_values=True)
    labels = np.empty(inside.shape, dtype=np.int32)
    label_regions(inside, labels)
    outside = set(np.unique(np.concatenate((labels[0], labels[-1], *labels[:, [0, -1]].T))))
    deep = distances_to(~inside, 1.0, np.float64)
    found = []
    for label in sorted(set(np.unique(labels)) - outside - {0}):
        at = int(np.argmax(np.where(labels == label, deep, -1.0)))
        if deep.flat[at] >= 2.0:  # no ways touch the corner
            row, col = divmod(at, inside.shape[1])
            found.append((row - 1, col - 1))
    return found


def joint_positions(
    walls: BoolArray,
    barred: Sequence[BoolArray],
    reaches: Sequence[float],
    hub: Hub | None = None,
) -> list[Blocks]:
    """Return the blocks of each body (none: no proof is made), as small as can be looked at.

    ``barred``: where the centre of each body's disc, that ``reaches`` so far (cells), can nowhere
    be among ``walls`` and what else there is. No block lies on both sides of the lines through the
    ``hub``.
    """
    spans = [_spans(walls, *some) for some in zip(barred, reaches, strict=True)]
    most = POSITIONS if hub is None else 4 * POSITIONS
    for size in range(1, int(min(reaches) * math.sqrt(2)) + 1):
        # no block has more cells
        if math.prod(np.count_nonzero(room) / size**2 for _, room in spans) <= most:
            found = [_blocks(*some, size, hub or walls.shape) for some in spans]
            if math.prod(len(whole) for _, whole, *_ in found) <= most:
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


def _blocks(spans: FloatArray, room: BoolArray, size: int, hub: Hub) -> Blocks:
    """Return blocks of ``size`` cells along each side."""
    rows, cols = np.nonzero(room)
    above, right = rows >= hub[0], cols >= hub[1]
    key = (rows // size) * room.shape[1] + cols // size
    _, first, own = np.unique(4 * key + 2 * above + right, return_index=True, return_inverse=True)
    count = len(first)
    ids = np.full((room.shape[0] + 1, room.shape[1] + 2), -1)
    ids[rows, cols + 1] = own
    by_block = np.argsort(own, kind="stable")
    inside = spans[rows[by_block], cols[by_block]]
    begins = np.searchsorted(own[by_block], np.arange(count))
    least = np.minimum.reduceat(inside[:, :2], begins, axis=0)
    whole = np.hstack((least, np.maximum.reduceat(inside[:, 2:], begins, axis=0)))
    near = np.eye(count, dtype=np.bool_)
    for row, col in ((0, 1), (1, -1), (1, 0), (1, 1)):
        other = ids[rows + row, cols + 1 + col]
        near[own[other >= 0], other[other >= 0]] = True
    near |= near.T
    beside = np.argsort(~near, axis=1, kind="stable")[:, : near.sum(axis=1).max(initial=1)]
    own_ones = np.arange(count)[:, None]
    beside = np.where(near[own_ones, beside], beside, own_ones)
    over, past = above[first].astype(np.int64), right[first]
    turns = np.where(past[:, None] & past[beside], over[beside] - over[:, None], 0)
    return ids[:-1, 1:-1], whole, beside, turns


def positions_reached(
    blocks: Sequence[Blocks], reaches: Sequence[float], start: Sequence[int]
) -> BoolArray:
    """Return which joint positions are reached from one of them (a block of each of two bodies), by
    how much more often the first one goes round the hub: -2, -1, 0, 1 or 2 times. Where that is 2
    they pass each other, and what else they reach is not looked at.

    :raises OutOfTimeError: where the deadline in force comes before.
    """
    shape = [*(len(spans) for _, spans, *_ in blocks), 2 * PASSED + 1]
    free = (_farthest(*(whole for _, whole, *_ in blocks)) >= sum(reaches)).ravel()
    seen, mark = np.zeros(math.prod(shape), dtype=np.bool_), np.empty(math.prod(shape), np.int64)
    new = np.ravel_multi_index([np.array([at]) for at in (*start, PASSED)], shape)
    passed = False
    while len(new) and not passed:
        check_time()
        seen[new] = True
        passed = bool(np.isin(new % shape[-1], (0, 2 * PASSED)).any())
        at, steps = np.unravel_index(new, shape), []
        for axis, (_, _, beside, turns) in enumerate(blocks):
            moved = [part[:, None] for part in at]
            moved[axis] = beside[at[axis]]
            moved[-1] = moved[-1] + (1 - 2 * axis) * turns[at[axis]]
            steps.append(np.ravel_multi_index(np.broadcast_arrays(*moved), shape).ravel())
        new = np.concatenate(steps)
        new = new[free[new // shape[-1]] & ~seen[new]]
        numbers = np.arange(len(new))
        mark[new] = numbers
        new = new[mark[new] == numbers]  # each once: to sort them takes longer
    return seen.reshape(shape)


def _farthest(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return how far apart (cells) points of two blocks are at most, for each two."""
    ahead = one[:, None, 2:] - other[None, :, :2]
    behind = other[None, :, 2:] - one[:, None, :2]
    return np.hypot.reduce(np.maximum(ahead, behind), axis=2)
