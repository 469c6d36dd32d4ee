"""Shapes on the floor: footprints at their poses, areas with rules, straight ways to docks."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from shapely.geometry import MultiPoint
from unified_planning.model import Type
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType

from up_samp.fleet.fields import Outline, Point, Pose, corners_of
from up_samp.fleet.records import GROUND, FleetRecords, Place, RobotType, Zone
from up_samp.model import Body, Kinematics, MotionModel, Placed, TrafficZone
from up_samp.model.frames import Frame
from up_samp.upio.read_maps import read_movable


def front_of(place: Place) -> Pose | None:
    """Return where the straight way to a place begins (None: it is come to anyhow)."""
    if place.docking is None:
        return None
    metres = place.docking.metres
    return Frame(*place.pose).of((metres if place.docking.backwards else -metres, 0.0, 0.0))


def dock_zone(place: Place, height: float) -> TrafficZone:
    """Return the rule that robots come straight to a place: a strip 2 cm wide, from 1 cm behind the
    front to 1 cm behind the place.
    """
    assert place.docking is not None
    docking, half = place.docking, 0.01
    far = docking.metres - half
    ends = (-half, far) if docking.backwards else (-far, half)
    corners = [(ends[0], -half), (ends[1], -half), (ends[1], half), (ends[0], half)]
    points = Frame(*place.pose).points(corners)
    most = math.inf if docking.v_max is None else docking.v_max
    strip = tuple((float(x), float(y)) for x, y in points)
    return TrafficZone(strip, most, height, dock=place.pose)


MODELS = {
    "car": MotionModels.REEDSSHEPP,
    "diff": MotionModels.REEDSSHEPP,
    "omni": MotionModels.SE2,
}


def placed(outline: Outline, pose: Pose) -> npt.NDArray[np.float64]:
    """Return an outline's corners at a pose, shape (n, 2)."""
    return Frame(*pose).points(corners_of(outline))


def body_of(kind: RobotType) -> Body:
    """Return what robots of a type are to the motion planners, without the rules of zones."""
    return read_movable(movable("robot", MovableType("robot"), kind)).body


def movable(
    name: str,
    movable_type: Type,
    kind: RobotType,
    zones: tuple[TrafficZone, ...] = (),
    *,
    along: bool = False,
) -> MovableObject:
    """Return a robot of ``kind`` as UP's object, which obeys the rules of ``zones``; ``along``: if
    it can it drives on its own wheels when another one takes it along.
    """
    told: dict[str, Any] = {"zones": zones} if zones else {}
    told |= {"drives_along": True} if along and kind.model == "omni" else {}
    return MovableObject(
        name,
        movable_type,
        footprint=corners_of(kind.footprint),
        motion_model=MODELS[kind.model],
        motion_parameters=_limits(kind) | told,
    )


def _limits(kind: RobotType) -> dict[str, Any]:
    limits = {"v_max": kind.v_max, "a_max": kind.a_max, "reverse": kind.reverse != "never"}
    more = ("reverse_v_max", "lateral_a_max", "alpha_max")
    limits |= {"reverse_cost": kind.back_cost} if kind.back_cost > 1.0 else {}
    limits |= {key: most for key in more if (most := getattr(kind, key)) is not None}
    if kind.model == "car":
        return limits | {"turning_radius": kind.turning_radius}
    if kind.model == "diff":
        tightest = kind.v_max / kind.omega_max
        limits["turning_radius"] = tightest if kind.pivoting == "never" else 0.0
    return limits | {"omega_max": kind.omega_max}


def still(outline: Outline) -> Body:
    """Return the body of something that does not drive."""
    return Body(tuple(corners_of(outline)), Kinematics(MotionModel.SE2))


HALF = 0.02
"""rad from half a turn, at which headings do not tell which way round a leaf swings."""


