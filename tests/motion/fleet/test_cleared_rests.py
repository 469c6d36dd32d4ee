"""Rests that a planner has proven clear of are no conflicts, whatever the cells say."""

import random
from types import SimpleNamespace

import numpy as np

from up_samp.motion.fleet.workspace import but_cleared


def rows_of(blocked):
    """Return conflicting cells as rows (i, j first, j last)."""
    rows = []
    for i, row in enumerate(blocked):
        j = 0
        while j < len(row):
            first = j
            while j < len(row) and row[j]:
                j += 1
            if j > first:
                rows.append((i, first, j - 1))
            j += 1
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def dense(rows, shape):
    blocked = np.zeros(shape, dtype=bool)
    for i, first, last in rows:
        blocked[i, first : last + 1] = True
    return blocked


def test_rows_and_columns_of_cleared_rests_are_taken_out():
    rng = random.Random(0)
    for _ in range(400):
        cells = rng.randrange(4), rng.randrange(4)
        shape = cells[0] + 2, cells[1] + 2
        blocked = np.array([[rng.random() < 0.6 for _ in range(shape[1])] for _ in range(shape[0])])
        rests = {"a": ("a first", "a last"), "b": ("b first", "b last")}
        cleared = {name: {r for r in rests[o] if rng.random() < 0.4} for name, o in ("ab", "ba")}
        a, b = (
            SimpleNamespace(cells=n, rests=rests[name], cleared=cleared[name])
            for n, name in zip(cells, "ab", strict=True)
        )
        rows = rows_of(blocked)
        kept = rows.copy()
        expected = blocked.copy()
        for number, at in enumerate((0, -1)):
            if rests["a"][number] in b.cleared:
                expected[at, :] = False
            if rests["b"][number] in a.cleared:
                expected[:, at] = False
        assert (dense(but_cleared(rows, a, b), shape) == expected).all()
        assert (rows == kept).all(), "what is remembered is not changed"
