"""Did anybody meet? A swept check of what was driven, by the validator's own geometry.

Shares no code with the dependencies: tracks and contacts are those of :mod:`up_samp.validation`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from up_samp.io.floors import side_by_side
from up_samp.validation.collisions import Shape, hits_body
from up_samp.validation.rides import between, carried_along
from up_samp.validation.tracks import Track


@dataclass(frozen=True)
class Contact:
    """Two objects met at ``time`` (s): in which activities ("": at rest)."""

    time: float
    one: str
    other: str
    activity: str
    other_activity: str


@dataclass(frozen=True)
class _Piece:
    track: Track
    since: float
    until: float
    activity: str
    avoid: frozenset[str] | None
    carrier: str = ""
    """Who drives in the activity: the object itself, or who carries it."""
    loads: frozenset[str] = frozenset()
    """What travels with the object, and ..."""
    between: Shape | None = None
    """what holds them together."""

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Box (x low, y low, x high, y high; m) around all that the body sweeps: between two
        samples nothing is farther from one of them than the way between them.
        """
        poses = self.track.poses
        step = float(self.track.travel(self.track.times[:-1], self.track.times[1:]).max(initial=0))
        radius = max(self.track.radius, self.between.radius if self.between else 0.0)
        reach = radius + step + 1e-6
        (x, y), (u, v) = poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach
        return float(x), float(y), float(u), float(v)


def contacts_of(record: dict[str, Any]) -> list[Contact]:
    """Return all contacts in a record: pairs of pieces of two lives of which one drives."""
    record, _ = side_by_side(record)  # on different floors nobody meets
    shapes, lives = {}, {}
    for entry in record["objects"]:
        name = entry["name"]
        shapes[name] = Shape(name, np.array(entry["footprint"], dtype=float))
    for name in shapes:
        lives[name] = _life(record, name, shapes)
    found = []
    for one, other in itertools.combinations(lives, 2):
        for a, b in itertools.product(lives[one], lives[other]):
            low, high = max(a.since, b.since), min(a.until, b.until)
            heeded = (a.activity and _heeds(a, other)) or (b.activity and _heeds(b, one))
            together = a.activity and (a.activity, a.carrier) == (b.activity, b.carrier)
            if (
                other in a.loads
                or one in b.loads
                or together
                or not heeded
                or low > high
                or _far(a.box, b.box)
            ):
                continue
            low, high = max(low, -1.0), min(high, max(a.track.times[-1], b.track.times[-1]))
            high = max(low, high)
            times = [
                hits_body(p, a.track, q, b.track, low, high)
                for p in (shapes[one], *filter(None, (a.between,)))
                for q in (shapes[other], *filter(None, (b.between,)))
            ]
            hits = [time for time in times if time is not None]
            if hits:
                found.append(Contact(min(hits), one, other, a.activity, b.activity))
    return sorted(found, key=lambda c: c.time)


def _far(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[2] < b[0] or b[2] < a[0] or a[3] < b[1] or b[3] < a[1]


def _heeds(piece: _Piece, name: str) -> bool:
    return piece.avoid is None or name in piece.avoid


def _life(record: dict[str, Any], name: str, shapes: Mapping[str, Shape]) -> list[_Piece]:
    """Return an object's rests, drives and rides; the waiting in its activities belongs to the
    drives.
    """
    spans = {a["name"]: (a["start"], a["end"]) for a in record["activities"]}
    unit = record["seconds_per_unit"]
    rides = record.get("rides", ())
    carriers = {r["activity"]: r for r in rides if r["object"] == name}
    marks: list[tuple[float, Any]] = []
    driven = set(carriers)
    for motion in record["motions"]:
        ride = carriers.get(motion["activity"])
        if motion["object"] == name or (ride is not None and ride["carrier"] == motion["object"]):
            marks.append((spans[motion["activity"]][0] * unit, motion))
            driven.add(motion["activity"])
    for change in record["changes"]:
        if change["object"] == name and change["activity"] not in driven:
            marks.append((change["time"], change))
    radius = shapes[name].radius
    initial = next(o["initial"] for o in record["objects"] if o["name"] == name)
    pose = None if initial is None else tuple(initial)
    since = -math.inf
    pieces = []
    for time, item in sorted(marks, key=lambda m: (m[0], "samples" in m[1])):
        if pose is not None and time > since:
            pieces.append(_Piece(Track.resting(pose, radius), since, time, "", None))
        if "samples" in item:
            rows = np.array(item["samples"], dtype=float)
            activity = item["activity"]
            end = max(spans[activity][1] * unit, rows[-1, 0])
            avoid = frozenset(item["avoid"]) if "avoid" in item else None
            carrier, poses = item["object"], rows[:, 1:]
            mine = [r for r in rides if (r["activity"], r["carrier"]) == (activity, name)]
            if carrier != name:
                poses = carried_along(poses, tuple(carriers[activity]["offset"]))
            loads = frozenset(r["object"] for r in mine)
            held = _between(shapes[name], mine, shapes)
            track = Track(rows[:, 0], poses, max(radius, held.radius if held else 0.0))
            pieces.append(_Piece(track, time, end, activity, avoid, carrier, loads, held))
            pose, since = tuple(poses[-1]), end
        else:
            pose, since = tuple(item["configuration"]), time
    if pose is not None:
        pieces.append(_Piece(Track.resting(pose, radius), since, math.inf, "", None))
    return pieces


def _between(
    carrier: Shape, rides: Sequence[dict[str, Any]], shapes: Mapping[str, Shape]
) -> Shape | None:
    """Return what holds a carrier and its loads together."""
    loads = [(shapes[r["object"]], tuple(r["offset"])) for r in rides]
    return between(carrier, loads) if loads else None
