"""Loads that travel with robots: in a ride the two are one body, and the load stands nowhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from up_samp.execution.graph import At, Event
from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import Body
from up_samp.upio.rides import laden_body


class Hold(NamedTuple):
    """From when (s, plan time) on a load stands nowhere in a ride, and from when on it does again;
    with the events on the floor.
    """

    gone: float
    leave: Event
    back: float
    enter: Event


def laden_bodies(plan: Mapping[str, Any], bodies: Mapping[str, Body]) -> dict[Any, Body]:
    """Return robot and loads as one body, by (activity, object), from a plan dictionary."""
    loads: dict[tuple[str, str], list[Any]] = {}
    for ride in plan.get("rides", ()):
        offset = tuple(float(v) for v in ride["offset"])
        loads.setdefault((ride["activity"], ride["carrier"]), []).append(
            (bodies[ride["object"]], offset)
        )
    return {key: laden_body(bodies[key[1]], found) for key, found in loads.items()}


def hold_of(drive: Any) -> Hold:
    """Return when a load is off the ground in a ride (``drive``: its carrier's motion)."""
    near = min(TOLERANCES.grip, drive.path.length / 2)
    low, high = round(near, 6), round(drive.path.length - near, 6)
    return Hold(
        float(drive.reached(np.array([low]))[0]),
        Event(At.REACH, drive.activity, drive.object, low),
        float(drive.left(np.array([high]))[0]),
        Event(At.LEAVE, drive.activity, drive.object, high),
    )
