"""Limits of speed that hang on where a body is, on whether it drives backwards, and on how its way
bends: what a way allows, and motions slowed to that.

The one place that knows of them: a planner may find its way as if they were not there, and whoever
times a way again takes its top speeds from here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import shapely

from up_samp.model import (
    Body,
    Configuration,
    Kinematics,
    MotionModel,
    Placed,
    TrafficZone,
    Trajectory,
)
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.motion.curves.rolling import (
    ON_SPOT,
    SAME,
    Rolls,
    moves_on,
    rolls_of,
    sampled_rolls,
    through_rows,
)
from up_samp.motion.curves.trajectories import partway, travels, twists
from up_samp.motion.curves.trapezoid import MOST_TURN

OVER = 1e-3
"""Share by which a limit may be exceeded before a motion is slowed: rounding."""


def allowed_speeds(poses: FloatArray, body: Body) -> FloatArray:
    """Return the top speeds (m/s; inf: no rule) between poses (n, 3) that the body's zones, its
    limit backwards, and the way's bends allow: on a whole step if any part of it may be in a zone.
    """
    return np.minimum(ruled_speeds(poses, body), limits_in_bends(poses, body.kinematics).tops)


def ruled_speeds(poses: FloatArray, body: Body) -> FloatArray:
    """Return :func:`allowed_speeds` whatever the way's bends."""
    most = np.full(len(poses) - 1, math.inf)
    kin = body.kinematics
    if math.isfinite(kin.v_back):
        most[twists(poses)[:, 0] < 0.0] = kin.v_back
    for zone in kin.zones:
        if zone.v_max < kin.v_max:
            here = steps_in(zone, poses, body)
            most[here] = np.minimum(most[here], zone.v_max)
    return most


def steps_in(zone: TrafficZone, poses: FloatArray, body: Body) -> BoolArray:
    """Return between which poses (n, 3) a body may touch a zone, or come nearer than 1 mm,
    shape (n - 1,): swept, by halves; of a dock's zone, from where it comes straight to the dock.
    """
    if zone.dock is not None:
        if not zone.binds(poses[-1]):
            return np.zeros(len(poses) - 1, dtype=np.bool_)
        return np.arange(1, len(poses)) >= last_stay(zone, poses)
    area, centre, reach = _area(zone)
    corners = np.asarray(body.footprint, dtype=np.float64)
    radius = float(np.hypot(*corners.T).max())
    travel = travels(poses, radius)
    gaps = np.hypot(*(poses[:, :2] - centre).T) - reach - radius
    near = gaps <= travel.max(initial=0.0)
    gaps[near] = shapely.distance(shapely.polygons(_placed(corners, poses[near])), area)
    touched = np.zeros(len(travel), dtype=np.bool_)
    # what gets there from one end, and from there to the other, travels as far as both gaps
    step = np.flatnonzero(gaps[:-1] + gaps[1:] <= travel)
    parts: list[FloatArray] = [
        poses[step],
        poses[step + 1],
        gaps[step],
        gaps[step + 1],
        travel[step],
    ]
    while len(step):
        surely = (np.minimum(parts[2], parts[3]) <= 0.0) | (parts[4] <= 1e-3)
        touched[step[surely]] = True
        open_ = ~touched[step]
        step = step[open_]
        a, b, left, right, length = (part[open_] for part in parts)
        middle = partway(a, b, np.full(len(a), 0.5))
        gap = shapely.distance(shapely.polygons(_placed(corners, middle)), area)
        halves = (a, middle, left, gap, 0.5 * length), (middle, b, gap, right, 0.5 * length)
        parts = [np.concatenate(pair) for pair in zip(*halves, strict=True)]
        open_ = parts[2] + parts[3] <= parts[4]
        step, parts = np.tile(step, 2)[open_], [part[open_] for part in parts]
    return touched


def last_stay(zone: TrafficZone, poses: FloatArray) -> int:
    """Return from which of some poses (n, 3) on the reference point is in a zone to the end; the
    last pose counts as one in it.
    """
    inside = shapely.intersects_xy(_area(zone)[0], poses[:-1, :2])
    return int(np.flatnonzero(~inside).max(initial=-1)) + 1


