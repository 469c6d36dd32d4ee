"""Ways along the lanes that robots prefer: through which poses they lead.

Shortest ways (Dijkstra) on a graph of points on the lanes, on which a metre counts for less than
beside them. Lanes join where points of theirs are near each other. A guide that proves nothing: a
planner has to find a motion through these poses, and what that lasts decides.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import shapely

from up_samp.model import Body, Configuration, TrafficZone
from up_samp.model.arrays import FloatArray

Length = Callable[[Body, Configuration, Configuration], float]
"""Metres that no way of a body between two planar poses can beat."""


def along_lanes(
    body: Body, poses: Sequence[Configuration], length: Length
) -> tuple[Configuration, ...]:
    """Return poses (m, rad) that a body drives through, with those between them that lead along
    the lanes that it prefers, where these are worth it.
    """
    # a third of a second, for those only who have lanes
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial.distance import cdist

    lanes = body.kinematics.lanes
    whole = [_middle(lane) for lane in lanes]
    apart = max(0.5, sum(line.length for line in whole) / 200)  # m; few are quick to look at
    lines = [shapely.get_coordinates(shapely.segmentize(line, apart)) for line in whole]
    counts = [len(line) for line in lines]
    points, number = np.concatenate(lines), np.repeat(np.arange(len(lanes)), counts)
    shares = np.repeat([1.0 / lane.prefer for lane in lanes], counts)
    gaps = cdist(points, points)
    costs = np.where(number == number[:, None], gaps * shares, gaps + 1e-6)
    graph = np.zeros((len(points) + 2, len(points) + 2))  # 0: no edge
    graph[2:, 2:] = np.where(gaps <= apart * (1.0 + 1e-6), costs, 0.0)
    found = list(poses[:1])
    for start, goal in itertools.pairwise(poses):
        rows = [(float(x), float(y), 0.0) for x, y in points]
        graph[0, 1:] = [length(body, start, to) for to in (goal, *rows)]
        graph[2:, 1] = [length(body, at, goal) for at in rows]
        _, before = dijkstra(graph, indices=0, return_predecessors=True)
        way = [1]
        while way[-1] > 0:
            way.append(int(before[way[-1]]))
        found += [*_turned(points[np.array(way[-2:0:-1], dtype=np.int64) - 2], body), goal]
    return tuple(found)


def _middle(lane: TrafficZone) -> shapely.LineString:
    """Return the middle of a lane's length (m), but for half its width at both ends."""
    box = shapely.oriented_envelope(shapely.Polygon(lane.polygon))
    corners = shapely.get_coordinates(box)[:4]
    sides = np.roll(corners, -1, axis=0) - corners
    if np.hypot(*sides[0]) < np.hypot(*sides[1]):
        corners, sides = np.roll(corners, -1, axis=0), np.roll(sides, -1, axis=0)
    ends = 0.5 * (corners[[0, 1]] + corners[[3, 2]])
    inset = min(0.5, 0.5 * np.hypot(*sides[1]) / np.hypot(*sides[0])) * sides[0]
    return shapely.LineString([ends[0] + inset, ends[1] - inset])


def _turned(points: FloatArray, body: Body) -> list[Configuration]:
    """Return two poses for each straight piece of a way through points (n, 2): so far from its ends
    that a body turns into it and out of it; none for shorter pieces.
    """
    steps = np.diff(points, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    bends = np.abs(np.exp(1j * np.diff(headings)) - 1.0) > 1e-3
    rests = np.hypot(*steps.T) < 1e-3
    ends = [0, *(1 + np.flatnonzero(bends | rests[1:] | rests[:-1])), len(steps)]
    turn = max(0.5, body.kinematics.bend_radius)
    pieces = [
        (points[a], points[b], math.dist(points[a], points[b]))
        for a, b in itertools.pairwise(ends)
        if b > a and math.dist(points[a], points[b]) > 2.0 * turn
    ]
    return [
        (float(x), float(y), math.atan2(*(to - at)[::-1]))
        for at, to, long in pieces
        for x, y in (at + (to - at) * turn / long, to - (to - at) * turn / long)
    ]
