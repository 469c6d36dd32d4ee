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
from typing import NamedTuple

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.kernels import first_hit
from up_samp.geometry.records import WorldData, inner, kernel, lean_inner
from up_samp.model import Body, Configuration, Kinematics, Placed, Trajectory
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.curves.trajectories import at_rest, unwound, with_ends
from up_samp.motion.guides import widest_shape

TINY = 1e-9


# ------------------ Compiled: speeds and samples of straight pieces


class BlendedPieces(NamedTuple):
    """Straight pieces: ``nodes`` (n, 3); lengths (m) and top speeds (m/s) of the pieces between;
    ``bends`` (n,): |u2 - u1| of the directions at a node, 0 at both ends. ``a`` and ``omega`` limit
    acceleration (m/s2) and turns on the spot (rad/s).
    """

    nodes: FloatArray
    lengths: FloatArray
    tops: FloatArray
    bends: FloatArray
    a: float
    omega: float


Samples = tuple[FloatArray, FloatArray, IntArray]
"""Instants (n,), poses (n, 3) and the nodes (n,) in or near whose blend they are."""


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


_profile = inner(profile)


@lean_inner
def _reach(pieces: BlendedPieces, speeds: FloatArray, i: int) -> float:
    """Return how far (m) from node ``i`` its blend begins and ends."""
    reach: float = speeds[i] * speeds[i] * pieces.bends[i] / (2 * pieces.a)
    return reach


@inner
def _free(pieces: BlendedPieces, speeds: FloatArray, i: int) -> float:
    """Return how long (m) a piece is without the blends at its ends."""
    free: float = pieces.lengths[i] - _reach(pieces, speeds, i) - _reach(pieces, speeds, i + 1)
    return max(free, 0.0)


@kernel
def fastest_speeds(pieces: BlendedPieces) -> FloatArray:
    """Return the largest speeds (m/s) at the nodes for which blends and trapezoids fit."""
    speeds, lengths, tops = np.zeros(len(pieces.bends)), pieces.lengths, pieces.tops
    for i in range(1, len(lengths)):
        before, after, bend = lengths[i - 1], lengths[i], pieces.bends[i]
        if min(before, after) < TINY or bend > 2.0 - TINY:
            continue  # a turn on the spot, or nothing is won by going on farther
        room = 0.45 * min(before, after)
        fits = math.sqrt(2 * pieces.a * room / bend) if bend > TINY else math.inf
        speeds[i] = min(fits, tops[i - 1], tops[i])
    return settled_speeds(pieces, speeds)


@kernel
def settled_speeds(pieces: BlendedPieces, speeds: FloatArray) -> FloatArray:
    """Return the speeds lowered until each piece can change from one to the other."""
    found, many = speeds.copy(), len(pieces.lengths)
    for _ in range(4):
        before = found.copy()
        for k in range(2 * many):
            i = k if k < many else 2 * many - 1 - k
            low, high = (i, i + 1) if found[i] <= found[i + 1] else (i + 1, i)
            free = _free(pieces, found, i)
            most = math.sqrt(found[low] * found[low] + 2 * pieces.a * free)
            found[high] = min(found[high], most)
        if np.all(found == before):
            break
    return found


@kernel
def _lasts(pieces: BlendedPieces, speeds: FloatArray) -> float:
    """Return how long (s) straight pieces and their blends take."""
    total = 0.0
    for i in range(len(pieces.lengths)):
        if pieces.lengths[i] < TINY:
            total += abs(pieces.nodes[i + 1, 2] - pieces.nodes[i, 2]) / pieces.omega
            continue
        free, w0, w1 = _free(pieces, speeds, i), speeds[i], speeds[i + 1]
        _, rise, cruise, fall = _profile(free, w0, w1, pieces.tops[i], pieces.a)
        total += rise + cruise + fall
        total += 2 * _reach(pieces, speeds, i + 1) / w1 if w1 > 0 else 0.0
    return total


@inner
def _instants(samples: Samples, n: int, seconds: float, step: float, owner: int) -> int:
    """Write the instants of a time that begins at sample ``n`` and lasts so many seconds, evenly
    spaced and no more than a ``step`` (s) from each to the next; return the last one's number.
    """
    times, _, owners = samples
    count = max(1, math.ceil(seconds / step - 1e-9)) if seconds > TINY else 0
    for k in range(1, count + 1):
        times[n + k] = times[n] + (seconds if k == count else k * (seconds / count))
        owners[n + k] = owner
    return n + count


