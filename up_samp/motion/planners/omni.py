"""Motions of bodies that move in any direction (SE2): A*, shortcuts, blended corners."""

from __future__ import annotations

import itertools
import math
import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Scene, Shape, sweeps
from up_samp.model import Body, Configuration, Deadline, Placed, Trajectory
from up_samp.motion.curves.blending import (
    Chain,
    chain_time,
    first_speeds,
    moved_corner,
    pieces,
    settled,
    timed,
)
from up_samp.motion.curves.trajectories import at_rest
from up_samp.motion.guides.cost_to_go import Fields
from up_samp.motion.guides.search_space import pose_space, widest_shape
from up_samp.motion.planners import hybrid_astar as hybrid
from up_samp.motion.planners.omni_astar import expand_planar, shortened, straight_free
from up_samp.motion.protocol import Leg, LegQuery

FloatArray = npt.NDArray[np.float64]


GAIN = 1e-3
"""Seconds that a corner's new place must save."""


@dataclass(frozen=True)
class PlanarSettings:
    """Effort of the planar planner. ``levels``: step in inner radii of the footprint, coarse to
    fine; ``bins``: headings at each level; ``nodes``: size of each search tree.
    """

    levels: tuple[float, ...] = (1.0, 0.5, 0.25)
    bins: tuple[int, ...] = (16, 24, 36)
    nodes: tuple[int, ...] = (60_000, 250_000, 400_000)
    weight: float = 1.15
    rounds: int = 600
    shifts: tuple[float, ...] = (0.25, 1.0, 0.5)
    slice: int = 4000


