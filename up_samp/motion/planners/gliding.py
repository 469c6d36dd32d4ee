"""Timing the ways of omnidirectional bodies: corners blended as fast as the clearance allows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.records import WorldData
from up_samp.geometry.sweeps import first_hit
from up_samp.model import Body, Configuration, Kinematics, Placed, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.blending import Chain, first_speeds, settled, through, timed
from up_samp.motion.curves.trajectories import at_rest, with_ends
from up_samp.motion.guides.search_space import widest_shape


def glide(
    world: WorldData,
    kinematics: Kinematics,
    nodes: FloatArray,
    goal: Configuration,
    pins: Mapping[int, FloatArray] | None = None,
) -> tuple[Trajectory, bool] | None:
    """Return the safe motion along ``nodes`` (n, 3) that ends exactly at ``goal``, and whether it
    passes all ``pins`` (poses by node, met exactly) without a stop but where it turns back; None if
    there is none. ``world``: the body with its margin, and what it must keep clear of.
    """
    if len(nodes) < 2:
        return at_rest(goal), True
    straight = Chain.of(nodes, kinematics, pins)
    speeds = first_speeds(straight)
    for _ in range(40):  # each timing slower where the one before hit something
        chain = straight
        if pins:
            fitting = through(straight, speeds, kinematics)
            if fitting is None:
                slower = _slowed(speeds, set(pins), straight.v)
                if slower is None:
                    return None
                speeds = settled(straight, slower)
                continue
            chain, speeds = fitting
        motion, owners = timed(chain, speeds)
        motion = with_ends(motion, tuple(motion.poses[0].tolist()), goal)
        hit = first_hit(world, motion.poses.copy())
        if hit < 0:
            passed = all(speeds[i] > 0.0 or straight.turns_back(i) for i in pins or ())
            return motion, passed
        slowed = _slowed(speeds, {owners[hit], owners[min(hit + 1, len(owners) - 1)]}, chain.v)
        if slowed is None:
            return None
        speeds = settled(chain, slowed)
    return None


def _slowed(speeds: FloatArray, near: set[int], v: float) -> FloatArray | None:
    """Return lower speeds at the nodes ``near``, or rests at all nodes (None: they rest)."""
    slowed = speeds.copy()
    for i in near:
        slowed[i] = 0.5 * slowed[i] if slowed[i] > 0.05 * v else 0.0
    if np.array_equal(slowed, speeds):
        slowed = np.zeros_like(speeds)
        if np.array_equal(slowed, speeds):
            return None
    return slowed


def glide_through(
    scene: Scene,
    body: Body,
    poses: Sequence[Configuration],
    ways: Sequence[FloatArray],
    obstacles: tuple[Placed, ...],
) -> tuple[Trajectory, bool] | None:
    """Return one motion along the legs ``ways`` (corners (n, 3) of each) that passes exactly
    through ``poses`` between them, and whether it stops there only to turn back (None: no safe
    timing).
    """
    shape = widest_shape(scene, body, poses, obstacles)
    if shape is None:
        return None
    rows, pins = [ways[0]], {}
    for way in ways[1:]:
        last = rows[-1][-1]
        pins[sum(map(len, rows)) - 1] = last.copy()
        turns = round(float(last[2] - way[0, 2]) / (2 * math.pi))
        rows.append(way[1:] + np.array([0.0, 0.0, turns * 2 * math.pi]))
    nodes = np.concatenate(rows)
    world = scene.world(shape, obstacles)
    return glide(world, body.kinematics, nodes, poses[-1], pins)
