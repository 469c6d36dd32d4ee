"""Motions as the rows that plan files hold: of trajectories, of what travels along."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from up_samp.io.precision import PRECISION
from up_samp.model import Trajectory, interpolate
from up_samp.model.arrays import FloatArray


def trajectory_rows(trajectory: Trajectory) -> list[list[float]]:
    """Return ``[[t, *pose], ...]``: every sample, with more where they lie further apart than
    ``PRECISION.step`` s, without those in the middle of a rest.

    Times in s, poses as in the trajectory, all rounded to
    ``PRECISION.sample_decimals`` digits; times increase strictly.
    """
    times, poses = trajectory.times.tolist(), trajectory.poses.tolist()
    rows: list[list[float]] = []
    last = len(times) - 1
    for i, pose in enumerate(poses):
        moved = i > 0 and pose != poses[i - 1]
        if moved:
            _fill_gap(rows, trajectory, i)
        if moved or i in (0, last) or poses[i + 1] != pose:
            _append(rows, times[i], pose)
    return rows


def _fill_gap(rows: list[list[float]], trajectory: Trajectory, i: int) -> None:
    """Add samples between ``i - 1`` and ``i`` where the object moves for longer than a step."""
    before, after = trajectory.times[i - 1 : i + 1].tolist()
    # a hair below the step, so that rounding cannot push a gap above it
    pieces = math.ceil(
        (after - before) / (PRECISION.step - 2 * 10.0**-PRECISION.sample_decimals) - 1e-12
    )
    for k in range(1, pieces):
        share = k / pieces
        pose = interpolate(trajectory.poses[i - 1], trajectory.poses[i], share)
        _append(rows, before + share * (after - before), pose)


def _append(rows: list[list[float]], t: float, pose: Iterable[float]) -> None:
    row = [_rounded(t), *(_rounded(float(v)) for v in pose)]
    if rows and row[0] <= rows[-1][0]:
        # two samples within the last digit: the later one tells where the object is
        row[0] = rows[-1][0]
        rows[-1] = row
        return
    rows.append(row)


def _rounded(value: float) -> float:
    """Return ``value`` with ``PRECISION.sample_decimals`` digits and no negative zero."""
    return round(value, PRECISION.sample_decimals) + 0.0


def rows_trajectory(rows: list[list[float]]) -> Trajectory:
    """Return the trajectory whose samples are ``[[t, *pose], ...]``."""
    table = np.asarray(rows, dtype=np.float64)
    return Trajectory(table[:, 0].copy(), table[:, 1:].copy())


# ------------------ What travels with others, and who drives along by itself


def ridden(plan: Mapping[str, Any], ride: dict[str, Any]) -> FloatArray:
    """Return rows ``[t, x, y, theta]`` (n, 4) of what travels: as its carrier does, at its place in
    that one's frame.
    """
    motion = _carrying(plan, ride)
    t, x, y, theta = np.array(motion["samples"], dtype=np.float64).T
    dx, dy, turned = (float(v) for v in ride["offset"])
    c, s = np.cos(theta), np.sin(theta)
    return np.column_stack((t, x + c * dx - s * dy, y + s * dx + c * dy, theta + turned))


def in_formation(plan: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the motions of robots that drive along, with who is their ``carrier``."""
    along = {entry["name"] for entry in plan["objects"] if entry.get("drives_along")}
    rides = [ride for ride in plan.get("rides", ()) if ride["object"] in along]
    return [{**_carrying(plan, r), **r, "samples": ridden(plan, r).tolist()} for r in rides]


def _carrying(plan: Mapping[str, Any], ride: dict[str, Any]) -> dict[str, Any]:
    key = (ride["activity"], ride["carrier"])
    return next(m for m in plan["motions"] if (m["activity"], m["object"]) == key)
