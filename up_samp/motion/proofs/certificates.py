"""Proofs that a motion is impossible, in milliseconds.

While a footprint moves, the largest disc inside it moves through free space. A cell in which that
disc's centre can nowhere be is *surely blocked*; if the cells that are not fall apart (8-connected)
so that two configurations lie in different components, no motion of any kind joins them.

For a blocked cell of the map, every point of a cell whose centre is ``d`` away (centre to centre)
is at most ``d`` from the blocked *square*, so ``d < r`` surely blocks it. For a convex obstacle the
distance is a convex function, so its largest value over a cell is at a corner. Both are exact
statements about whole cells: rounding to the grid never makes a false proof.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Scene
from up_samp.geometry.cells import distances_to, label_regions, nearest_to
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import GridFrame, PolyData, along, grid_along, grid_point, kernel
from up_samp.geometry.shapes import core_of, shape_of
from up_samp.model import Body, Configuration, Deadline, Outcome, PathReport, Placed, check_time
from up_samp.model.arrays import BoolArray, Int32Array, IntArray
from up_samp.model.graphs import reached
from up_samp.motion.guides import point_to_convex
from up_samp.motion.proofs.heading_slices import MOST_BOXES, separated
from up_samp.motion.proofs.orders import (
    Blocks,
    Hub,
    finer,
    hubs_of,
    joint_positions,
    parts_of,
    positions_reached,
    too_many,
)
from up_samp.motion.protocol import obstacle_key

Apart = Callable[[Sequence[Configuration]], bool]
Rounds = Callable[[Sequence[Configuration]], set[int] | None]
"""How much more often the first of two bodies may have gone round a hub than the second, when they
come to some configurations together (None: nothing is known of these)."""
PAIRS = ((0, 1), (1, 2), (0, 2))
"""Of three bodies: what the first two tell adds up to what the last one does."""


class Certifier:
    """Proves motions impossible in one scene. Caches components by body size and obstacles, so
    many as are ``kept``.

    All proofs are made for the body's core (:func:`up_samp.geometry.shapes.core_of`): contact, and
    overlaps that are rounding to the validator, prove nothing.
    """

    def __init__(self, scene: Scene, kept: int = 64) -> None:
        self.scene = scene
        self._regions: Memory[Regions] = Memory(kept)
        self._joint: Memory[tuple[Certifier, list[Blocks], list[BoolArray]]] = Memory(64)
        self._fine: dict[int, Certifier] = {}

    @cached_property
    def _distance(self) -> npt.NDArray[np.float32]:
        """Distance (m), centre to centre, from each cell to the nearest blocked or outside one."""
        assert self.scene.grid is not None
        padded = np.pad(self.scene.grid.blocked, 1, constant_values=True)
        return distances_to(padded, self.scene.grid.resolution, np.float32)[1:-1, 1:-1]

    @cached_property
    def nearest(self) -> Int32Array:
        """(row + 1, column + 1) of the blocked or outside cell nearest to each cell."""
        assert self.scene.grid is not None
        padded = np.pad(self.scene.grid.blocked, 1, constant_values=True)
        return np.ascontiguousarray(nearest_to(padded)[:, 1:-1, 1:-1])

    def prove(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> PathReport | None:
        """Return a report that driving through ``poses`` is impossible, or None (no proof)."""
        body = core_of(body)
        for k, pose in enumerate(poses):
            if not self.scene.map_free(body, pose):
                where = ", ".join(f"{v:g}" for v in pose[:3])
                reason = f"the configuration ({where}) collides with the map"
                return replace(_impossible(reason, ()), where=k)
        apart = self._apart(body, poses, obstacles)
        if frozenset() in apart:
            return _impossible("no free way between the configurations on the map", ())
        hit = [
            (p.name, k)
            for k, at in enumerate(poses)
            for p in obstacles
            if self.scene.overlap(body, at, p.body, p.pose)
        ]
        if hit:
            blocker, k = min(hit)
            where = ", ".join(f"{v:g}" for v in poses[k][:3])
            reason = f"the configuration ({where}) collides with '{blocker}'"
            return replace(_impossible(reason, (blocker,)), where=k)
        if not apart:
            return None
        return _impossible(f"no free way past {', '.join(sorted(apart[0]))}", apart[0])

    def _apart(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> list[frozenset[str]]:
        """Return, for each two successive poses that are surely apart, a minimal set of obstacles
        that keeps them so (none of them: the map alone does).
        """
        if self.scene.grid is None or len(poses) < 2:
            return []
        regions, names = self._at(body, obstacles)
        # 0 says nothing
        labels = [self._cell(regions.labels, body, pose, 0) for pose in poses]
        found = []
        for start, goal in pairwise(labels):
            if start == 0 or goal in (0, start) or regions.reaches(start, goal, 0):
                continue
            removed = 0
            for i in reversed(range(len(names))):
                if not regions.reaches(start, goal, removed | 1 << i):
                    removed |= 1 << i
            found.append(frozenset(name for i, name in enumerate(names) if not removed >> i & 1))
        return found

    def left(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> float:
        """Return metres of any way through ``poses`` that its reference point surely has before it
        when the obstacles go away, since it gets no further while they rest (0: none are proven).
        """
        if self.scene.grid is None:
            return 0.0
        body, frame = core_of(body), self.scene.data.frame
        regions, _ = self._at(body, obstacles)
        cells = [self._cell(regions.labels, body, pose, 0) for pose in poses]
        # the disc's centre is so far (cells) from the middle of its cell and the reference point
        off = math.sqrt(0.5) + math.hypot(*shape_of(body).inner[:2]) / frame.size
        most = beyond = 0.0
        for (a, b), (start, goal) in zip(
            reversed(list(pairwise(cells))), reversed(list(pairwise(poses))), strict=True
        ):
            if a and b not in (0, a) and not regions.owners.get(a, 0):
                gx, gy = along(frame, goal[0], goal[1])
                rows, cols = np.nonzero(regions.labels == a)
                far = np.hypot(cols + 0.5 - gx / frame.size, rows + 0.5 - gy / frame.size)
                most = max(most, (float(far.min()) - off) * frame.size + beyond)
            beyond += math.dist(start[:2], goal[:2])
        return most

    def prove_slowly(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed],
        deadline: Deadline,
    ) -> PathReport | None:
        """Return a proof on a finer grid, or over positions *and* headings, or None; takes up to
        seconds.

        See :mod:`up_samp.motion.proofs.heading_slices`. Blockers are minimal where time allows.
        """
        if self.scene.grid is None:
            return None
        fine = self._finer(shape_of(core_of(body)).inner[2], MOST_BOXES)
        proof = None if fine is None else fine.prove(body, (start, goal), obstacles)
        if proof is not None:
            return proof
        body = core_of(body)

        def apart(among: Sequence[Placed]) -> bool:
            return separated(self.scene, self.nearest, body, (start, goal), among, deadline)

        rest = list(obstacles)
        if not apart(rest):
            return None
        for placed in sorted(obstacles, key=lambda p: p.name):
            others = [p for p in rest if p is not placed]
            if apart(others):
                rest = others
            elif deadline.expired():
                break
        names = [p.name for p in rest]
        reason = f"too narrow for the footprint past {', '.join(names)}"
        if not names:
            reason = "too narrow for the footprint on the map"
        return _impossible(reason, names)

    def in_order(self, placed: Sequence[Placed], obstacles: Sequence[Placed]) -> Apart | None:
        """Return what tells whether no motions lead two bodies, or three, that keep clear of each
        other from where they rest to other configurations, all at one time (None: nothing is
        proven): see :mod:`up_samp.motion.proofs.orders`.
        """
        if self.scene.grid is None:
            return None
        least = min(shape_of(core_of(one.body)).inner[2] for one in placed)
        if len(placed) == 2:
            rounds = self._rounds(placed, obstacles, least, None)
            return None if rounds is None else lambda goals: rounds(goals) == set()
        hubs = range(len(self._hubs(least, obstacles)))
        all_told = [self._rounds_of_pairs(placed, obstacles, least, number) for number in hubs]
        told = [pairs for pairs in all_told if pairs is not None]
        return (lambda goals: any(_none_agree(p, goals) for p in told)) if told else None

    def _rounds_of_pairs(
        self, placed: Sequence[Placed], obstacles: Sequence[Placed], least: float, number: int
    ) -> list[Rounds] | None:
        """Return the rounds of the ``PAIRS`` of three bodies (None: some pass each other)."""
        found = []
        for i, j in PAIRS:
            rounds = self._rounds((placed[i], placed[j]), obstacles, least, number)
            if rounds is None:
                return None
            found.append(rounds)
        return found

    def _rounds(
        self,
        placed: Sequence[Placed],
        obstacles: Sequence[Placed],
        least: float,
        number: int | None,
    ) -> Rounds | None:
        """Return the rounds of two bodies about a hub (its ``number``; None: about none), or None:
        nothing is proven, or they pass each other. ``least`` (m): radius of the least disc.
        """
        cores = [core_of(one.body) for one in placed]
        radii = [shape_of(core).inner[2] for core in cores]
        key = (*(round(r, 9) for r in (*radii, least)), obstacle_key(obstacles), number)
        made = self._joint.get(key)
        if made is None:
            made = self._joint.put(key, (*self._blocks(radii, obstacles, least, number), []))
        fine, blocks, known = made

        def at(poses: Sequence[Configuration]) -> tuple[int, ...]:
            each = zip(blocks, cores, poses, strict=False)  # there may be none
            return tuple(fine._cell(ids, core, pose, -1) for (ids, *_), core, pose in each)

        start = at([one.pose for one in placed])
        if min(start, default=-1) < 0:
            return None
        seen = next((some for some in known if some[start].any()), None)
        if seen is None:
            seen = positions_reached(blocks, fine._in_cells(radii), start)
            known.append(seen)
        if seen[..., [0, -1]].any():
            return None
        begun = int(np.argmax(seen[start]))  # never in two, unless they pass

        def rounds(goals: Sequence[Configuration]) -> set[int] | None:
            ends = at(goals)
            return None if min(ends) < 0 else set((np.flatnonzero(seen[ends]) - begun).tolist())

        return rounds

    def _in_cells(self, lengths: Sequence[float]) -> list[float]:
        """Return lengths (m) in cells."""
        assert self.scene.grid is not None
        return [length / self.scene.grid.resolution for length in lengths]

    def _finer(self, radius: float, most: float = math.inf) -> Certifier | None:
        """Return the same on a grid that is fine beside a disc (centimetres decide whether it gets
        through), or None where that has more than so many cells.
        """
        assert self.scene.grid is not None
        parts = parts_of(self.scene.grid, radius)
        if self.scene.grid.blocked.size * parts**2 > most:
            return None
        if parts not in self._fine:
            grid = finer(self.scene.grid, parts)
            # on fine grids components take a lot of memory
            self._fine[parts] = Certifier(Scene(grid, self.scene.margin), kept=4)
        return self._fine[parts]

    def _finer_for_two(self, least: float, obstacles: Sequence[Placed]) -> Certifier | None:
        """Return the same on a finer grid, or None where there are too many joint positions."""
        barred = self.blocked(least, obstacles)
        if too_many([barred, barred], self._in_cells([least, least])):
            return None
        return self._finer(least)

    def _hubs(self, least: float, obstacles: Sequence[Placed]) -> list[Hub]:
        """Return the hubs of the islands on the finer grid."""
        fine = self._finer_for_two(least, obstacles)
        return [] if fine is None else hubs_of(fine.blocked(least, obstacles))

    def _blocks(
        self,
        radii: Sequence[float],
        obstacles: Sequence[Placed],
        least: float,
        number: int | None,
    ) -> tuple[Certifier, list[Blocks]]:
        """Return the blocks for joint positions of discs, on the finer grid."""
        fine = self._finer_for_two(least, obstacles)
        if fine is None:
            return self, []
        hub = None if number is None else hubs_of(fine.blocked(least, obstacles))[number]
        barred = [fine.blocked(radius, obstacles) for radius in radii]
        assert fine.scene.grid is not None
        return fine, joint_positions(fine.scene.grid.blocked, barred, fine._in_cells(radii), hub)

    def hits_map(self, body: Body, pose: Configuration) -> bool:
        """Return whether a pose surely overlaps the map's blocked cells or its outside."""
        return not self.scene.map_free(core_of(body), pose)

    def _cell(
        self, values: IntArray | Int32Array, body: Body, pose: Configuration, outside: int
    ) -> int:
        """Return the value in the cell of the inner disc's centre."""
        assert self.scene.grid is not None
        cx, cy, _ = shape_of(body).inner
        c, s = math.cos(pose[2]), math.sin(pose[2])
        point = (pose[0] + c * cx - s * cy, pose[1] + s * cx + c * cy)
        row, col = self.scene.grid.cells_of([point])[0]
        rows, cols = values.shape
        return int(values[row, col]) if 0 <= row < rows and 0 <= col < cols else outside

    def _at(self, body: Body, obstacles: Sequence[Placed]) -> tuple[Regions, list[str]]:
        """Return the regions among the obstacles, and the name behind each bit."""
        placed = sorted(obstacles, key=lambda p: p.name)[:62]  # more would not fit; still sound
        radius = shape_of(body).inner[2]
        key = (round(radius, 9), tuple((p.body.footprint, tuple(p.pose)) for p in placed))
        regions = self._regions.get_or(key, lambda: self._build(radius, placed))
        return regions, [p.name for p in placed]

    def blocked(self, radius: float, obstacles: Sequence[Placed]) -> BoolArray:
        """Return the cells in which the centre of a free disc of ``radius`` m can nowhere be."""
        free, owners = self._cells(radius, sorted(obstacles, key=lambda p: p.name)[:62])
        return ~free | (owners != 0)

    def _cells(self, radius: float, placed: Sequence[Placed]) -> tuple[BoolArray, IntArray]:
        """Return the cells not blocked by the map, and the obstacles (bits) that block each."""
        distance = self._distance
        check_time()
        free = distance >= radius - 1e-5  # float32 noise must not block a cell
        owners = np.zeros(free.shape, dtype=np.int64)
        mark_blocked(owners, self.scene.data.frame, self.scene.polys(placed), radius)
        return free, owners

    def _build(self, radius: float, placed: Sequence[Placed]) -> Regions:
        free, owners = self._cells(radius, placed)
        labels = np.empty(free.shape, dtype=np.int32)
        check_time()
        count = label_regions(free & (owners == 0), labels)
        sets: dict[int, int] = {}
        # what lies in obstacles is few cells: look at no others
        near = box_of(owners)
        zone = free[near] & (owners[near] != 0)
        for value in np.unique(owners[near][zone]):
            part = np.empty(zone.shape, dtype=np.int32)
            n = label_regions(zone & (owners[near] == value), part)
            labels[near][part > 0] = part[part > 0] + count
            sets.update((count + i, int(value)) for i in range(1, n + 1))
            count += n
        rows, cols = np.nonzero(zone)
        return Regions(labels, sets, links_of(labels, rows + near[0].start, cols + near[1].start))


