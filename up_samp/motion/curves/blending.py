"""Timing of chains of straight pieces for bodies that move in any direction: corners are blended,
as fast as the clearance allows.

Pieces are joined by parabolic blends at constant acceleration (linear segments with parabolic
blends; Taylor 1979; Kunz & Stilman, RSS 2012): at a corner the velocity turns from one direction
into the next at one and the same speed, so that neither speed nor acceleration ever exceeds its
limit. Between blends the speed is a trapezoid.

A blend cuts its corner. Where a motion has to pass exactly through a corner (a waypoint), the
corner is moved outwards until the blend's middle lies on it (:func:`through`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.kernels import first_hit
from up_samp.geometry.records import WorldData
from up_samp.model import Body, Configuration, Kinematics, Placed, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.trajectories import at_rest, unwound, with_ends
from up_samp.motion.guides import widest_shape

TINY = 1e-9


@dataclass(frozen=True)
class Chain:
    """Straight pieces: ``nodes`` (n, 3), lengths (m) and top speeds (m/s).

    Lengths, speeds and accelerations are of what is ``reach`` m off the reference point, and as
    large as they may be there: a turn by an angle adds that arc. ``bends`` (n,): |u2 - u1| of the
    directions at a node, 0 at both ends.
    ``pins``: poses that the motion passes exactly, by the number of the node that stands for them.
    """

    nodes: FloatArray
    lengths: FloatArray
    tops: FloatArray
    bends: tuple[float, ...]
    v: float
    a: float
    omega: float
    reach: float = 0.0
    pins: Mapping[int, FloatArray] = field(default_factory=dict)

    def turns_back(self, node: int) -> bool:
        """Return whether the pieces before and after a node are of opposite directions."""
        return self.bends[node] > 2.0 - TINY

    @staticmethod
    def of(
        nodes: FloatArray, kinematics: Kinematics, pins: Mapping[int, FloatArray] | None = None
    ) -> Chain:
        """Return the chain with the limits of ``kinematics``."""
        v, a, omega = kinematics.v_max, kinematics.a_max, kinematics.omega_max
        steps = np.diff(nodes, axis=0)
        lengths = sizes_of(steps, kinematics.reach)
        safe = np.where(lengths > TINY, lengths, 1.0)
        turns = np.abs(steps[:, 2])
        tops = np.minimum(v, omega * lengths / np.where(turns > TINY, turns, TINY))
        changes = np.diff(steps / safe[:, None], axis=0)
        bends = 0.0, *sizes_of(changes, kinematics.reach).tolist(), 0.0
        return Chain(nodes, lengths, tops, bends, v, a, omega, kinematics.reach, pins or {})


def sizes_of(steps: FloatArray, reach: float) -> FloatArray:
    """Return how far (m) any point up to ``reach`` m off the reference point moves at most by
    planar steps (n, 3): straight on, and turning.
    """
    return np.asarray(np.hypot(steps[:, 0], steps[:, 1]) + reach * np.abs(steps[:, 2]))


def first_speeds(chain: Chain) -> FloatArray:
    """Return the largest speeds (m/s) at the nodes for which blends and trapezoids fit."""
    n = len(chain.nodes)
    speeds = np.zeros(n)
    for i in range(1, n - 1):
        before, after = chain.lengths[i - 1], chain.lengths[i]
        if min(before, after) < TINY or chain.turns_back(i):
            continue  # a turn on the spot, or nothing is won by going on farther
        room = 0.45 * min(before, after)
        bend = chain.bends[i]
        fits = math.sqrt(2 * chain.a * room / bend) if bend > TINY else math.inf
        speeds[i] = min(fits, chain.tops[i - 1], chain.tops[i])
    return settled(chain, speeds)


def settled(chain: Chain, speeds: FloatArray) -> FloatArray:
    """Return the speeds lowered until each piece can change from one to the other."""
    found, lengths = speeds.tolist(), chain.lengths.tolist()  # many small ones: arrays are slow
    order = [*range(len(lengths)), *reversed(range(len(lengths)))]
    for _ in range(4):
        before = found.copy()
        for i in order:
            low, high = (i, i + 1) if found[i] <= found[i + 1] else (i + 1, i)
            free = lengths[i] - _reach(chain, found, i) - _reach(chain, found, i + 1)
            most = math.sqrt(found[low] ** 2 + 2 * chain.a * max(free, 0.0))
            found[high] = min(found[high], most)
        if found == before:
            break
    return np.array(found)


def _reach(chain: Chain, speeds: Sequence[float], i: int) -> float:
    """Return how far (m) from node ``i`` its blend begins and ends."""
    return speeds[i] ** 2 * chain.bends[i] / (2 * chain.a)


def _reaches(chain: Chain, speeds: FloatArray) -> list[float]:
    """Return that of all nodes."""
    found: list[float] = speeds.tolist()
    return [_reach(chain, found, i) for i in range(len(found))]


def through(
    chain: Chain, speeds: FloatArray, kinematics: Kinematics
) -> tuple[Chain, FloatArray] | None:
    """Return the chain with its corners moved so that the blends pass the ``pins``, and speeds
    that fit it, none of them higher (None: no such corners were found).
    """
    for _ in range(60):  # a fixed point of corners and speeds, exact but for rounding
        nodes, moved = chain.nodes, chain.nodes.copy()
        for i, pin in chain.pins.items():
            if speeds[i] > 0.0:
                moved[i] = pin - _cut(chain, i, float(speeds[i]))
            else:
                moved[i] = pin
        step = float(np.abs(moved - nodes).max())
        chain = Chain.of(moved, kinematics, chain.pins)
        fitting = settled(chain, np.minimum(speeds, first_speeds(chain)))
        if step < 1e-12 and np.allclose(fitting, speeds, rtol=1e-12, atol=0.0):
            return chain, speeds
        speeds = fitting
    return None


def _cut(chain: Chain, i: int, speed: float) -> FloatArray:
    """Return by how much the middle of the blend at node ``i`` lies off the node."""
    sizes = chain.lengths[i - 1 : i + 1]
    if min(sizes) < TINY:
        return np.zeros(3)
    u, w = np.diff(chain.nodes[i - 1 : i + 2], axis=0) / sizes[:, None]
    seconds = speed * chain.bends[i] / chain.a
    return np.asarray((w - u) * speed * seconds / 8)


def profile(
    length: float, w0: float, w1: float, top: float, a: float
) -> tuple[float, float, float, float]:
    """Return (peak speed, seconds of rise, cruise, fall) over ``length`` m from speed w0 to w1."""
    peak = min(top, math.sqrt(max(a * length + 0.5 * (w0 * w0 + w1 * w1), 0.0)))
    peak = max(peak, w0, w1)
    rise, fall = (peak - w0) / a, (peak - w1) / a
    driven = 0.5 * (w0 + peak) * rise + 0.5 * (w1 + peak) * fall
    cruise = max(length - driven, 0.0) / peak if peak > TINY else 0.0
    return peak, rise, cruise, fall


class _BlendWriter:
    """Collects samples of pieces, each given as a function of the time since its start."""

    def __init__(self, start: FloatArray) -> None:
        self.times, self.rows = [np.zeros(1)], [start[None, :].copy()]
        self.now = 0.0
        self.owners = [0]

    def add(self, seconds: float, poses: FloatArray, grid: FloatArray, owner: int) -> None:
        self.times.append(self.now + grid)
        self.rows.append(poses)
        self.owners.extend([owner] * len(grid))
        self.now += seconds


def _grid(seconds: float) -> FloatArray:
    count = max(1, math.ceil(seconds / Trajectory.MAX_STEP - 1e-9))
    return np.linspace(0.0, seconds, count + 1)[1:]


def timed(chain: Chain, speeds: FloatArray) -> tuple[Trajectory, list[int]]:
    """Return the motion from time 0, and for each sample the node whose blend it is in or near."""
    nodes, reach = chain.nodes, _reaches(chain, speeds)
    writer = _BlendWriter(nodes[0])
    for i in range(len(chain.lengths)):
        start, end = nodes[i], nodes[i + 1]
        length = float(chain.lengths[i])
        if length < TINY:
            _spin(writer, start, end, chain.omega, i)
            continue
        first, last = reach[i : i + 2]
        _straight(writer, chain, i, first, last, speeds)
        if speeds[i + 1] > 0 and last > TINY:
            _blend(writer, chain, i + 1, last, float(speeds[i + 1]))
    times, rows = np.concatenate(writer.times), np.concatenate(writer.rows)
    keep = np.concatenate([[True], np.diff(times) > 1e-7])
    if not keep[-1]:  # the last sample is the goal: drop the one before it instead
        keep[-1] = True
        keep[np.nonzero(keep[:-1])[0][-1]] = len(np.nonzero(keep[:-1])[0]) < 2
    rows[-1] = nodes[-1]
    owners = [owner for owner, kept in zip(writer.owners, keep, strict=True) if kept]
    return Trajectory(times[keep], rows[keep]), owners


def _spin(
    writer: _BlendWriter, start: FloatArray, end: FloatArray, omega: float, owner: int
) -> None:
    turn = end[2] - start[2]
    seconds = abs(float(turn)) / omega
    if seconds > TINY:
        grid = _grid(seconds)
        writer.add(seconds, start + np.outer(grid / seconds, end - start), grid, owner)


def _straight(
    writer: _BlendWriter, chain: Chain, i: int, first: float, last: float, speeds: FloatArray
) -> None:
    start, step = chain.nodes[i], chain.nodes[i + 1] - chain.nodes[i]
    length = float(chain.lengths[i])
    w0, w1 = float(speeds[i]), float(speeds[i + 1])
    free = max(length - first - last, 0.0)
    peak, rise, cruise, fall = profile(free, w0, w1, float(chain.tops[i]), chain.a)
    done = 0.0
    for seconds, begin, slope in ((rise, w0, chain.a), (cruise, peak, 0.0), (fall, peak, -chain.a)):
        if seconds <= 1e-9:
            continue
        grid = _grid(seconds)
        driven = done + begin * grid + 0.5 * slope * grid * grid
        share = np.minimum((first + driven) / length, 1.0)
        owner = i if done < free / 2 else i + 1
        writer.add(seconds, start + np.outer(share, step), grid, owner)
        done = float(driven[-1])


def _blend(writer: _BlendWriter, chain: Chain, i: int, reach: float, speed: float) -> None:
    """Turn from piece i - 1 into piece i by a parabola from ``reach`` m before node i to after."""
    seconds = 2 * reach / speed
    before = chain.nodes[i] - chain.nodes[i - 1]
    after = chain.nodes[i + 1] - chain.nodes[i]
    v0 = before / chain.lengths[i - 1] * speed
    v1 = after / chain.lengths[i] * speed
    start = chain.nodes[i] - v0 * (seconds / 2)
    half = _grid(seconds / 2)
    grid = np.concatenate([half, seconds / 2 + half])
    poses = start + np.outer(grid, v0) + np.outer(grid * grid / (2 * seconds), v1 - v0)
    if i in chain.pins:
        poses[len(half) - 1] = chain.pins[i]
    writer.add(seconds, poses, grid, i)


def pieces(nodes: FloatArray) -> FloatArray:
    """Return the nodes without those that do not move on from the one before."""
    return nodes[np.append(True, np.abs(np.diff(nodes, axis=0)).max(axis=1) > TINY)]


def moved_corner(nodes: FloatArray, i: int, shift: float, cut: float) -> FloatArray | None:
    """Return the nodes with inner node ``i`` pushed outwards by ``shift`` m, and replaced by two
    ``cut`` m from it along its pieces (None: it is no corner).
    """
    before, after = nodes[i] - nodes[i - 1], nodes[i + 1] - nodes[i]
    sizes = np.hypot(*before[:2]), np.hypot(*after[:2])
    if min(sizes) < TINY:
        return None
    u, w = before / sizes[0], after / sizes[1]
    inside = w[:2] - u[:2]
    bend = float(np.hypot(*inside))
    if bend < 1e-3:
        return None
    out = np.append(-shift * inside / bend, 0.0)
    if cut <= 0.0:
        return np.concatenate([nodes[:i], [nodes[i] + out], nodes[i + 1 :]])
    reach = min(cut, 0.4 * sizes[0]), min(cut, 0.4 * sizes[1])
    pair = [nodes[i] - reach[0] * u + out, nodes[i] + reach[1] * w + out]
    return np.concatenate([nodes[:i], pair, nodes[i + 1 :]])


def chain_time(nodes: FloatArray, body: Body) -> float:
    """Return about how long (s) the blended motion along ``nodes`` takes where nothing is near."""
    chain = Chain.of(nodes, body.kinematics)
    speeds = first_speeds(chain)
    total, reach = 0.0, _reaches(chain, speeds)
    for i, length in enumerate(chain.lengths):
        if length < TINY:
            total += abs(float(nodes[i + 1, 2] - nodes[i, 2])) / chain.omega
            continue
        first, last = reach[i : i + 2]
        free = max(float(length) - first - last, 0.0)
        ends = float(speeds[i]), float(speeds[i + 1])
        total += sum(profile(free, *ends, float(chain.tops[i]), chain.a)[1:])
        total += 2 * last / ends[1] if ends[1] > 0 else 0.0
    return total


# ------------------ Among what must be kept clear of


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
        rows.append(unwound(way, last)[1:])
    nodes = np.concatenate(rows)
    world = scene.world(shape, obstacles)
    return glide(world, body.kinematics, nodes, poses[-1], pins)
