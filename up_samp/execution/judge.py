"""The judge of what was driven on the floor: did anybody meet, was all kept that the problem asks?

By the validator's own geometry and rules.

What is judged, it shares no code with: tracks, contacts and rules are those of
:mod:`up_samp.validation`. Of the dependencies it only asks which bounds nobody can keep.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.execution.build import Dependencies, planned_of
from up_samp.execution.graph import At, Bound
from up_samp.execution.lives import DriveCells, Life, drives_of
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.floors import side_by_side
from up_samp.io.plan_dict import PlanDict
from up_samp.model import avoids
from up_samp.model.arrays import FloatArray
from up_samp.model.violation import Violation
from up_samp.scheduling.partial_order.orders import constraint_texts
from up_samp.upio.movers import named_as_planned
from up_samp.validation.collisions import JudgedShape, Track, hits_body
from up_samp.validation.lives import resting
from up_samp.validation.plan import judge_executed
from up_samp.validation.scene import between, carried_along
from up_samp.validation.schedule import objects_by_type
from up_samp.validation.timeline import Decisions

Drivings = Mapping[tuple[str, str], FloatArray]
"""Rows (time, progress) of each motion (activity, object)."""

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
    drives = drives_of(lives)
    planned = {(m["activity"], m["object"]): m for m in plan["motions"]}
    motions = []
    for key, trace in drivings.items():
        on = {"map": planned[key]["map"]} if "map" in planned[key] else {}
        motions.append({**_motion(drives[key], trace), **on})
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
    record = {k: v for k, v in plan.items() if k not in ("dependencies", "bound_kind", "minor")}
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


def _motion(drive: DriveCells, trace: FloatArray) -> dict[str, Any]:
    """Return what was driven, where the plan has it."""
    motion: dict[str, Any] = {
        "activity": drive.activity,
        "object": drive.object,
        "samples": _rows(drive, trace),
    }
    if drive.avoid is not None:
        motion["avoid"] = sorted(drive.avoid)
    return motion


def _rows(drive: DriveCells, trace: FloatArray) -> list[list[float]]:
    """Return samples [t, x, y, theta]; where the path's curvature changes there is one, too."""
    times, s = trace.T
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
    poses = drive.frame.inverse.out(path.poses_at(s))
    rows = np.round(np.column_stack([times, poses]), 6) + 0.0
    later = np.diff(rows[:, 0], prepend=-np.inf) > 0.0  # times do not go back: they are sorted
    found: list[list[float]] = rows[later].tolist()
    return found


# ------------------ Did anybody meet


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
    between: JudgedShape | None = None
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
        shapes[name] = JudgedShape(name, np.array(entry["footprint"], dtype=float))
    for name in shapes:
        lives[name] = _life(record, name, shapes)
    found = []
    for one, other in itertools.combinations(lives, 2):
        for a, b in itertools.product(lives[one], lives[other]):
            low, high = max(a.since, b.since), min(a.until, b.until)
            heeded = (a.activity and avoids(a.avoid, other)) or (
                b.activity and avoids(b.avoid, one)
            )
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
                for p, q in itertools.product(
                    (shapes[one], *filter(None, (a.between,))),
                    (shapes[other], *filter(None, (b.between,))),
                )
            ]
            hits = [time for time in times if time is not None]
            if hits:
                found.append(Contact(min(hits), one, other, a.activity, b.activity))
    return sorted(found, key=lambda c: c.time)


Texts = tuple[str, ...]


def broken_rules(dependencies: Dependencies, record: dict[str, Any]) -> tuple[Texts, Texts]:
    """Return which conditions, resources, orders and other rules of the problem what was executed
    breaks, and which deadlines, windows and longest durations (the graph's bounds) it misses.

    Times are real (to 1 ms): an effect is seen right after its instant. A broken rule is excused
    where a bound that stands for it was missed. Nothing is said where the problem is not known.
    """
    if dependencies.problem is None:
        return (), ()
    problem, bounds = named_as_planned(dependencies.problem, record), dependencies.graph.bounds
    unit = float(record["seconds_per_unit"])
    ticks = max(1, math.ceil(unit / TOLERANCES.strict - 1e-9))
    times = {
        a["name"]: (_instant(a["start"], ticks), _instant(a["end"], ticks))
        for a in record["activities"]
    }
    late = [b for b in bounds if _over(b, times, unit) > -2 * TOLERANCES.strict]
    missed = [b.why for b in late if _over(b, times, unit) > TOLERANCES.same_time]
    parameters = planned_of(problem, record).values
    objects = objects_by_type(problem)
    decisions = Decisions(times, parameters, objects, Fraction(1, ticks))
    samples = {(m["activity"], m["object"]): np.array(m["samples"]) for m in record["motions"]}
    ends = _known_ends(dependencies, samples)
    found = judge_executed(problem, decisions, samples, ends, unit)
    asked = _texts(problem) if late and found else {}
    broken = [v for v in found if not any(_stands_for(b.why, v, asked) for b in late)]
    fraction = re.compile(r"\b(\d+)/(\d+)\b")
    told = (fraction.sub(lambda m: f"{int(m[1]) / int(m[2]):g}", str(v)) for v in broken)
    return tuple(told), tuple(dict.fromkeys(missed))


