"""Places that are docked at: straight, from in front of them, as their records say."""

from __future__ import annotations

import math

from up_samp.fleet.fields import Pose
from up_samp.fleet.records import Place
from up_samp.model import TrafficZone
from up_samp.model.frames import Frame


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