@lru_cache(maxsize=256)
def _area(zone: TrafficZone) -> tuple[shapely.Polygon, FloatArray, float]:
    """Return a zone's polygon, with the middle and the radius of a disc around it."""
    corners = np.asarray(zone.polygon, dtype=np.float64)
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    area = shapely.Polygon(corners)
    shapely.prepare(area)
    return area, centre, float(np.hypot(*(corners - centre).T).max())


def _placed(corners: FloatArray, poses: FloatArray) -> FloatArray:
    """Return a polygon's corners (k, 2) at poses (n, 3), shape (n, k, 2)."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = corners.T
    return np.stack([poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y], axis=-1)


def slowed(trajectory: Trajectory, body: Body) -> Trajectory:
    """Return a planar motion from rest to rest with its way driven as fast as the limits of speed
    along it allow (waits are left out); the motion itself where it keeps them.
    """
    kin = body.kinematics
    limited = kin.zones or math.isfinite(kin.v_back) or kin.heeds_turns
    if not limited or len(trajectory.times) < 2:
        return trajectory
    most = allowed_speeds(trajectory.poses, body)
    moves = twists(trajectory.poses)
    way = np.hypot(moves[:, 0], moves[:, 1])
    fast = np.any(way > most * np.diff(trajectory.times) * (1.0 + OVER))
    if not fast and turns_evenly(trajectory, kin):
        return trajectory
    keep = moves_on(trajectory.poses)
    rows = trajectory.poses[keep]
    if kin.mobility.sideways:
        most = allowed_speeds(rows, body)
        found = _eased(Trajectory(trajectory.times[keep], rows.copy()), body, most)
    else:
        found = driven(rows, body)
    return found.shifted(trajectory.start)


def driven(rows: FloatArray, body: Body) -> Trajectory:
    """Return the fastest motion along a way (n, 3), from time 0, that keeps to the limits along it,
    of a body that drives along its heading.
    """
    rolls, bends = _rolls(rows, body), limits_in_bends(rows, body.kinematics)
    most = np.minimum(ruled_speeds(rows, body), bends.tops)
    spot = np.abs(rolls.kinds) == 2
    tops = np.where(spot, rolls.tops, np.minimum(rolls.tops, most))
    # pieces before a rest and after it are of other kinds
    after = np.append(0, np.cumsum(bends.rests)) % 2
    kinds = np.where(spot, rolls.kinds, rolls.kinds * (1 + 2 * after))
    return through_rows(rows, *sampled_rolls(rolls._replace(tops=tops, kinds=kinds)))


def push_along(rows: FloatArray, body: Body) -> float:
    """Return the acceleration (m/s^2) that a way (n, 3) along the heading allows everywhere; where
    it turns on the spot, a metre is what it turns while it could drive that at top speed.
    """
    kin = body.kinematics
    if math.isinf(kin.alpha_max) or len(rows) < 2:
        return kin.a_max
    rolls = _rolls(rows, body)
    metres = np.where(np.abs(rolls.kinds) == 2, kin.v_max / kin.omega_max, 1.0)
    return float(min(kin.a_max, (rolls.pushes * metres).min()))


def _rolls(rows: FloatArray, body: Body) -> Rolls:
    """Return the pieces of a way that is driven along the heading, with the accelerations that its
    bends allow.
    """
    rolls = rolls_of(rows, body.kinematics)
    least = np.minimum(rolls.pushes, limits_in_bends(rows, body.kinematics).pushes)
    return rolls._replace(pushes=np.where(np.abs(rolls.kinds) == 2, rolls.pushes, least))


def _eased(motion: Trajectory, body: Body, most: FloatArray) -> Trajectory:
    """Return the way of a body that moves in any direction, driven again within ``most`` m/s."""
    kin, rows = body.kinematics, motion.poses
    way, turns = np.hypot(*np.diff(rows[:, :2], axis=0).T), np.diff(rows[:, 2])
    spot = way < ON_SPOT * np.abs(turns)
    sizes = np.where(spot, np.abs(turns), way)
    s = np.concatenate([[0.0], np.cumsum(sizes)])
    tops, held, rests = bends_of(rows, s, motion.times, body, most)
    # pieces before a rest and after it are of other kinds
    kinds = np.where(spot, 2, 1 - 2 * (np.cumsum(rests[:-1]) % 2))
    tops = np.where(spot, kin.omega_max, tops)
    pushes = np.where(spot, math.inf, kin.a_max)
    times, at, shares = sampled_rolls(Rolls(sizes, turns, kinds, tops, pushes), held)
    poses = between_bends(rows, s, ways_at(rows, s, rests), at, shares)
    poses[0], poses[-1] = rows[0], rows[-1]
    return Trajectory(times, poses)


def may_stand(body: Body, pose: Configuration) -> bool:
    """Return whether no zone forbids a body in the plane to rest at a pose."""
    rows = np.array([pose, pose], dtype=np.float64)
    return not any(steps_in(zone, rows, body).any() for zone in body.kinematics.no_stops)


def seconds_of(motion: Trajectory, body: Body) -> float:
    """Return what a motion lasts, with what zones on its way cost (s), and what it drives beside
    the lanes that are preferred most, and backwards.
    """
    zones = (zone for zone in body.kinematics.zones if zone.cost)
    costs = sum(z.cost for z in zones if steps_in(z, motion.poses, body).any())
    lanes = body.kinematics.lanes
    most = max((lane.prefer for lane in lanes), default=1.0)
    at = 0.5 * (motion.poses[:-1, :2] + motion.poses[1:, :2])
    on = [np.where(shapely.contains_xy(_area(z)[0], at), most / z.prefer, most) for z in lanes]
    seconds = np.diff(motion.times)
    more = np.minimum.reduce([np.full(len(at), most), *on]) - 1.0
    if body.kinematics.back_cost > 1.0:
        back = twists(motion.poses)[:, 0] < -ON_SPOT * seconds
        more += (body.kinematics.back_cost - 1.0) * back
    return motion.duration + costs + float(seconds @ more)


def chooses(body: Body) -> bool:
    """Return whether rules may make a body choose between ways, whichever it finds first: of zones,
    but for those of docks, of lanes, and of slowly driving backwards. (Who would rather not drive
    backwards chooses where it does: see :func:`reverses_at_a_cost`.)
    """
    kin = body.kinematics
    told = bool(kin.lanes) or math.isfinite(kin.v_back)
    return told or any(zone.dock is None for zone in kin.zones)


def slowing_zones(motion: Trajectory, body: Body) -> tuple[TrafficZone, ...]:
    """Return the zones in which a motion is faster than they allow, or that cost something, and
    that the body does not touch where it begins or ends.
    """
    moves = twists(motion.poses)
    speed = np.hypot(moves[:, 0], moves[:, 1]) / np.diff(motion.times)
    found = []
    for zone in body.kinematics.zones:
        here = steps_in(zone, motion.poses, body)
        most = 0.0 if zone.cost else zone.v_max * (1.0 + OVER)
        if np.any(speed[here] > most) and not here[[0, -1]].any():
            found.append(zone)
    return tuple(found)


def reverses_at_a_cost(motion: Trajectory, body: Body) -> bool:
    """Return whether a motion drives backwards anywhere faster than its body may, or at all where
    that counts more than driving ahead.
    """
    speed = -twists(motion.poses)[:, 0] / np.diff(motion.times)
    most = body.kinematics.v_back if body.kinematics.back_cost == 1.0 else ON_SPOT
    return bool(np.any(speed > most * (1.0 + OVER)))


def as_obstacle(zone: TrafficZone) -> Placed:
    """Return a zone as something to go around."""
    still = Kinematics(MotionModel.SE2)
    return Placed("", Body(zone.polygon, still), (0.0, 0.0, 0.0))


# ------------------ What lateral_a_max and alpha_max allow along the heading
# Ways are poses with a constant twist from each to the next, so their curvature is constant by
# pieces and a change of it is a step. A step is driven over as if the curvature rose evenly along
# the shorter of the pieces beside it, and never by more turn rate than alpha_max makes good within
# a moment; where that is too slow, the body rests.


ALONG = 0.5
"""At most this share of ``alpha_max`` is for changes of curvature, what is left for changes of
speed.
"""
MOMENT = 0.05
"""What ``alpha_max`` makes good within so many s needs no ramp of its own."""
SLOW = 0.3
"""A body rests where the curvature jumps so that it could pass with less than this share of its top
speed only.
"""


class Bends(NamedTuple):
    """How a way bends, by piece: signed ``ways`` (m), ``turns`` (rad), ``bends`` (1/m; 0 on the
    spot), and which pieces are one ``arc``; by inner pose: by how much the curvature ``jumps``
    where the body need not rest (1/m).
    """

    ways: FloatArray
    turns: FloatArray
    bends: FloatArray
    arc: IntArray
    jumps: FloatArray

    @staticmethod
    def of(ways: FloatArray, turns: FloatArray) -> Bends:
        """Return how pieces of such signed ``ways`` and ``turns`` bend."""
        spot = np.abs(ways) <= ON_SPOT * np.abs(turns)
        bends = np.where(spot, 0.0, turns / np.where(spot, 1.0, ways))
        drives = np.where(spot, 0.0, ways)
        passes = drives[:-1] * drives[1:] > 0.0
        least = np.where(passes, np.minimum(*np.abs([ways[:-1], ways[1:]])), 1.0)
        jumps = np.where(passes, np.abs(np.diff(bends)), 0.0)
        jumps[jumps <= SAME + 1e-7 / least] = 0.0  # headings may be off by 1e-7 rad
        turns_on = spot[:-1] & spot[1:] & (turns[:-1] * turns[1:] > 0.0)
        cut = (jumps > 0.0) | ~(passes | turns_on)
        arc = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(cut)])
        return Bends(drives, turns, bends, arc, jumps)

    @property
    def whole(self) -> Bends:
        """The same way with the pieces of each arc as one."""
        firsts = np.flatnonzero(np.diff(self.arc, prepend=-1))
        return Bends.of(*(np.add.reduceat(a, firsts) for a in (self.ways, self.turns)))

    def tops(self, kinematics: Kinematics) -> FloatArray:
        """Return the speeds (m/s) that the lateral acceleration, v^2 k on a curvature k, allows."""
        tight = np.maximum(np.abs(self.bends), SAME)
        return np.sqrt(np.where(tight > SAME, kinematics.lateral_a_max, math.inf) / tight)


class TurnLimits(NamedTuple):
    """What a way's bends allow: top speeds ``tops`` (m/s) and accelerations ``pushes`` (m/s^2)
    between poses, infinite where they say nothing; and at which inner poses a body ``rests``.
    """

    tops: FloatArray
    pushes: FloatArray
    rests: BoolArray


def limits_in_bends(poses: FloatArray, kinematics: Kinematics) -> TurnLimits:
    """Return what the bends of a way (n, 3) allow.

    A step dk of the curvature over l m turns faster by v^2 dk / l, which takes at most a share of
    ``alpha_max`` (``ALONG``), and half of it on either side. What the steps beside an arc of
    curvature k leave of ``alpha_max`` is for speeding up in it, which takes k a.
    """
    n = len(poses) - 1
    if not kinematics.heeds_turns or n < 1:
        free = np.full(n, math.inf)
        return TurnLimits(free, free, np.zeros(max(n - 1, 0), dtype=np.bool_))
    way = Bends.of(*twists(poses).T[[0, 2]])
    most, alpha = way.tops(kinematics), kinematics.alpha_max
    length = np.maximum(np.abs(np.bincount(way.arc, way.ways)), SAME)[way.arc]
    least = np.minimum(length[:-1], length[1:])
    jumps = way.jumps if math.isfinite(alpha) else np.zeros(n - 1)
    steps = np.where(jumps > 0.0, jumps, SAME**2)
    push = ALONG * alpha
    speeds = np.minimum(np.sqrt(push * least / steps), push * MOMENT / steps)
    fast = np.minimum(kinematics.v_max, np.minimum(most[:-1], most[1:]))
    rests = (jumps > 0.0) & (speeds < SLOW * fast)
    speeds = np.where(rests | (jumps == 0.0), math.inf, speeds)
    most[:-1] = np.minimum(most[:-1], speeds)
    most[1:] = np.minimum(most[1:], speeds)
    used = np.where(np.isinf(speeds), 0.0, 0.5 * np.minimum(speeds, fast) ** 2 * jumps)
    taken = np.bincount(way.arc[:-1], used, n) + np.bincount(way.arc[1:], used, n)
    left = alpha - taken[way.arc] / length
    return TurnLimits(most, left / np.maximum(np.abs(way.bends), SAME**2), rests)


def turns_evenly(motion: Trajectory, kinematics: Kinematics) -> bool:
    """Return whether the turn rate of a motion never changes faster than it may, from rest to rest:
    means between samples, and a ``MOMENT`` is allowed for steps.
    """
    alpha = kinematics.alpha_max
    if math.isinf(alpha):
        return True
    times = motion.times
    middle = np.concatenate([times[:1], 0.5 * (times[1:] + times[:-1]), times[-1:]])
    rates = np.concatenate([[0.0], np.diff(motion.poses[:, 2]) / np.diff(times), [0.0]])
    # since any time before, by more than alpha times what has passed
    grown = [s * rates - alpha * (1.0 + SAME) * middle for s in (1.0, -1.0)]
    least = alpha * MOMENT
    return all(bool(np.all(g - np.minimum.accumulate(g) <= least)) for g in grown)


# ------------------ Ramps of the curvature
# Ways of arcs whose curvature jumps become ways on which it changes in small steps. The curvature
# becomes its mean over a window about each place: that makes a clothoid of a jump, in small arcs,
# and a low bump of a short arc (Scheuer & Laugier 1998; Fraichard & Scheuer 2004 put clothoids
# between arcs). Headings stay about what they were, and the end of the way moves a little; the arcs
# are made longer or shorter, as little as it takes, until it ends where it did.


def with_ramps(motion: Trajectory, body: Body, blocked: Callable[[FloatArray], int]) -> Trajectory:
    """Return the motion of a body that drives along its heading, from time 0, as its limits allow:
    with ramps where these are quicker than rests, and ``blocked`` (the first of the poses (n, 3)
    after which a way is not free, or -1) lets them be. A ramp that is not free is halved.
    """
    rows = motion.poses[moves_on(motion.poses)]
    way = Bends.of(*twists(rows).T[[0, 2]]).whole
    best = driven(rows, body)
    if not way.jumps.any():
        return best
    windows = _windows(way, body.kinematics)
    for share in (1.6, 0.8, 0.4, 0.2):
        found = _ramped(way, rows, share * windows, body.kinematics, blocked)
        if found is not None:
            best = min(best, driven(found, body), key=lambda one: one.duration)
    return best


def _windows(way: Bends, kinematics: Kinematics) -> FloatArray:
    """Return over how many metres each jump may be made good at the speed that is had there."""
    tops = np.minimum(way.tops(kinematics), kinematics.v_max)
    if kinematics.mobility.rolls:
        tops = np.minimum(tops, kinematics.omega_max / np.maximum(np.abs(way.bends), 1e-9))
    fast = np.minimum(tops[:-1], tops[1:]) ** 2
    s = np.concatenate([[0.0], np.cumsum(np.abs(way.ways))])
    rests = s[np.concatenate([[True], way.jumps == 0.0, [True]])]
    near = np.abs(s[1:-1, None] - rests).min(axis=1)
    push = ALONG * kinematics.alpha_max
    # a short arc becomes a bump of its turn, which is the lower the longer it is
    turns = np.maximum(np.abs(way.turns[1:]), np.abs(way.turns[:-1]))
    windows = np.minimum(fast * way.jumps / push, np.sqrt(fast * turns / push))
    return np.asarray(np.minimum(windows, 5.0 * near))


def _ramped(
    way: Bends,
    rows: FloatArray,
    windows: FloatArray,
    kinematics: Kinematics,
    blocked: Callable[[FloatArray], int],
) -> FloatArray | None:
    """Return a way with ramps over at most such ``windows`` (m) that is free, if there is one."""
    step = MOMENT * SLOW * kinematics.v_max
    for k in range(30):  # each time half as long where it hits something, and wider around
        windows = np.where(windows > step, windows, 0.0)
        if not windows.any():
            return None
        found = _closed(way, rows, windows, 2.0 * step)
        if found is None:
            windows = 0.5 * windows
            continue
        hit = blocked(found[0])
        if hit < 0:
            return found[0]
        poses, joints = found
        far = np.hypot(*(poses[joints, :2] - poses[hit, :2]).T)
        least = max(float(far[windows > 0.0].min()), 0.3 * k)
        windows[far <= np.maximum(0.5 * windows, least)] *= 0.5
    return None


def _closed(
    way: Bends, rows: FloatArray, windows: FloatArray, step: float
) -> tuple[FloatArray, IntArray] | None:
    """Return the way with ramps over such ``windows`` (m), in steps of at most ``step`` m, from the
    first of ``rows`` to the last, and which of its poses is where each jump was; None if there is
    none.

    Newton's method: the end moves, as an arc gets longer, as if it turned about that arc's middle.
    """
    spot = way.ways == 0.0
    ahead, turn = np.where(spot, 0.0, 1.0), np.where(spot, 1.0, way.bends)
    size = np.where(spot, np.abs(way.turns), np.abs(way.ways))
    counts = np.maximum(2, np.ceil(size / np.where(spot, MOST_TURN, step)).astype(np.int64))
    ends = np.cumsum(counts)
    gone = np.zeros(len(size))
    for _ in range(25):
        ways, turns = way.ways + ahead * gone, way.turns + turn * gone
        if np.any(np.where(spot, turns * way.turns, ways * way.ways) <= 0.0):
            return None
        poses = _laid(rows[0], ways, turns, counts, np.where(way.jumps > 0.0, windows, -1.0))
        off = rows[-1] - poses[-1]
        if np.abs(off).max() < 1e-10:
            poses[-1] = rows[-1]
            return poses, ends[:-1]
        here = poses[ends - counts // 2]
        gap = poses[-1] - here
        c, s = np.cos(here[:, 2]), np.sin(here[:, 2])
        by = np.stack([ahead * c - turn * gap[:, 1], ahead * s + turn * gap[:, 0], turn])
        gone = gone + size * (np.linalg.lstsq(by * size, off, rcond=1e-9)[0])
    return None


def _laid(
    start: FloatArray, ways: FloatArray, turns: FloatArray, counts: IntArray, windows: FloatArray
) -> FloatArray:
    """Return the poses (k, 3) of arcs of such signed ``ways`` and ``turns``, each in so many parts,
    with the curvature of each part the mean over a window about it, as long as that of the jumps
    beside it (``windows``, m; -1: a rest).
    """
    parts, turned = np.repeat(ways / counts, counts), np.repeat(turns / counts, counts)
    s = np.concatenate([[0.0], np.cumsum(np.abs(parts))])
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    middle, first = 0.5 * (s[1:] + s[:-1]), 0
    for run in np.split(np.arange(len(ways)), np.flatnonzero(windows < 0.0) + 1):
        last = first + int(counts[run].sum())
        low, high, here = s[first], s[last], slice(first, last)
        if len(run) > 1:
            joints = s[first + np.cumsum(counts[run])[:-1]]
            width = np.interp(middle[here], joints, windows[run[:-1]])
            size = np.abs(parts[here])
            half = 0.5 * np.maximum(width, size)
            # beyond its ends it would go on as it begins and ends
            far = 2.0 * (high - low)
            known = (
                np.concatenate([[low - far], s[first : last + 1], [high + far]]),
                np.concatenate(
                    [
                        [heading[first] - far * turned[first] / size[0]],
                        heading[first : last + 1],
                        [heading[last] + far * turned[last - 1] / size[-1]],
                    ]
                ),
            )
            mean = np.interp(middle[here] + half, *known) - np.interp(middle[here] - half, *known)
            turned[here] = size * mean / (2.0 * half)
        first = last
    heading = start[2] + np.concatenate([[0.0], np.cumsum(turned)])
    chord, along = parts * np.sinc(turned / (2.0 * math.pi)), heading[:-1] + 0.5 * turned
    x, y = (np.append(0.0, np.cumsum(chord * f(along))) for f in (np.cos, np.sin))
    return np.stack([start[0] + x, start[1] + y, heading], axis=1)


# ------------------ Bends of what moves in any direction
# How such a way is cut into pieces, and what its body may do in a bend.


SHORT = 1e-7
"""Steps shorter than this (m) carry no shape of their own."""
STRAIGHT, SHARP = 1e-4, 0.35
"""An omnidirectional body bends where its direction changes by more from sample to sample, and
rests where it changes by more.
"""


def bends_of(
    poses: FloatArray, s: FloatArray, times: FloatArray, body: Body, most: FloatArray
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return how an omnidirectional body gets along a way that was driven at ``times`` (n,): top
    speeds (m/s) between samples, none above ``most`` (n - 1,), whether it keeps to one speed there,
    and where it has to rest.

    What was driven keeps to the limits, so a bend may be driven at one speed that is not more, nor
    than what the cubics allow (:func:`between_bends`) where they bend most: at the ends of one.
    """
    kin = body.kinematics
    fast = np.minimum(kin.v_max, most)
    step, gone = np.diff(s), np.diff(poses[:, :2], axis=0)
    turn, way = np.abs(np.diff(poses[:, 2])), np.hypot(*gone.T)
    arc = kin.reach * np.diff(poses[:, 2])
    spot = way < ON_SPOT * turn
    tops = np.where(spot, kin.v_max, np.minimum(kin.v_max, kin.omega_max * step / (turn + 1e-12)))
    driven = np.minimum(step / np.diff(times), kin.v_max)
    unit = np.column_stack((gone, arc)) / np.maximum(step, SHORT)[:, None]
    change = np.diff(np.where(spot[:, None], 0.0, unit), axis=0)
    change = np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2])
    bend = change > STRAIGHT
    # a little slower than its planner chose, and at rest where that is far below its top speed
    speed = 0.95 * np.minimum(driven[1:], driven[:-1])
    slow = bend & (speed < 0.3 * np.minimum(fast[1:], fast[:-1]))
    rests = (spot[1:] != spot[:-1]) | slow | (change > SHARP)
    bend &= ~rests
    steady = np.zeros(len(step), dtype=np.bool_)
    for side in (slice(None, -1), slice(1, None)):
        steady[side] |= bend
        tops[side] = np.where(bend, np.minimum(tops[side], speed), tops[side])
    at_rest = np.concatenate([[True], rests, [True]])
    p, q = _leanings(poses, s, ways_at(poses, s, at_rest))
    pull = 2 * np.maximum(np.hypot(*(2 * p - q).T), np.hypot(*(2 * q - p).T))
    most = np.minimum(most, step * np.sqrt(kin.a_max / np.maximum(pull, SHORT**2)))
    tops = np.where(spot, tops, np.minimum(tops, most))
    return tops, steady, at_rest