def _known_ends(
    dependencies: Dependencies, samples: Mapping[tuple[str, str], np.ndarray]
) -> dict[tuple[str, str], np.ndarray]:
    """Return where motions end that are over as their robots are known to be there, which may be
    wrong by the localisation error along their paths: such a robot counts as there.
    """
    drives = drives_of(dependencies.lives)
    found = {}
    for key, rows in samples.items():
        error = dependencies.errors.get(key[1], 0.0)
        if key not in drives or not error:
            continue
        path = drives[key].path
        least = max(0.0, path.length - error - TOLERANCES.progress)
        last = path.poses_at(np.linspace(least, path.length, 101))
        last = drives[key].frame.inverse.out(last)
        apart = np.abs(last - rows[-1, 1:]).max(axis=1).min()
        if apart <= np.abs(np.diff(last, axis=0)).max(initial=0.0) + TOLERANCES.arrived:
            found[key] = last[-1]
    return found


def _instant(units: float, ticks: int) -> Fraction:
    """Return a time as a whole number of ticks: differences of whole units stay what they are."""
    return Fraction(math.floor(units * ticks + 0.05), ticks)


def _over(bound: Bound, times: Mapping[str, tuple[Fraction, Fraction]], unit: float) -> float:
    """Return by how much (s) a bound was missed (negative: it was kept)."""
    at = []
    for event in (bound.first, bound.then):
        if event.at is not At.ORIGIN and event.activity not in times:
            return -math.inf
        end = event.at is At.END
        at.append(0.0 if event.at is At.ORIGIN else float(times[event.activity][end]) * unit)
    return at[1] - at[0] - bound.most


def _texts(problem: SchedulingProblem) -> dict[Any, set[str]]:
    """Return how the graph's bounds name each constraint."""
    found: dict[Any, set[str]] = {}
    for node, text in constraint_texts(problem):
        found.setdefault(node, set()).add(text)
    return found


def _stands_for(why: str, broken: Violation, asked: Mapping[Any, set[str]]) -> bool:
    if broken.kind == "duration":
        return why == f"duration of {broken.about[0]}"
    if broken.node is not None:
        return why in asked.get(broken.node, ())
    return any(
        re.search(rf"(sets|changes) {re.escape(name)}(?![A-Za-z0-9_])", why)
        for name in broken.about
    )


def _far(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[2] < b[0] or b[2] < a[0] or a[3] < b[1] or b[3] < a[1]


def _life(record: dict[str, Any], name: str, shapes: Mapping[str, JudgedShape]) -> list[_Piece]:
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
    changes = (c for c in record["changes"] if c["object"] == name)
    marks += [(c["time"], c) for c in changes if c["activity"] not in driven]
    radius = shapes[name].radius
    initial = next(o["initial"] for o in record["objects"] if o["name"] == name)
    pose = None if initial is None else tuple(initial)
    since = -math.inf
    pieces = []
    for time, item in sorted(marks, key=lambda m: (m[0], "samples" in m[1])):
        if pose is not None and time > since:
            pieces.append(_Piece(resting(pose, radius), since, time, "", None))
        if "samples" in item:
            rows = np.array(item["samples"], dtype=float)
            activity = item["activity"]
            end = max(spans[activity][1] * unit, rows[-1, 0])
            avoid = frozenset(item["avoid"]) if "avoid" in item else None
            carrier, poses = item["object"], rows[:, 1:]
            loads = [
                (shapes[r["object"]], tuple(r["offset"]))
                for r in rides
                if (r["activity"], r["carrier"]) == (activity, name)
            ]
            if carrier != name:
                poses = carried_along(poses, tuple(carriers[activity]["offset"]))
            held = between(shapes[name], loads) if loads else None
            track = Track(rows[:, 0], poses, max(radius, held.radius if held else 0.0))
            aboard = frozenset(shape.name for shape, _ in loads)
            pieces.append(_Piece(track, time, end, activity, avoid, carrier, aboard, held))
            pose, since = tuple(poses[-1]), end
        else:
            pose, since = tuple(item["configuration"]), time
    if pose is not None:
        pieces.append(_Piece(resting(pose, radius), since, math.inf, "", None))
    return pieces
