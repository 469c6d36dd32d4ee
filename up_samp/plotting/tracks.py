"""Where every object of a plan is at every instant, read from the plan dictionary alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from up_samp.io.plan_dict import AREA
from up_samp.io.sampling import ridden
from up_samp.model.arrays import FloatArray
from up_samp.model.frames import Frame


@dataclass(frozen=True, eq=False)
class TrackPiece:
    """One motion of an object: ``times`` (n,) in s, ``poses`` (n, 3): x, y in m, yaw in rad."""

    activity: str
    times: FloatArray
    poses: FloatArray

    def driving(self, least: float = 0.25) -> list[tuple[float, float]]:
        """Return the intervals (s) in which the object moves; rests below ``least`` s are
        bridged, so that a cusp does not count as waiting.
        """
        moves = np.any(np.abs(np.diff(self.poses, axis=0)) > 1e-9, axis=1)
        spans: list[tuple[float, float]] = []
        for i in np.flatnonzero(moves):
            start, end = float(self.times[i]), float(self.times[i + 1])
            if spans and start - spans[-1][1] < least:
                spans[-1] = (spans[-1][0], end)
            else:
                spans.append((start, end))
        return spans


@dataclass(frozen=True)
class ObjectTrack:
    """An object over time. It rests at its last configuration; ``changes`` are instantaneous.

    ``moves`` tells robots from doors: the plan drives it, or another object of its type.
    """

    name: str
    footprint: tuple[tuple[float, float], ...]
    initial: tuple[float, float, float] | None
    legs: tuple[TrackPiece, ...]
    changes: tuple[tuple[float, tuple[float, float, float]], ...]
    moves: bool
    area: bool = False
    """It is a part of the floor, a zone, and no body."""

    def at(self, t: float) -> tuple[float, float, float] | None:
        """Return x, y (m) and yaw (rad) at ``t`` s; None where the plan does not tell."""
        pose, since = self.initial, -math.inf
        begun = (leg for leg in reversed(self.legs) if leg.times[0] <= t)
        last = max(begun, key=lambda leg: float(leg.times[0]), default=None)
        if last is not None:
            since = float(last.times[0])
            x, y, yaw = (float(np.interp(t, last.times, last.poses[:, k])) for k in range(3))
            pose = (x, y, yaw)
        for when, configuration in self.changes:
            if since <= when <= t:
                since, pose = when, configuration
        return pose

    def outline(self, pose: tuple[float, float, float]) -> FloatArray:
        """Return the footprint's corners (n, 2) at a pose, m, world frame; a small square where it
        has none.
        """
        square = ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))
        return Frame(*pose).points(self.footprint or square)


def flat(row: Sequence[float]) -> tuple[float, float, float]:
    """Return a configuration as seen from above: (x, y, yaw) of a planar or a spatial pose."""
    if len(row) == 3:
        return float(row[0]), float(row[1]), float(row[2])
    qx, qy, qz, qw = (float(v) for v in row[3:7])
    yaw = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    return float(row[0]), float(row[1]), yaw


def tracks_of(plan: dict[str, Any]) -> list[ObjectTrack]:
    """Return a track for each object of a plan dictionary, in its order."""
    types = {o["name"]: o["type"] for o in plan["objects"]}
    driven = {types[m["object"]] for m in plan["motions"]}
    tracks = []
    for entry in plan["objects"]:
        name = entry["name"]
        own = [m for m in plan["motions"] if m["object"] == name]
        rides = [ride for ride in plan.get("rides", ()) if ride["object"] == name]
        legs = [_leg(m["activity"], m["samples"]) for m in own]
        legs += [_leg(ride["activity"], ridden(plan, ride)) for ride in rides]
        changes = [
            (float(c["time"]), flat(c["configuration"]))
            for c in plan["changes"]
            if c["object"] == name
        ]
        tracks.append(
            ObjectTrack(
                name,
                tuple((float(x), float(y)) for x, y in entry["footprint"]),
                None if entry["initial"] is None else flat(entry["initial"]),
                tuple(sorted(legs, key=lambda leg: float(leg.times[0]))),
                tuple(sorted(changes)),
                entry["type"] in driven,
                entry["type"] == AREA,
            )
        )
    return tracks


Stop = tuple[ObjectTrack, tuple[float, float, float], tuple[str, ...]]
"""A place where an object stands before or after a motion: its track, its pose, the place's names.
"""


def stops_of(tracks: Sequence[ObjectTrack], places: Mapping[str, Sequence[float]]) -> list[Stop]:
    """Return where motions start and end among ``places`` (names to poses); one entry a point."""
    found: dict[tuple[float, float], Stop] = {}
    legs = [(track, leg) for track in tracks for leg in track.legs]
    ends = [(track, flat(pose)) for track, leg in legs for pose in leg.poses[[0, -1]]]
    for (track, pose), (name, place) in itertools.product(ends, places.items()):
        if math.dist(pose[:2], place[:2]) <= 1e-2:
            key = (round(place[0], 2), round(place[1], 2))
            own, first, names = found.get(key, (track, pose, ()))
            found[key] = own, first, tuple(dict.fromkeys((*names, name)))
    return list(found.values())


def _leg(activity: str, rows: Iterable[Sequence[float]]) -> TrackPiece:
    table = np.array([(row[0], *flat(row[1:])) for row in rows], dtype=np.float64)
    table[:, 3] = np.unwrap(table[:, 3])
    return TrackPiece(activity, table[:, 0], table[:, 1:])


def horizon(plan: dict[str, Any]) -> float:
    """Return the plan's length in s (at least a hair, so that axes have a width)."""
    ends = [m["samples"][-1][0] for m in plan["motions"]]
    ends += [c["time"] for c in plan["changes"]]
    ends += [a["end"] * plan["seconds_per_unit"] for a in plan["activities"]]
    return float(max([plan["makespan"] * plan["seconds_per_unit"], *ends, 1e-3]))
