"""The last stretch to a dock: straight, along the dock's heading, as a zone with ``dock`` asks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from up_samp.geometry import Scene, sweeps
from up_samp.model import Body, Configuration, TrafficZone
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.slowing import last_stay
from up_samp.motion.curves.trapezoid import timed_chain
from up_samp.motion.guides.search_space import MARGIN_SHARES
from up_samp.motion.protocol import Leg, LegQuery


def dock_of(body: Body, goal: Configuration) -> TrafficZone | None:
    """Return the zone that tells how a body comes to a pose, if there is one."""
    if body.flies:
        return None
    return next((z for z in body.kinematics.zones if z.dock and z.binds(goal)), None)


def but_docks(body: Body) -> Body:
    """Return a body without what its docks ask for."""
    zones = tuple(zone for zone in body.kinematics.zones if zone.dock is None)
    if len(zones) == len(body.kinematics.zones):
        return body
    return replace(body, kinematics=replace(body.kinematics, zones=zones))


def is_docking(body: Body, start: Configuration, goal: Configuration) -> bool:
    """Return whether a leg is the straight stretch to a dock, or a part of it."""
    zone = dock_of(body, goal)
    return zone is not None and zone.leads_in(start)


def before_docking(body: Body, poses: tuple[Configuration, ...]) -> tuple[Configuration, ...]:
    """Return the poses that a body may go between as it likes: all but a dock that it comes to
    straight, from the last one before.
    """
    return poses[:-1] if is_docking(body, *poses[-2:]) else poses


def docking_leg(scene: Scene, query: LegQuery) -> Leg | None:
    """Return the straight stretch to a dock (None: the leg of ``query`` is none), as fast as the
    body is elsewhere, or why it cannot be driven.
    """
    zone = dock_of(query.body, query.goal)
    if zone is None or not zone.leads_in(query.start):
        return None
    if not query.body.kinematics.reverse and zone.off_dock(query.start)[0] > 0.0:
        return Leg(None, "it comes to its dock backwards, which it may not", complete=True)
    end = query.start[2] + math.remainder(query.goal[2] - query.start[2], math.tau)
    rows = np.array([query.start, (*query.goal[:2], end)], dtype=np.float64)
    motion = timed_chain(rows, query.body.kinematics)
    for share in MARGIN_SHARES:  # there is no other way: as wide as this one allows
        world = scene.world(scene.shape(query.body, scene.margin * share), query.obstacles)
        if sweeps.first_hit(world, motion.poses.copy()) < 0:
            return Leg(motion, complete=True, corners=rows)
    return Leg(None, "something stands where it comes straight to its dock", complete=True)


def comes_straight(poses: FloatArray, body: Body) -> bool:
    """Return whether a way (n, 3) comes straight to where it ends, if that is a dock: from where
    its reference point last comes into the dock's zone.
    """
    zone = dock_of(body, tuple(poses[-1].tolist()))
    if zone is None:
        return True
    since = last_stay(zone, poses)
    if since:  # where it comes in, as far as samples tell
        step = math.dist(poses[since - 1, :2], poses[since, :2])
        if zone.long - abs(zone.off_dock(poses[since])[0]) > step:
            return False
    return all(zone.leads_in(pose) for pose in poses[since:])
