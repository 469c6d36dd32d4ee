"""What travels with others in a plan: where that takes it, and who drives along by itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from up_samp.io.plan_dict import PlanDict
from up_samp.model.arrays import FloatArray


def ridden(plan: PlanDict, ride: dict[str, Any]) -> FloatArray:
    """Return rows ``[t, x, y, theta]`` (n, 4) of what travels: as its carrier does, at its place in
    that one's frame.
    """
    motion = _carrying(plan, ride)
    t, x, y, theta = np.array(motion["samples"], dtype=np.float64).T
    dx, dy, turned = (float(v) for v in ride["offset"])
    c, s = np.cos(theta), np.sin(theta)
    return np.column_stack((t, x + c * dx - s * dy, y + s * dx + c * dy, theta + turned))


def in_formation(plan: PlanDict) -> list[dict[str, Any]]:
    """Return the motions of robots that drive along, with who is their ``carrier``."""
    along = {entry["name"] for entry in plan["objects"] if entry.get("drives_along")}
    rides = [ride for ride in plan.get("rides", ()) if ride["object"] in along]
    return [{**_carrying(plan, r), **r, "samples": ridden(plan, r).tolist()} for r in rides]


def _carrying(plan: PlanDict, ride: dict[str, Any]) -> dict[str, Any]:
    key = (ride["activity"], ride["carrier"])
    return next(m for m in plan["motions"] if (m["activity"], m["object"]) == key)
