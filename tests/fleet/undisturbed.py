"""What a drive takes of a battery when nobody is in the way: metered for the judge of fleet plans.

The way is asked for from the problem as its author wrote it; neither the package's own meter nor
what the plan says is read.
"""

from __future__ import annotations

import numpy as np

from tests.fleet.shapes import same
from up_samp.fleet.files import read_record
from up_samp.fleet.loads import with_load
from up_samp.fleet.outlines import body_of, still
from up_samp.fleet.records import Attached, RobotType
from up_samp.geometry import load_map
from up_samp.model import Deadline, PathQuery, Placed
from up_samp.motion import MotionService


class Undisturbed:
    """Meters drives of one fleet problem (``spec``: a dictionary)."""

    def __init__(self, spec) -> None:
        self.spec = spec
        self.service = MotionService(load_map(spec["map"]))
        self.known: dict = {}

    def amount(self, robot, rows, order) -> float:
        """Return what a drive from the first to the last of its samples takes; with the load of an
        ``order`` (as it is written) on board, or with none.
        """
        kind = self.spec["robots"][robot]["type"]
        ends = tuple(self._place(rows[i, 1:4]) for i in (0, -1))
        key = (kind, ends, None if order is None else order["id"])
        if key not in self.known:
            self.known[key] = self._amount(kind, ends, order)
        return self.known[key]

    def _amount(self, kind, ends, order) -> float:
        written = self.spec["robot_types"][kind]
        battery = written["battery"]
        record = read_record(RobotType, written)
        body = body_of(record)
        if order is not None:
            body = with_load(record, read_record(Attached, order["attached"]))
        zones = tuple(
            Placed(name, still(tuple(zone["polygon"])), (0.0, 0.0, 0.0))
            for name, zone in self.spec["zones"].items()
            if kind in zone.get("keep_out", ())
        )
        way = self.service.plan(PathQuery(body, ends, zones), Deadline.after(60.0)).trajectory
        assert way is not None, f"no way from {ends[0]} to {ends[1]}"
        metres = np.hypot(*np.diff(way.poses[:, :2], axis=0).T).sum()
        used = battery.get("per_metre", 0.0) * metres
        return float(used + battery.get("per_second", 0.0) * way.duration)

    def _place(self, pose):
        """Return the place that a sample (rounded) means."""
        places = (p["pose"] for p in self.spec["places"].values())
        return next(tuple(map(float, p)) for p in places if same(p, pose))
