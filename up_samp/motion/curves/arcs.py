"""Paths as arcs: rows of (curvature 1/m, signed length m) driven one after the other from a pose.

A negative length is driven backwards. A *run* is a maximal stretch in one direction; a car rests
between runs.
"""

from __future__ import annotations

import numpy as np

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import kernel
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import TINY, DriveLimits, driven_on, run_time


@kernel
def path_time(arcs: FloatArray, car: DriveLimits) -> float:
    """Return the time (s) to drive ``arcs`` (n, 2) from rest to rest, resting at each cusp."""
    time, run = 0.0, 0.0
    for i in range(arcs.shape[0]):
        time, run = driven_on(time, run, arcs[i, 0], arcs[i, 1], car)
    return time + run_time(abs(run), car.v, car.a)


@kernel
def nodes_of(start: FloatArray, arcs: FloatArray) -> FloatArray:
    """Return the poses (n + 1, 3) at the ends of the arcs; theta is continuous."""
    nodes = np.empty((arcs.shape[0] + 1, 3))
    nodes[0, 0], nodes[0, 1], nodes[0, 2] = start[0], start[1], start[2]
    for i in range(arcs.shape[0]):
        x, y, th = advance(nodes[i, 0], nodes[i, 1], nodes[i, 2], arcs[i, 0], arcs[i, 1])
        nodes[i + 1, 0], nodes[i + 1, 1], nodes[i + 1, 2] = x, y, th
    return nodes


@kernel
def merged(arcs: FloatArray) -> FloatArray:
    """Return the same path with neighbours of equal curvature and direction joined."""
    out = np.empty((arcs.shape[0], 2))
    n = 0
    for i in range(arcs.shape[0]):
        if abs(arcs[i, 1]) <= TINY:
            continue
        if n > 0 and abs(out[n - 1, 0] - arcs[i, 0]) < 1e-12 and out[n - 1, 1] * arcs[i, 1] > 0.0:
            out[n - 1, 1] += arcs[i, 1]
        else:
            out[n, 0], out[n, 1] = arcs[i, 0], arcs[i, 1]
            n += 1
    return out[:n].copy()


@kernel
def ends_of(arcs: FloatArray) -> FloatArray:
    """Return the distance (m) driven at the end of each arc."""
    out = np.empty(arcs.shape[0])
    total = 0.0
    for i in range(arcs.shape[0]):
        total += abs(arcs[i, 1])
        out[i] = total
    return out


def reversed_arcs(arcs: FloatArray) -> FloatArray:
    """Return the arcs of the same path driven from its end to its start."""
    out = arcs[::-1].copy()
    out[:, 1] *= -1.0
    return out


def length_of(arcs: FloatArray) -> float:
    """Return the length (m) of a path."""
    return float(np.abs(arcs[:, 1]).sum())