def _none_agree(pairs: Sequence[Rounds], goals: Sequence[Configuration]) -> bool:
    """Return whether no rounds of the ``PAIRS`` of three bodies, on their way to ``goals``, add up
    to those of each body.
    """
    first, second, both = (
        rounds([goals[i], goals[j]]) for rounds, (i, j) in zip(pairs, PAIRS, strict=True)
    )
    if first is None or second is None or both is None:
        return False
    return not any(a + b in both for a in first for b in second)


def _impossible(reason: str, blockers: Iterable[str]) -> PathReport:
    return PathReport(
        Outcome.IMPOSSIBLE,
        blockers=frozenset(blockers),
        reason=reason,
        planner="certificate",
    )


# ------------------ Regions that a disc cannot leave, and what keeps them apart


@kernel
def mark_blocked(owners: IntArray, frame: GridFrame, polys: PolyData, radius: float) -> None:
    """Set bit i in the cells that obstacle ``i`` surely blocks for a disc of ``radius`` m."""
    rows, cols = owners.shape
    size = frame.size
    for p in range(polys.counts.shape[0]):
        bit = np.int64(1) << polys.owner[p]
        gx, gy = grid_along(frame, polys.centres[p, 0], polys.centres[p, 1])
        cx, cy = gx / size, gy / size
        span = (polys.centres[p, 2] + radius) / size + 1.0
        r0, r1 = max(0, math.floor(cy - span)), min(rows, math.ceil(cy + span))
        c0, c1 = max(0, math.floor(cx - span)), min(cols, math.ceil(cx + span))
        if r1 <= r0 or c1 <= c0:
            continue
        # taken out of the record before the loop: there it would be counted as used each time
        corners, many = polys.verts[p], polys.counts[p]
        near = np.empty((r1 - r0 + 1, c1 - c0 + 1), dtype=np.bool_)
        for row in range(r0, r1 + 1):
            for col in range(c0, c1 + 1):
                x, y = grid_point(frame, col * size, row * size)
                d = point_to_convex(x, y, corners, many)
                near[row - r0, col - c0] = d < radius - 1e-9
        for i in range(r1 - r0):
            for j in range(c1 - c0):
                if near[i, j] and near[i + 1, j] and near[i, j + 1] and near[i + 1, j + 1]:
                    owners[r0 + i, c0 + j] |= bit