@inner
def _straight(
    samples: Samples, n: int, pieces: BlendedPieces, speeds: FloatArray, i: int, step: float
) -> int:
    """Sample a straight piece without the blends at its ends; return the last sample."""
    times, poses, _ = samples
    start, length, a, w0 = pieces.nodes[i], pieces.lengths[i], pieces.a, speeds[i]
    way, first = pieces.nodes[i + 1] - start, _reach(pieces, speeds, i)
    free, done = _free(pieces, speeds, i), 0.0
    peak, rise, cruise, fall = _profile(free, w0, speeds[i + 1], pieces.tops[i], a)
    for seconds, begin, slope in ((rise, w0, a), (cruise, peak, 0.0), (fall, peak, -a)):
        owner = i if done < free / 2 - TINY else i + 1
        last, driven = _instants(samples, n, seconds, step, owner), done
        for k in range(n + 1, last + 1):
            passed = times[k] - times[n]
            driven = done + begin * passed + 0.5 * slope * passed * passed
            poses[k] = start + min((first + driven) / length, 1.0) * way
        n, done = last, driven
    return n


@inner
def _bent(
    samples: Samples, n: int, pieces: BlendedPieces, speeds: FloatArray, i: int, step: float
) -> tuple[int, int]:
    """Sample the blend at a node: a parabola from one velocity to another one. Return its middle
    and its last sample.
    """
    times, poses, _ = samples
    node, seconds = pieces.nodes[i], 2 * _reach(pieces, speeds, i) / speeds[i]
    before = (node - pieces.nodes[i - 1]) / pieces.lengths[i - 1] * speeds[i]
    after = (pieces.nodes[i + 1] - node) / pieces.lengths[i] * speeds[i]
    start, middle = node - before * (seconds / 2), _instants(samples, n, seconds / 2, step, i)
    last = _instants(samples, middle, seconds / 2, step, i)
    for k in range(n + 1, last + 1):
        passed = times[k] - times[n]
        poses[k] = start + passed * before + passed * passed / (2 * seconds) * (after - before)
    return middle, last


