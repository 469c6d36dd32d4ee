"""A plan of two, put in order: who goes first where ways cross is decided again, and everything
gets the times that follow from that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from up_samp.execution.build import Dependencies
from up_samp.execution.executor import Executor
from up_samp.execution.forecast import Forecast
from up_samp.execution.graph import At, Event
from up_samp.execution.lives import DriveCells, drives_of
from up_samp.execution.reorder import Goal, propose, settle
from up_samp.execution.tolerances import TOLERANCES
from up_samp.fleet.records import Order, Task
from up_samp.fleet.statements import Meaning
from up_samp.io.plan_dict import PlanDict
from up_samp.motion.fleet.paths import ROUNDED
from up_samp.operate.horizon import DELIVERS
from up_samp.tuning import Tuning

BESIDE = 0.8 * TOLERANCES.arrived
"""m between two samples that stand for coming to a point and leaving it: no rest for those who read
the motion, which is to be driven without one if nobody is in the way by then.
"""

LATE = 10.0
"""What a second of lateness costs beside one until an order is done."""


def goals_of(meanings: Mapping[str, Meaning], jobs: Iterable[Order | Task]) -> dict[str, Goal]:
    """Return what the activities that end some orders cost, in seconds of weight 1."""
    known, found = {j.id: j for j in jobs}, {}
    for name, meaning in meanings.items():
        job = known.get(meaning.what)
        if job is not None and meaning.kind in DELIVERS:
            late = 0.0 if job.due is None else LATE * job.weight
            found[name] = Goal(job.weight, late, job.due or 0.0)
    return found


def ordered(
    plan: PlanDict,
    told: Dependencies,
    goals: Mapping[str, Goal],
    begun: Mapping[str, float] = MappingProxyType({}),
    lead: float = 0.0,
    ahead: float | None = None,
    gone: Mapping[str, float] = MappingProxyType({}),
) -> PlanDict:
    """Return a plan in the best order that is found, with its times from now on. ``begun``: what
    has begun, and for how long (s); ``gone``: how far (m) its robots are on their motions.
    ``goals``: what ends cost. ``lead``: s until anything of a new plan can be followed. ``ahead``:
    for how many seconds robots are let drive for good, see :class:`Executor`.
    """

    def under_way(told: Dependencies, gone: Mapping[str, float]) -> Executor:
        executor = Executor(plan, dependencies=told, tuning=Tuning(horizon=1e6), ahead=ahead)
        here = {n: s for n, s in begun.items() if n in told.graph.tasks}
        ways = executor.state.ways_of
        executor.join(
            0.0,
            under_way={n: {w.object: gone.get(n, 0.0) for w in ways[n]} for n in here},
            times={n: (-s, None) for n, s in here.items()},
        )
        return executor

    executor = under_way(told, gone)
    executor.goals, executor.lead = goals, lead
    if told.undecided:
        settle(executor)
    propose(executor)
    # the plan's motions begin where they are cut, a moment behind where their robots are
    whole = under_way(replace(told, graph=executor.state.graph), {})
    return timed(plan, told, whole.retime())


def timed(plan: PlanDict, told: Dependencies, ahead: Forecast) -> PlanDict:
    """Return a plan with the times of a forecast (s), so that it has the forecast's order."""
    unit = float(plan["seconds_per_unit"])
    spans = {n: tuple(max(0.0, t) for t in ahead.span(n)) for n in ahead.graph.tasks}
    drives = drives_of(told.lives)
    on_way: dict[tuple[str, str], list[tuple[Event, float]]] = {}
    for event, time in zip(ahead.graph.events, ahead.times, strict=True):
        if event.at in (At.REACH, At.LEAVE):
            on_way.setdefault((event.activity, event.object), []).append((event, time))
    motions = []
    for motion in plan["motions"]:
        key = motion["activity"], motion["object"]
        drive = drives.get(key)
        if drive is None:  # it goes nowhere
            by = spans[key[0]][0] - motion["samples"][0][0]
            rows = [[row[0] + by, *row[1:]] for row in motion["samples"]]
            motions.append({**motion, "samples": rows})
        else:
            motions.append(_timed(motion, drive, spans[key[0]], on_way.get(key, ())))
    ends = [end for _, end in spans.values()]
    return {
        **plan,
        "activities": [
            {**a, "start": spans[a["name"]][0] / unit, "end": spans[a["name"]][1] / unit}
            for a in plan["activities"]
        ],
        "motions": sorted(motions, key=lambda m: float(m["samples"][0][0])),
        "changes": [{**c, "time": spans[c["activity"]][1]} for c in plan["changes"]],
        "makespan": max(ends, default=0.0) / unit,
    }


def _timed(
    motion: Mapping[str, Any],
    drive: DriveCells,
    span: tuple[float, ...],
    events: Iterable[tuple[Event, float]],
) -> dict[str, Any]:
    """Return a motion that comes to its points, and leaves them, at the times of a forecast."""
    path = drive.path
    marks = [(0.0, span[0])]
    for event, time in sorted(events, key=lambda e: (e[0].progress, e[0].at is At.LEAVE)):
        s, time = min(event.progress, path.length), max(time, marks[-1][1])
        if s > marks[-1][0] + BESIDE:
            marks.append((s, time))
        elif time > marks[-1][1] and s == 0.0:
            marks = [(s, time)]  # it does not begin before
        elif time > marks[-1][1] and s + BESIDE < path.length:
            marks.append((marks[-1][0] + BESIDE, time))
    if path.length > marks[-1][0] + BESIDE:
        marks.append((path.length, max(span[1], marks[-1][1])))
    at, times = np.array(marks).T
    known = np.maximum.accumulate(path.natural_s)
    gaps = np.abs(known[np.searchsorted(known, at).clip(max=len(known) - 1)] - at)
    before = np.abs(known[(np.searchsorted(known, at) - 1).clip(min=0)] - at)
    fresh = at[np.minimum(gaps, before) > BESIDE / 4]
    goes = np.append(True, np.diff(known) > 0.0)  # where it paused it need not
    every = np.concatenate([known[goes], fresh])
    poses = np.vstack([path.natural.poses[goes], path.poses_at(fresh)])
    turn = np.argsort(every, kind="stable")
    rows = np.column_stack([np.interp(every, at, times), poses])[turn]
    rows[:, 0] += ROUNDED * np.arange(len(rows))
    return {
        **motion,
        "samples": rows.tolist(),
        "progress": [round(float(s), 6) for s in every[turn]],
    }