@dataclass(frozen=True)
class Regions:
    """Connected regions of cells, each blocked by a (possibly empty) set of obstacles.

    ``labels`` int32 (rows, cols): 0 where the map blocks. ``owners[label]``: bit set of obstacles.
    ``links[label]``: neighbouring labels.
    """

    labels: Int32Array
    owners: Mapping[int, int]
    links: Mapping[int, frozenset[int]]

    def reaches(self, start: int, goal: int, removed: int) -> bool:
        """Return whether two labels are joined once the obstacles in ``removed`` are gone."""

        def free(some: Iterable[int]) -> list[int]:
            return [n for n in some if not self.owners.get(n, 0) & ~removed]

        return goal in reached(free([start]), lambda here: free(self.links.get(here, ())))


def box_of(owners: IntArray) -> tuple[slice, slice]:
    """Return the smallest part of the grid that holds all cells that are not 0."""
    rows = np.flatnonzero(owners.any(axis=1))
    if len(rows) == 0:
        return slice(0, 0), slice(0, 0)
    band = slice(int(rows[0]), int(rows[-1]) + 1)
    cols = np.flatnonzero(owners[band].any(axis=0))
    return band, slice(int(cols[0]), int(cols[-1]) + 1)


def links_of(
    labels: Int32Array, rows: npt.NDArray[np.intp], cols: npt.NDArray[np.intp]
) -> dict[int, frozenset[int]]:
    """Return which regions touch (8-connected); only the cells at ``rows`` and ``cols`` can join
    two regions.
    """
    links: dict[int, set[int]] = {}
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            r, c = rows + dr, cols + dc
            ok = (r >= 0) & (c >= 0) & (r < labels.shape[0]) & (c < labels.shape[1])
            mine, theirs = labels[rows[ok], cols[ok]], labels[r[ok], c[ok]]
            differ = (mine != theirs) & (theirs != 0)
            for a, b in set(zip(mine[differ].tolist(), theirs[differ].tolist(), strict=True)):
                links.setdefault(a, set()).add(b)
                links.setdefault(b, set()).add(a)
    return {label: frozenset(others) for label, others in links.items()}
