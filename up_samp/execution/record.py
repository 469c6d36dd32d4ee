"""What was driven, as a plan dictionary that pictures and judges can read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from up_samp.execution.lives import Drive, Life
from up_samp.io.floors import map_number, side_by_side
from up_samp.io.plan_dict import PlanDict
from up_samp.model.frames import Frame

Drivings = dict[tuple[str, str], list[tuple[float, float]]]
"""(time, progress) of each motion (activity, object)."""

Waits = Sequence[tuple[str, float, float, str]]
"""(robot, from, until, for whom)."""

Spans = Mapping[str, tuple[float, float | None]]


def record_of(
    plan: PlanDict,
    lives: Mapping[str, Life],
    spans: Spans,
    drivings: Drivings,
    waits: Waits,
    now: float,
) -> PlanDict:
    """Return a plan-like record: real starts and ends (units, not whole), driven motions, changes.

    Activities that did not begin are missing; those that did not end, end now.
    """
    unit = float(plan["seconds_per_unit"])
    done = {n: (a, now if b is None else b) for n, (a, b) in spans.items()}
    drives = {d.key: d for life in lives.values() for d in life.drives}
    planned = {(m["activity"], m["object"]): m for m in plan["motions"]}
    frames = side_by_side(plan)[1]
    motions = []
    for key, trace in drivings.items():
        number = map_number(planned[key])
        motion = _motion(drives[key], trace, frames[number].inverse)
        motions.append({**motion, "map": number} if "map" in planned[key] else motion)
    for motion in plan["motions"]:
        name, key = motion["activity"], (motion["activity"], motion["object"])
        if name in done and key not in drives:
            # it goes nowhere
            row = [round(done[name][0], 6), *motion["samples"][0][1:]]
            motions.append({**motion, "samples": [row]})
    motions.sort(key=lambda m: m["samples"][0][0])
    changes = [
        {**c, "time": round(done[c["activity"]][1], 6)}
        for c in plan["changes"]
        if spans.get(c["activity"], (0.0, None))[1] is not None
    ]
    record = {k: v for k, v in plan.items() if k not in ("dependencies", "minor")}
    record["waits"] = [
        {"object": w[0], "since": round(w[1], 6), "until": round(w[2], 6), "for": w[3]}
        for w in waits
    ]
    if "rides" in plan:
        record["rides"] = [r for r in plan["rides"] if r["activity"] in done]
    record.update(
        engine=f"{plan['engine']} (executed)",
        lower_bound=None,
        makespan=round(max((end for _, end in done.values()), default=0.0) / unit, 6),
        activities=_activities(plan, done, unit),
        motions=motions,
        changes=sorted(changes, key=lambda c: c["time"]),
    )
    return record


def _activities(
    plan: PlanDict, done: Mapping[str, tuple[float, float]], unit: float
) -> list[dict[str, Any]]:
    """Return the activities that began, with their real times (units), in order of time."""
    found = [
        {
            **entry,
            "start": round(done[entry["name"]][0] / unit, 9),
            "end": round(done[entry["name"]][1] / unit, 9),
        }
        for entry in plan["activities"]
        if entry["name"] in done
    ]
    return sorted(found, key=lambda a: (a["start"], a["end"]))


def _motion(drive: Drive, trace: list[tuple[float, float]], home: Frame) -> dict[str, Any]:
    """Return what was driven; ``home`` leads back to where the plan has it."""
    motion: dict[str, Any] = {
        "activity": drive.activity,
        "object": drive.object,
        "samples": _rows(drive, trace, home),
    }
    if drive.avoid is not None:
        motion["avoid"] = sorted(drive.avoid)
    return motion


def _rows(drive: Drive, trace: list[tuple[float, float]], home: Frame) -> list[list[float]]:
    """Return samples [t, x, y, theta]; where the path's curvature changes there is one, too."""
    times = np.array([t for t, _ in trace])
    s = np.array([p for _, p in trace])
    path = drive.path
    kinks = path.s[path.kink]
    kinks = kinks[(kinks > s[0] + 1e-6) & (kinks < s[-1] - 1e-6)]
    if len(kinks):
        at = np.searchsorted(s, kinks, side="right")
        before, after = s[at - 1], s[at]
        apart = (kinks - before > 1e-5) & (after - kinks > 1e-5)
        kinks, at, before, after = kinks[apart], at[apart], before[apart], after[apart]
        share = (kinks - before) / (after - before)
        crossed = times[at - 1] + share * (times[at] - times[at - 1])
        times = np.concatenate([times, crossed])
        s = np.concatenate([s, kinks])
        order = np.argsort(times, kind="stable")
        times, s = times[order], s[order]
    poses = home.out(path.poses_at(s))
    rows = np.round(np.column_stack([times, poses]), 6) + 0.0
    later = np.diff(rows[:, 0], prepend=-np.inf) > 0.0  # times do not go back: they are sorted
    found: list[list[float]] = rows[later].tolist()
    return found