@kernel
def _sampled(
    pieces: BlendedPieces, speeds: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return instants (n,), poses (n, 3) and the nodes (n,) in or near whose blend they are; and by
    node which sample is the middle of its blend (-1: none is).
    """
    nodes, many = pieces.nodes, len(pieces.lengths)
    room = int(_lasts(pieces, speeds) / step) + 6 * many + 2
    times, poses, owners = np.zeros(room), np.zeros((room, 3)), np.zeros(room, dtype=np.int64)
    samples, middles, n = (times, poses, owners), np.full(len(nodes), -1), 0
    poses[0] = nodes[0]
    for i in range(many):
        if pieces.lengths[i] < TINY:  # a turn on the spot
            way, begin = nodes[i + 1] - nodes[i], n
            seconds = abs(way[2]) / pieces.omega
            n = _instants(samples, n, seconds, step, i)
            for k in range(begin + 1, n + 1):
                poses[k] = nodes[i] + (times[k] - times[begin]) / seconds * way
            continue
        n = _straight(samples, n, pieces, speeds, i, step)
        if speeds[i + 1] > 0.0 and _reach(pieces, speeds, i + 1) > TINY:
            middles[i + 1], n = _bent(samples, n, pieces, speeds, i + 1, step)
    return times[: n + 1], poses[: n + 1], owners[: n + 1], middles


# ------------------ Chains


@dataclass(frozen=True)
class Chain:
    """Straight pieces, and the top speed ``v`` (m/s) of what moves along them.

    Lengths, speeds and accelerations are of what is farthest off the reference point, and as large
    as they may be there: a turn by an angle adds that arc.
    ``pins``: poses that the motion passes exactly, by the number of the node that stands for them.
    """

    pieces: BlendedPieces
    v: float
    pins: Mapping[int, FloatArray] = field(default_factory=dict)

    def turns_back(self, node: int) -> bool:
        """Return whether the pieces before and after a node are of opposite directions."""
        return bool(self.pieces.bends[node] > 2.0 - TINY)

    @staticmethod
    def of(
        nodes: FloatArray, kinematics: Kinematics, pins: Mapping[int, FloatArray] | None = None
    ) -> Chain:
        """Return the chain with the limits of ``kinematics``."""
        limits = kinematics.v_max, kinematics.a_max, kinematics.omega_max
        v, a, omega = map(float, limits)
        nodes = np.ascontiguousarray(nodes, dtype=np.float64)
        steps = np.diff(nodes, axis=0)
        lengths = sizes_of(steps, kinematics.reach)
        safe = np.where(lengths > TINY, lengths, 1.0)
        turns = np.abs(steps[:, 2])
        tops = np.minimum(v, omega * lengths / np.where(turns > TINY, turns, TINY))
        changes = np.diff(steps / safe[:, None], axis=0)
        bends = np.zeros(len(nodes))
        bends[1:-1] = sizes_of(changes, kinematics.reach)
        return Chain(BlendedPieces(nodes, lengths, tops, bends, a, omega), v, pins or {})


def sizes_of(steps: FloatArray, reach: float) -> FloatArray:
    """Return how far (m) any point up to ``reach`` m off the reference point moves at most by
    planar steps (n, 3): straight on, and turning.
    """
    return np.asarray(np.hypot(steps[:, 0], steps[:, 1]) + reach * np.abs(steps[:, 2]))


def through(
    chain: Chain, speeds: FloatArray, kinematics: Kinematics
) -> tuple[Chain, FloatArray] | None:
    """Return the chain with its corners moved so that the blends pass the ``pins``, and speeds
    that fit it, none of them higher (None: no such corners were found).
    """
    for _ in range(60):  # a fixed point of corners and speeds, exact but for rounding
        nodes, moved = chain.pieces.nodes, chain.pieces.nodes.copy()
        for i, pin in chain.pins.items():
            if speeds[i] > 0.0:
                moved[i] = pin - _cut(chain, i, float(speeds[i]))
            else:
                moved[i] = pin
        step = float(np.abs(moved - nodes).max())
        chain = Chain.of(moved, kinematics, chain.pins)
        fitting = settled_speeds(chain.pieces, np.minimum(speeds, fastest_speeds(chain.pieces)))
        if step < 1e-12 and np.allclose(fitting, speeds, rtol=1e-12, atol=0.0):
            return chain, speeds
        speeds = fitting
    return None


def _cut(chain: Chain, i: int, speed: float) -> FloatArray:
    """Return by how much the middle of the blend at node ``i`` lies off the node."""
    sizes = chain.pieces.lengths[i - 1 : i + 1]
    if min(sizes) < TINY:
        return np.zeros(3)
    u, w = np.diff(chain.pieces.nodes[i - 1 : i + 2], axis=0) / sizes[:, None]
    seconds = speed * chain.pieces.bends[i] / chain.pieces.a
    return np.asarray((w - u) * speed * seconds / 8)


def timed(chain: Chain, speeds: FloatArray) -> tuple[Trajectory, list[int]]:
    """Return the motion from time 0, and for each sample the node whose blend it is in or near."""
    times, rows, owners, middles = _sampled(chain.pieces, speeds, Trajectory.MAX_STEP)
    for i, pin in chain.pins.items():
        if middles[i] >= 0:
            rows[middles[i]] = pin
    keep = np.concatenate([[True], np.diff(times) > 1e-7])
    if not keep[-1]:  # the last sample is the goal: drop the one before it instead
        keep[-1] = True
        keep[np.nonzero(keep[:-1])[0][-1]] = len(np.nonzero(keep[:-1])[0]) < 2
    rows[-1] = chain.pieces.nodes[-1]
    return Trajectory(times[keep], rows[keep]), owners[keep].tolist()


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
    return _lasts(chain.pieces, fastest_speeds(chain.pieces))


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
    speeds = fastest_speeds(straight.pieces)
    for _ in range(40):  # each timing slower where the one before hit something
        chain = straight
        if pins:
            fitting = through(straight, speeds, kinematics)
            if fitting is None:
                slower = _slowed(speeds, set(pins), straight.v)
                if slower is None:
                    return None
                speeds = settled_speeds(straight.pieces, slower)
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
        speeds = settled_speeds(chain.pieces, slowed)
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
