"""Limits of speed that hang on where a body is, on whether it drives backwards, and on how its way
bends: what a way allows, and motions slowed to that.

The one place that knows of them: a planner may find its way as if they were not there, and whoever
times a way again takes its top speeds from here.
"""

from __future__ import annotations

import math
from functools import lru_cache

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
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.motion.curves.bends import bends_of, between_bends, ways_at
from up_samp.motion.curves.rolling import (
    ON_SPOT,
    Rolls,
    moves_on,
    rolls_of,
    sampled_rolls,
    through_rows,
)
from up_samp.motion.curves.turning import limits_in_bends, turns_evenly
from up_samp.motion.curves.twists import partway, travels, twists

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
    kin = body.kinematics
    if body.mobility.rolls:
        rolls = rolls_of(rows, kin)
    else:
        ahead, across, turns = twists(rows).T
        tops, pushes = np.full((2, len(ahead)), [[kin.v_max], [kin.a_max]])
        kinds = np.sign(ahead).astype(np.int64)
        rolls = Rolls(np.hypot(ahead, across), turns, kinds, tops, pushes)
    least = np.minimum(rolls.pushes, limits_in_bends(rows, kin).pushes)
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
    poses = between_bends(rows, s, ways_at(rows, s), at, shares)
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