def ways_at(poses: FloatArray, s: FloatArray, rests: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction per metre (n, 2) in which an omnidirectional body comes to each sample
    of its way, and that in which it leaves: where it ``rests`` (n,), those of the pieces, else that
    of a straight piece beside it, else the mean of both sides.
    """
    unit = np.diff(poses[:, :2], axis=0) / np.diff(s)[:, None]
    change = np.concatenate([[0.0], np.hypot(*np.diff(unit, axis=0).T), [0.0]])
    bend = change > STRAIGHT
    before, after = np.concatenate([unit[:1], unit]), np.concatenate([unit, unit[-1:]])
    begins = bend & ~np.append(False, bend[:-1])
    ends = bend & ~np.append(bend[1:], False)
    mean = 0.5 * (before + after)
    way = np.where((begins & ~ends)[:, None], before, mean)
    way = np.where((ends & ~begins)[:, None], after, way)
    return np.where(rests[:, None], before, way), np.where(rests[:, None], after, way)


def between_bends(
    poses: FloatArray,
    s: FloatArray,
    ways: tuple[FloatArray, FloatArray],
    i: IntArray,
    share: FloatArray,
) -> FloatArray:
    """Return the poses (k, 3) ``share`` (k,) of the way from samples ``i`` (k,) of an
    omnidirectional body's way to the next ones, along cubics (Hermite) that keep its direction
    (``ways``, see :func:`ways_at`) from jumping.
    """
    u = share[:, None]
    out = poses[i] + u * (poses[i + 1] - poses[i])
    p, q = (some[i] for some in _leanings(poses, s, ways))
    out[:, :2] += u * (1 - u) * ((1 - u) * p + u * q)
    return np.asarray(out)


def _leanings(
    poses: FloatArray, s: FloatArray, ways: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return by how much (m) cubics between samples lean off their chords where they begin, and
    where they end, shapes (n - 1, 2).
    """
    step, chord = np.diff(s)[:, None], np.diff(poses[:, :2], axis=0)
    comes, leaves = ways
    return leaves[:-1] * step - chord, chord - comes[1:] * step
