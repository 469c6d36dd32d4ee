"""Shortest ways between places, against scipy."""

import random

import numpy as np
import pytest
from scipy.sparse import csgraph

from up_samp.scheduling.cpsat.routing.route import shorten


def drawn(seed):
    rng = random.Random(seed)
    n = rng.randint(1, 9)
    share = rng.uniform(0.1, 0.9)
    pairs = [(a, b) for a in range(n) for b in range(n) if a != b and rng.random() < share]
    return n, {pair: rng.randint(0, 6) for pair in pairs} | {(a, a): 0 for a in range(n)}


@pytest.mark.parametrize("seed", range(30))
def test_lengths_are_shortest(seed):
    n, direct = drawn(seed)
    table = np.full((n, n), np.inf)
    for (a, b), length in direct.items():
        table[a, b] = length
    expected = csgraph.floyd_warshall(csgraph.csgraph_from_dense(table, null_value=np.inf))
    lengths = dict(direct)
    shorten(lengths, range(n))
    for a in range(n):
        for b in range(n):
            assert lengths.get((a, b), np.inf) == expected[a, b]
