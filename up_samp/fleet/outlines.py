"""Shapes on the floor: corners of footprints and where they are at a pose."""

from __future__ import annotations

import cmath
import math

import numpy as np
import numpy.typing as npt
from shapely.geometry import MultiPoint
from unified_planning.model import Type
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.shortcuts import MovableType

from up_samp.fleet.records import FleetRecords, Outline, Pose, RobotType, corners_of
from up_samp.model import Body, Kinematics, MotionModel, Placed
from up_samp.model.frames import Frame
from up_samp.upio.read_maps import read_movable

MODELS = {
    "car": MotionModels.REEDSSHEPP,
    "diff": MotionModels.REEDSSHEPP,
    "omni": MotionModels.SE2,
}


def placed(outline: Outline, pose: Pose) -> npt.NDArray[np.float64]:
    """Return an outline's corners at a pose, shape (n, 2)."""
    return Frame(*pose).points(corners_of(outline))


def body_of(kind: RobotType) -> Body:
    """Return what robots of a type are to the motion planners."""
    return read_movable(movable("robot", MovableType("robot"), kind)).body


def movable(name: str, movable_type: Type, kind: RobotType) -> MovableObject:
    """Return a robot of ``kind`` as UP's object."""
    return MovableObject(
        name,
        movable_type,
        footprint=corners_of(kind.footprint),
        motion_model=MODELS[kind.model],
        motion_parameters=_limits(kind),
    )


def _limits(kind: RobotType) -> dict[str, float | bool]:
    limits = {"v_max": kind.v_max, "a_max": kind.a_max, "reverse": kind.reverse == "free"}
    if kind.model == "car":
        return limits | {"turning_radius": kind.turning_radius}
    if kind.model == "diff":
        limits["turning_radius"] = 0.0
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
        swung = [hinge + cmath.exp(1j * turn * k / parts) * z for k in steps for z in leaf]
        corners = [(z.real, z.imag) for z in swung]
    hull = MultiPoint(corners).convex_hull.exterior.coords
    return [(float(x), float(y)) for x, y in hull[:-1]]


def area_of(records: FleetRecords, zone: str) -> Placed:
    """Return a zone as an obstacle."""
    return Placed(zone, still(records.zones[zone].polygon), (0.0, 0.0, 0.0))


def doorway_of(records: FleetRecords, door: str) -> Placed:
    """Return the area of an automatic door as an obstacle."""
    return Placed(door, still(records.automatic_doors[door].polygon), (0.0, 0.0, 0.0))


def kept_out(records: FleetRecords, kind: str, floor: str) -> tuple[Placed, ...]:
    """Return the zones of a floor that robots of a type must keep out of, as obstacles."""
    return tuple(
        area_of(records, name)
        for name, zone in records.zones.items()
        if kind in zone.keep_out and zone.floor == floor
    )