class PlanarPlanner:
    """Plans legs of omnidirectional bodies in one scene. Deterministic for a seed."""

    name = "planar-astar"
    reversible = True

    def __init__(self, scene: Scene, seed: int = 0, settings: PlanarSettings | None = None) -> None:
        self.scene = scene
        self.seed = seed
        self.settings = settings or PlanarSettings()
        self.fields = Fields(scene)
        self._lock = threading.Lock()

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a fast motion between two poses among resting obstacles."""
        body, start, goal, obstacles = query.body, query.start, query.goal, query.obstacles
        with self._lock:
            shape = widest_shape(self.scene, body, (start, goal), obstacles)
            if shape is None:
                return Leg(None, "the start or the goal touches the map or an obstacle")
            chain, reason, effort = self._chain(body, shape, start, goal, obstacles, deadline)
            if chain is None:
                return Leg(None, reason, effort)
            motion = self._timed(body, shape, chain, goal, obstacles)
            if motion is not None:
                motion = self._rounded(body, shape, chain, goal, obstacles, motion, deadline)
            if motion is None:
                return Leg(None, "no safe timing along the path found", effort)
            return Leg(motion, "", effort)

    def _chain(
        self,
        body: Body,
        shape: Shape,
        start: Configuration,
        goal: Configuration,
        obstacles: tuple[Placed, ...],
        deadline: Deadline,
    ) -> tuple[FloatArray | None, str, int]:
        """Return nodes (n, 3) of straight pieces, theta continuous, or None and why not."""
        effort, reason = 0, "out of time"
        for level in range(len(self.settings.levels)):
            nodes, count, dry = self._search(body, shape, start, goal, obstacles, level, deadline)
            effort += count
            if nodes is not None:
                kin = body.kinematics
                limits = np.array([kin.v_max, kin.omega_max, kin.a_max])
                data, polys = self.scene.data, self.scene.polys(obstacles)
                nodes = shortened(
                    data, polys, shape.data, nodes, limits, self.settings.rounds, self.seed
                )
                return pieces(nodes), "", effort
            reason = "no path at the finest resolution" if dry else "out of time"
            if deadline.expired():
                return None, "out of time", effort
        return None, reason, effort

    def _search(
        self,
        body: Body,
        shape: Shape,
        start: Configuration,
        goal: Configuration,
        obstacles: tuple[Placed, ...],
        level: int,
        deadline: Deadline,
    ) -> tuple[FloatArray | None, int, bool]:
        """Run A* at one resolution; return the chain or None, expansions, whether it ran dry."""
        settings, kin = self.settings, body.kinematics
        origin, target = (np.array(p[:3], dtype=np.float64) for p in (start, goal))
        data, polys = self.scene.data, self.scene.polys(obstacles)
        turn = math.remainder(target[2] - origin[2], 2 * math.pi)
        way = target - origin
        x, y, th = map(float, origin)
        dx, dy = float(way[0]), float(way[1])
        if straight_free(data, polys, shape.data, x, y, th, dx, dy, turn):
            return np.array([origin, [target[0], target[1], origin[2] + turn]]), 0, False
        step = settings.levels[level] * shape.inner[2]
        bins = settings.bins[level]
        low_level = (0.0, 0.0, settings.weight)
        space = pose_space(
            self.scene, (start, goal), obstacles, 16 * shape.circumscribed, step, bins, low_level
        )
        tree = hybrid.new_tree(settings.nodes[level], int(2 * space[3] * space[4] * space[5]))
        moves = [(i * step, j * step, 0.0) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
        moves += [(0.0, 0.0, 2 * math.pi / bins), (0.0, 0.0, -2 * math.pi / bins)]
        field = self.fields.toward(shape, goal, obstacles)
        limits = np.array([kin.v_max, kin.omega_max])
        state = 0
        while state == 0 and not deadline.expired():
            state = expand_planar(
                tree,
                data,
                polys,
                shape.data,
                field,
                space,
                np.array(moves),
                origin,
                target,
                limits,
                settings.slice,
            )
        count = int(tree.counters[2])
        if state != 1:
            return None, count, state == 2
        rows, node = [target.copy()], int(tree.counters[3])
        while node >= 0:
            rows.append(tree.nodes[node, :3].copy())
            node = int(tree.links[node, 0])
        rows.reverse()
        rows[-1][2] = rows[-2][2] + math.remainder(target[2] - rows[-2][2], 2 * math.pi)
        return np.array(rows), count, False

    def _rounded(
        self,
        body: Body,
        shape: Shape,
        nodes: FloatArray,
        goal: Configuration,
        obstacles: tuple[Placed, ...],
        motion: Trajectory,
        deadline: Deadline,
    ) -> Trajectory:
        """Return a motion that is not slower: corners pushed outwards or cut in two.

        A shortest path hugs the inner side of every corner, where a blend has no room.
        """
        data, polys = self.scene.data, self.scene.polys(obstacles)
        for shift, cut in itertools.product(self.settings.shifts, (0.0, 1.0)):
            i = 1
            while i < len(nodes) - 1 and not deadline.expired():
                trial = moved_corner(nodes, i, shift * shape.inner[2], cut * shape.circumscribed)
                i += 1
                if trial is None or chain_time(trial, body) > motion.duration - GAIN:
                    continue
                if not all(
                    straight_free(data, polys, shape.data, *map(float, a), *map(float, b - a))
                    for a, b in itertools.pairwise(trial[i - 2 : i + 2])
                ):
                    continue
                faster = self._timed(body, shape, trial, goal, obstacles)
                if faster is not None and faster.duration < motion.duration - GAIN:
                    i += len(trial) - len(nodes)
                    nodes, motion = trial, faster
        return motion

    def _timed(
        self,
        body: Body,
        shape: Shape,
        nodes: FloatArray,
        goal: Configuration,
        obstacles: tuple[Placed, ...],
    ) -> Trajectory | None:
        """Return the motion with corners blended as fast as the clearance allows."""
        if len(nodes) < 2:
            return at_rest(goal)
        chain = Chain.of(nodes, body.kinematics)
        speeds = first_speeds(chain)
        data, polys = self.scene.data, self.scene.polys(obstacles)
        least = 1e-3 * float(shape.data.slack[2])
        for _ in range(40):
            motion, owners = timed(chain, speeds)
            turns = round((nodes[-1, 2] - goal[2]) / (2 * math.pi))
            rows = motion.poses.copy()
            rows[-1] = (goal[0], goal[1], goal[2] + turns * 2 * math.pi)
            hit = sweeps.samples_free(data, polys, shape.data, rows, least)
            if hit < 0:
                return Trajectory(motion.times.copy(), rows)
            near = {owners[hit], owners[min(hit + 1, len(owners) - 1)]}
            slowed = speeds.copy()
            for i in near:
                slowed[i] = 0.5 * slowed[i] if slowed[i] > 0.05 * chain.v else 0.0
            if np.array_equal(slowed, speeds):
                slowed = np.zeros_like(speeds)  # rest at every node
                if np.array_equal(slowed, speeds):
                    return None
            speeds = settled(chain, slowed)
        return None
