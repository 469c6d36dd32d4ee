"""Rules of places: what a body may do while any part of it is in a zone (rule 22 and on)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import shapely

from up_samp.model import TrafficZone
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.collisions import JudgedShape, pieces_of, placed
from up_samp.validation.kinematics import Limits
from up_samp.validation.lives import pose_gap
from up_samp.validation.tolerances import TOLERANCES

Parts = Sequence[tuple[JudgedShape, FloatArray]]
"""Rigid parts of a body: each with where it is at each sample of a motion, shape (n, 3)."""
Drive = tuple[Parts, FloatArray, FloatArray]
"""A motion: what moves, the times of its samples (s), and its poses (n, 3)."""


def zone_violations(
    what: str,
    limits: Limits,
    parts: Parts,
    height: float,
    times: FloatArray,
    poses: FloatArray,
) -> Iterator[Violation]:
    """Yield how a motion (plan time, s; poses (n, 3)) on a map ``height`` m up breaks the rules of
    zones; ``parts`` are the body, and what travels with it.
    """
    if len(times) < 2:
        return
    for zone in limits.zones:
        binds = zone.dock is None or pose_gap(zone.dock, tuple(poses[-1])) <= TOLERANCES.pose
        if binds and abs(zone.height - height) <= TOLERANCES.height:
            for rule in (_too_fast, _wrong_way, _turning, _standing, _not_straight):
                yield from rule(what, limits, zone, (parts, times, poses))


def _too_fast(what: str, limits: Limits, zone: TrafficZone, drive: Drive) -> Iterator[Violation]:
    """Rule 22, by mean speeds between samples; who is inside for a part of the time may have been
    faster by what it can slow down in that time.
    """
    parts, times, poses = drive
    if math.isinf(zone.v_max):
        return
    pieces = pieces_of(times, poses)
    speed = pieces.length / pieces.dt
    at, between = _inside(zone, parts) if zone.dock is None else _on_the_way_in(zone, poses)
    whole = at[1:] & at[:-1] & between
    part = (at[1:] | at[:-1] | between) & ~whole
    most = zone.v_max * (1 + TOLERANCES.limits) + TOLERANCES.noise / pieces.dt
    most = np.where(part, most + limits.a_max * pieces.dt, most)
    over = np.where(whole | part, speed - most, 0.0)
    if over.max() > 0.0:
        i = int(over.argmax())
        text = f"{what}: {speed[i]:.4g} m/s at {times[i]:.3f} s, in a zone that allows"
        yield Violation("zone-speed", f"{text} {zone.v_max:.4g}", time=float(times[i]))


def _wrong_way(what: str, limits: Limits, zone: TrafficZone, drive: Drive) -> Iterator[Violation]:
    """Rule 23: on each visit to the zone the reference point is never behind where it has been,
    along the zone's direction, by more than rounding, however slowly it got there.
    """
    _, times, poses = drive
    if zone.one_way is None:
        return
    area = shapely.Polygon(zone.polygon)
    way = np.array([math.cos(zone.one_way), math.sin(zone.one_way)])
    points = poses[:, :2]
    chords = shapely.linestrings(np.stack((points[:-1], points[1:]), axis=1))
    shapely.prepare(area)
    inside = shapely.length(shapely.intersection(chords, area))
    whole = np.hypot(*np.diff(points, axis=0).T)
    share = np.divide(inside, whole, out=np.zeros_like(whole), where=whole > 0)
    gained = np.concatenate(([0.0], np.cumsum(share * (np.diff(points, axis=0) @ way))))
    # what is gained on one visit makes up for nothing on another
    visit = np.concatenate(([0], np.cumsum((whole > 0) & (inside <= 0))))
    for number in np.unique(visit):
        some = np.flatnonzero(visit == number)
        some = np.append(some, some[-1] + 1) if some[-1] + 1 < len(gained) else some
        behind = np.maximum.accumulate(gained[some]) - gained[some]
        if behind.max() > TOLERANCES.wrong_way:
            i = int(some[np.argmax(behind > TOLERANCES.wrong_way)])
            text = f"{what}: goes {behind.max():.3g} m against the direction of a zone, from"
            yield Violation("wrong-way", f"{text} {times[i]:.3f} s on", time=float(times[i]))
            return


def _turning(what: str, limits: Limits, zone: TrafficZone, drive: Drive) -> Iterator[Violation]:
    """Rule 24: no turn about a point that is nearer than so much while any part is in the zone."""
    parts, times, poses = drive
    if zone.pivots:
        return
    pieces = pieces_of(times, poses)
    turn = np.abs(pieces.turn)
    spot = (turn > 10 * TOLERANCES.noise) & (pieces.length < TOLERANCES.on_spot * turn)
    at, between = _inside(zone, parts)
    found = np.flatnonzero(spot & (at[1:] | at[:-1] | between))
    if len(found):
        i = int(found[0])
        text = f"{what}: turns on the spot at {times[i]:.3f} s, in a zone that forbids it"
        yield Violation("turn-on-the-spot", text, time=float(times[i]))


def _standing(what: str, limits: Limits, zone: TrafficZone, drive: Drive) -> Iterator[Violation]:
    """Rule 25: no rest while any part is in the zone, be it before the motion or after it. Who
    turns back is slower than any rounding for an instant only.
    """
    parts, times, poses = drive
    if zone.stops:
        return
    pieces = pieces_of(times, poses)
    still = np.maximum(pieces.length, np.abs(pieces.turn)) <= TOLERANCES.noise
    lasts = limits.a_max * pieces.dt**2 > 10 * TOLERANCES.noise
    rests = np.append(still & lasts, True)
    rests[0] |= times[0] > TOLERANCES.late  # who is driving as the plan begins has not stood
    found = np.flatnonzero(rests & _inside(zone, parts)[0])
    if len(found):
        time = float(times[found[0]])
        text = f"{what}: stands at {time:.3f} s, in a zone without stops"
        yield Violation("stop", text, time=time)


def _not_straight(
    what: str, limits: Limits, zone: TrafficZone, drive: Drive
) -> Iterator[Violation]:
    """Rule 26: from where the reference point last comes into the zone of a dock, at the end that
    is farthest from there, it stays on the line through the dock along its heading, and has that.
    """
    _, times, poses = drive
    if zone.dock is None:
        return
    *point, heading = zone.dock
    way = np.array([math.cos(heading), math.sin(heading)])
    since = int(np.argmax(_on_the_way_in(zone, poses)[0]))
    away = poses[since:, :2] - point
    turned = np.abs((poses[since:, 2] - heading + math.pi) % math.tau - math.pi)
    off = np.maximum(np.abs(away @ (-way[1], way[0])), turned)
    if since:  # where it came in, as far as samples tell
        begin = np.abs((np.asarray(zone.polygon) - point) @ way).max()
        step = math.dist(poses[since - 1, :2], poses[since, :2]) + TOLERANCES.wrong_way
        off[0] = max(off[0], begin - abs(away[0] @ way) - step)
    if off.max() > TOLERANCES.pose:
        at = times[since + int(off.argmax())]
        text = f"{what}: {off.max():.3g} (m, rad) off the straight way to its dock at {at:.3f} s"
        yield Violation("docking", text, time=float(at))


def _on_the_way_in(zone: TrafficZone, poses: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return at, and between, which samples the reference point is in a dock's zone for good."""
    outside = ~shapely.intersects_xy(shapely.Polygon(zone.polygon), poses[:, :2])
    since = 1 + int(np.flatnonzero(outside)[-1]) if outside.any() else 0
    at = np.arange(len(poses)) >= min(since, len(poses) - 1)
    return at, at[:-1]


def _inside(zone: TrafficZone, parts: Parts) -> tuple[BoolArray, BoolArray]:
    """Return at which samples some part of a body is in a zone, and midway between which ones."""
    at = [_covers(zone, shape, poses) for shape, poses in parts]
    between = [_covers(zone, shape, 0.5 * (poses[1:] + poses[:-1])) for shape, poses in parts]
    return np.any(at, axis=0), np.any(between, axis=0)


def _covers(zone: TrafficZone, shape: JudgedShape, poses: FloatArray) -> BoolArray:
    """Return at which poses a body is in a zone (touching its edge is not)."""
    area = shapely.Polygon(zone.polygon)
    low, high = (np.array(side) for side in (area.bounds[:2], area.bounds[2:]))
    near = ((poses[:, :2] > low - shape.radius) & (poses[:, :2] < high + shape.radius)).all(axis=1)
    found = np.zeros(len(poses), dtype=np.bool_)
    if near.any():
        shapely.prepare(area)
        bodies = shapely.polygons(placed(shape.thin, poses[near]))
        found[near] = shapely.intersects(area, bodies) & ~shapely.touches(area, bodies)
    return found
