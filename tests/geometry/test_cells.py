"""Distances, regions and shortest ways over cells, against scipy's."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import csgraph

from up_samp.geometry import cells
from up_samp.geometry.cells import convex_corners, corner_matrix
from up_samp.model import Deadline, OutOfTimeError, in_force


def _random_cells(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 60, 2))
    return rng.random(shape) < rng.choice([0.002, 0.05, 0.3, 0.6, 0.97])


def test_distances_are_scipys_bit_by_bit():
    for blocked in map(_random_cells, range(60)):
        found = cells.distances_to(blocked)
        if blocked.any():
            assert np.array_equal(found, ndimage.distance_transform_edt(~blocked))
        else:
            assert np.all(np.isinf(found))


def test_distances_of_a_large_open_map_are_scipys():
    blocked = np.random.default_rng(0).random((700, 900)) < 0.00001
    assert np.array_equal(cells.distances_to(blocked), ndimage.distance_transform_edt(~blocked))


def test_grown_cells_are_those_within_one_step():
    for blocked in map(_random_cells, range(30)):
        assert np.array_equal(cells.grown(blocked), ndimage.maximum_filter(blocked, size=3))


def test_regions_are_numbered_as_scipy_does():
    for inside in map(_random_cells, range(60)):
        labels = np.full(inside.shape, 7, dtype=np.int32)
        count = cells.label_regions(inside, labels)
        expected, n = ndimage.label(inside, structure=np.ones((3, 3)))
        assert count == n
        assert np.array_equal(labels, expected)


@pytest.mark.parametrize("seed", range(20))
def test_shortest_ways_are_scipys_bit_by_bit(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    blocked = rng.random((rng.integers(5, 25), rng.integers(5, 25))) < 0.08
    sums = np.zeros((blocked.shape[0], blocked.shape[1] + 1), dtype=np.int32)
    np.cumsum(blocked, axis=1, out=sums[:, 1:])
    lengths = corner_matrix(sums, convex_corners(blocked))
    found = cells.shortest_ways(lengths)
    if len(lengths):
        assert np.array_equal(found, csgraph.dijkstra(lengths))
        monkeypatch.setattr(cells, "SMALL_GRAPH", 0)
        assert np.array_equal(found, cells.shortest_ways(lengths))
    else:
        assert found.shape == (0, 0)


@pytest.mark.parametrize("band", [1, 50, 10**9])
@pytest.mark.parametrize("seed", range(12))
def test_nearest_cells_are_as_near_as_scipys(seed, band, monkeypatch):
    monkeypatch.setattr(cells, "BAND", band)
    blocked = _random_cells(seed)
    blocked[-1, 0] = True
    distances = ndimage.distance_transform_edt(~blocked)
    assert np.array_equal(cells.distances_to(blocked), distances)
    assert np.array_equal(
        cells.distances_to(blocked, 0.05, np.float32), (distances * 0.05).astype(np.float32)
    )
    row, column = cells.nearest_to(blocked)
    assert blocked[row, column].all()
    r, c = np.indices(blocked.shape)
    assert np.array_equal(np.sqrt((row - r) ** 2 + (column - c) ** 2), distances)


def test_large_grids_keep_to_the_time_limit(monkeypatch):
    monkeypatch.setattr(cells, "BAND", 100)
    blocked = _random_cells(1)
    blocked[0, 0] = True
    with in_force(Deadline.after(0.0)), pytest.raises(OutOfTimeError):
        cells.distances_to(blocked)
    with in_force(Deadline.after(100.0)):
        assert np.isfinite(cells.distances_to(blocked)).all()
