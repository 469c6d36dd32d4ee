"""A binary heap of row numbers over plain arrays, for the compiled searches."""

from __future__ import annotations

from up_samp.geometry.records import inner
from up_samp.model.arrays import FloatArray, IntArray


@inner
def push(heap: IntArray, rows: FloatArray, counters: IntArray, item: int) -> None:
    """Add a row number. The last column of ``rows`` is the order, ``counters[1]`` the size."""
    last = rows.shape[1] - 1
    i = counters[1]
    counters[1] += 1
    while i > 0:
        up = (i - 1) // 2
        if rows[heap[up], last] <= rows[item, last]:
            break
        heap[i] = heap[up]
        i = up
    heap[i] = item


@inner
def pop(heap: IntArray, rows: FloatArray, counters: IntArray) -> int:
    """Remove and return the row number with the least value in the last column of ``rows``."""
    last = rows.shape[1] - 1
    top = heap[0]
    counters[1] -= 1
    n = counters[1]
    item = heap[n]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and rows[heap[child + 1], last] < rows[heap[child], last]:
            child += 1
        if rows[heap[child], last] >= rows[item, last]:
            break
        heap[i] = heap[child]
        i = child
    heap[i] = item
    return int(top)