def swept(outline: Outline, first: Pose, last: Pose) -> list[tuple[float, float]]:
    """Return the corners of a convex area that holds an outline all the way from one pose to
    another: it swings about the one point that stays where it is (a hinge), the shorter way round
    (either way, where both are as long), or slides where it does not turn.
    """
    ends = [complex(*first[:2]), complex(*last[:2])]
    turn = math.remainder(last[2] - first[2], math.tau)
    if abs(turn) < 1e-6:
        corners = [corner for pose in (first, last) for corner in placed(outline, pose)]
    else:
        whole = cmath.exp(1j * turn)
        hinge = (ends[1] - whole * ends[0]) / (1 - whole)
        parts = 32  # each less than a tenth of a radian
        wide = 1 / math.cos(turn / parts / 2)  # what chords cut off the arcs
        leaf = [wide * (complex(x, y) - hinge) for x, y in placed(outline, first)]
        steps = range(-parts if abs(turn) > math.pi - HALF else 0, parts + 1)
        both = itertools.product(steps, leaf)
        swung = [hinge + cmath.exp(1j * turn * k / parts) * z for k, z in both]
        corners = [(z.real, z.imag) for z in swung]
    return list(convex_hull(corners))


def convex_hull(points: Iterable[Point]) -> tuple[Point, ...]:
    """Return the corners of the convex hull of points."""
    corners = MultiPoint([*points]).convex_hull.exterior.coords
    return tuple((float(x), float(y)) for x, y in corners[:-1])


def area_of(records: FleetRecords, name: str) -> Placed:
    """Return a zone, or the doorway of an automatic door, as an obstacle."""
    area = records.zones.get(name) or records.automatic_doors[name]
    return lying(name, area.polygon)


def lying(name: str, corners: Sequence[Point]) -> Placed:
    """Return a part of the floor as an obstacle, about its middle: discs about that are small, and
    floors may lie far from the world's origin.
    """
    x, y = (round((min(side) + max(side)) / 2, 2) for side in zip(*corners, strict=True))
    return Placed(name, still(tuple((a - x, b - y) for a, b in corners)), (x, y, 0.0))


def zone_of(zone: Zone, height: float = 0.0) -> TrafficZone:
    """Return the rules that a zone has for those who heed it; ``height``: of its floor (m)."""
    most = math.inf if zone.v_max is None else zone.v_max
    free = zone.pivoting == "free", zone.stopping == "free"
    return TrafficZone(zone.polygon, most, height, zone.one_way, *free, zone.avoid)


def rules_for(
    records: FleetRecords, kind: str, floor: str | None = None
) -> tuple[TrafficZone, ...]:
    """Return the rules that zones have for robots of a type, the lanes that these prefer, and how
    they come to docks, on one floor or on all.
    """
    heights = {name: storey.height for name, storey in records.floors.items()} | {GROUND: 0.0}
    zones = [
        zone_of(zone, heights[zone.floor])
        for zone in records.zones.values()
        if zone.has_rules and floor in (None, zone.floor) and zone.heeded_by(kind)
    ]
    lanes = [
        TrafficZone(area, height=heights[lane.floor], prefer=lane.prefer)
        for lane in records.lanes.values()
        if floor in (None, lane.floor) and lane.heeded_by(kind)
        for area in lane.areas
    ]
    docks = [
        dock_zone(place, heights[place.floor])
        for place in records.places.values()
        if place.docking is not None and floor in (None, place.floor)
    ]
    return (*zones, *lanes, *docks)


def ruled(records: FleetRecords, kind: str, floor: str, body: Body) -> Body:
    """Return a body with the rules that a floor's zones have for robots of a type."""
    return replace(body, kinematics=replace(body.kinematics, zones=rules_for(records, kind, floor)))


def kept_out(records: FleetRecords, kind: str, floor: str) -> tuple[Placed, ...]:
    """Return the zones of a floor that robots of a type must keep out of, as obstacles."""
    return tuple(
        area_of(records, name)
        for name, zone in records.zones.items()
        if kind in zone.keep_out and zone.floor == floor
    )
