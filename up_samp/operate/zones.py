"""Zones that so many robots may be in at a time: who is in one when, and who waits for whom; and
how fast robots may drive where.

A robot is let into a zone only once one that was in it before has left it, wherever the plan of two
has no other room. Where one robot fits, who goes first may be decided again, as at meetings; where
more do, it stays as planned.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from up_samp.execution.build import Draft
from up_samp.execution.graph import ZONE, At, Choice, Edge, Event
from up_samp.execution.lives import DriveCells, Life, Piece
from up_samp.execution.tolerances import TOLERANCES
from up_samp.export.steps import PathPiece, stretches_of
from up_samp.fleet.records import FleetRecords, Zone
from up_samp.model import Body, ProblemError
from up_samp.motion.curves.slowing import ruled_speeds
from up_samp.motion.fleet.paths import Path
from up_samp.operate.choice import body_at
from up_samp.operate.horizon import driven_before, touches
from up_samp.operate.records import Pose

STEP = 0.05
"""m of a path between two looks whether its robot touches a zone."""


def still_counted(
    site: FleetRecords, poses: Mapping[str, Pose], moving: Collection[str]
) -> dict[str, Zone]:
    """Return a site's zones as a problem has them in which only some robots are ``moving``: those
    that have room for all of them anyhow do not count; those that hold more robots than they should
    already take these until they have left.
    """
    found = {}
    for name, zone in site.zones.items():
        if zone.max_robots is None:
            found[name] = zone
            continue
        area = Polygon(zone.polygon)
        inside = {
            r
            for r, pose in poses.items()
            if r in site.robots and area.intersects(body_at(site, r, pose))
        }
        if len(inside - {*moving}) + len(moving) > zone.max_robots:
            found[name] = replace(zone, max_robots=max(zone.max_robots, len(inside)))
    return found


@dataclass(frozen=True)
class ZoneVisit:
    """A robot is in a zone from ``since`` until ``until`` (s, plan time; without end where it is
    there first, or stays): it comes by going beyond ``enters``, and has left at ``leaves``.
    """

    robot: str
    since: float = -math.inf
    until: float = math.inf
    enters: Event | None = None
    leaves: Event | None = None


def keep_zones(
    draft: Draft, lives: Mapping[str, Life], site: FleetRecords, errors: Mapping[str, float]
) -> tuple[Choice, ...]:
    """Let robots wait before zones that are full; return what could be the other way round.
    ``errors`` (m): how far robots may be from where they tell to be.

    :raises ProblemError: where somebody would come into a zone that never gets room again.
    """
    found: list[Choice] = []
    for name, zone in site.zones.items():
        if zone.max_robots is None:
            continue
        area = Polygon(zone.polygon)
        mine = [(lives[r], area.buffer(errors[r] + STEP)) for r in site.robots if r in lives]
        visits = [v for life, wide in mine for v in visits_of(life, wide)]
        visits.sort(key=lambda v: (v.since, v.until, v.robot))
        why = f"zone '{name}' takes {zone.max_robots}"
        if zone.max_robots == 1:
            found += _one_by_one(draft, visits, why)
        else:
            for first, then in _in_rooms(visits, zone.max_robots, why):
                draft.put(Edge(first, then, 0.0, ZONE, why))
    for planned, _ in found:
        draft.put(planned)
    return tuple(found)


def visits_of(life: Life, area: BaseGeometry) -> Iterator[ZoneVisit]:
    """Yield when a robot is in an area, in the order of its life."""
    since, enters, inside = -math.inf, None, False
    for piece in life.pieces:
        for event, time, comes in _crossings(piece, life.body, area, inside):
            if not comes:
                yield ZoneVisit(life.object, since, time, enters, event)
            since, enters, inside = time, event, comes
    if inside:
        yield ZoneVisit(life.object, since, enters=enters)


def _crossings(
    piece: Piece, body: Body, area: BaseGeometry, inside: bool
) -> Iterator[tuple[Event | None, float, bool]]:
    """Yield where a piece of a life comes into an area, or has left it: by which event, when, and
    whether it comes.
    """
    if not isinstance(piece, DriveCells):
        if not inside and touches(body, np.array([piece.pose[:3]], dtype=np.float64), area)[0]:
            yield piece.enter, -math.inf if piece.enter is None else piece.since, True
        return
    path = piece.path
    at = np.append(np.arange(0.0, path.length, STEP), path.length)
    there = touches(body, path.poses_at(at), area)
    for k in np.flatnonzero(there != np.append(inside, there[:-1])).tolist():
        # it waits a look before, and has left a look after
        s = round(float(at[max(k - 1, 0)] if there[k] else at[k]), 6)
        if there[k]:
            event = Event(At.LEAVE, piece.activity, piece.object, s)
            yield event, float(piece.left(np.array([s]))[0]), True
        else:
            event = Event(At.REACH, piece.activity, piece.object, s)
            yield event, float(piece.reached(np.array([s]))[0]), False


def _one_by_one(draft: Draft, visits: Sequence[ZoneVisit], why: str) -> Iterator[Choice]:
    """Yield who could go first instead of whom; what cannot be otherwise is put into the draft."""
    for one, two in itertools.combinations(visits, 2):
        if one.robot == two.robot or two.enters is None:
            continue
        if one.leaves is None or one.until > two.since + 2 * TOLERANCES.late:
            raise ProblemError(f"'{two.robot}' and '{one.robot}' would be in one: {why}")
        planned = Edge(one.leaves, two.enters, 0.0, ZONE, why)
        if one.enters is None or two.leaves is None:
            draft.put(planned)
        else:
            other = Edge(two.leaves, one.enters, 0.0, ZONE, why, free=True)
            yield replace(planned, free=True), other


def _in_rooms(visits: Iterable[ZoneVisit], most: int, why: str) -> Iterator[tuple[Event, Event]]:
    """Yield who has to have left before who may come: each takes the room that is free first."""
    rooms: list[ZoneVisit] = [ZoneVisit("", until=-math.inf)] * most
    for visit in visits:
        k = min(range(most), key=lambda i: rooms[i].until)
        before, rooms[k] = rooms[k], visit
        if visit.enters is None or not before.robot:
            continue
        if before.leaves is None or before.until > visit.since + 2 * TOLERANCES.late:
            raise ProblemError(f"'{visit.robot}' would be one too many: {why}")
        if before.robot != visit.robot:
            yield before.leaves, visit.enters


def stretches_told(
    motion: Mapping[str, Any], path: Path, points: Iterable[float] = ()
) -> Iterator[tuple[PathPiece, float, float, float]]:
    """Yield the pieces of a whole motion (see :func:`up_samp.operate.stitch.whole_motion`) along a
    path, cut at ``points`` (m) and where other limits of speed begin, with their ends (m) and how
    fast (m/s) they may be driven. Pieces that lead nowhere but for rounding are none.
    """
    most = ruled_speeds(path.poses, path.body)
    s = path.s + driven_before(motion)
    cuts = s[1:-1][most[1:] != most[:-1]].tolist()
    for piece, low, high in stretches_of(motion, {*points, *cuts}):
        if high - low <= 2 * TOLERANCES.arrived:
            continue
        first = int(np.searchsorted(s, low + TOLERANCES.arrived, side="right")) - 1
        last = int(np.searchsorted(s, high - TOLERANCES.arrived))
        yield piece, low, high, float(path.tops[max(0, first) : last].max())
