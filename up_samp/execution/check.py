"""A plan file's dependency graph checked against its problem: nothing that it says is believed.

A graph is valid if every execution that it allows is. What it has to hold is made again: from the
motions alone who lets whom pass and which motion of an object comes after which, and with the
problem all that the problem asks for. What does not follow from the file's edges is named.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from up_samp.execution.graph import ORIGIN, At, Edge, Event, Graph, PlannedTask
from up_samp.execution.lives import DriveCells, Life, drives_of, in_turn
from up_samp.execution.meetings import Meeting, steps_of
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.files import is_number, shape_fault
from up_samp.io.plan_dict import PlanDict
from up_samp.model import MotionModel, ProblemError
from up_samp.model.errors import short

# ------------------------------------------------------------------ the file by itself


def check_motions(plan: PlanDict) -> None:
    """Raise :class:`ProblemError` for a plan in which nobody drives, or that nobody can drive."""
    if not plan["motions"]:
        raise ProblemError(f"the plan of '{plan['problem']}' has no motions: nobody drives")
    refuse(motion_faults(plan), plan)


def motion_faults(plan: PlanDict) -> list[str]:
    """Return which motions nobody can drive: faster than the body is, or from where it is not."""
    bodies = {entry["name"]: entry for entry in plan["objects"]}
    found = []
    for motion in plan["motions"]:
        entry = bodies[motion["object"]]
        rows = np.asarray(motion["samples"], dtype=np.float64)
        if MotionModel(entry["model"]).mobility.own_law or "v_max" not in entry:
            continue
        far = np.hypot(*np.diff(rows[:, 1:3], axis=0).T)
        most = 2.0 * float(entry["v_max"]) * np.diff(rows[:, 0]) + TOLERANCES.grip
        if np.any(far > most):
            k = int(np.argmax(far - most))
            place = ", ".join(f"{v:g}" for v in rows[k + 1, 1:])
            found.append(f"{motion_named(motion)} leads to ({place}) faster than it can drive")
    return found or list(_leaps(plan))


def motion_named(motion: Mapping[str, Any]) -> str:
    """Return a motion of a plan in words."""
    return f"the motion of '{motion['object']}' in activity '{motion['activity']}'"


def _leaps(plan: PlanDict) -> Iterator[str]:
    """Yield which motions begin elsewhere than their object is then."""
    for entry in plan["objects"]:
        rides = {r["activity"] for r in plan.get("rides", ()) if r["object"] == entry["name"]}
        here = entry["initial"]
        for item in in_turn(plan, entry["name"], rides):
            if "samples" not in item:
                here = item["configuration"]
                continue
            first, here_before = item["samples"][0][1:], here
            here = item["samples"][-1][1:]
            if here_before is not None and math.dist(first[:2], here_before[:2]) > TOLERANCES.grip:
                place, name = ", ".join(f"{v:g}" for v in first), entry["name"]
                yield f"{motion_named(item)} begins at ({place}), where '{name}' is not then"


def shape_faults(plan: PlanDict) -> list[str]:
    """Return what is wrong with the fields of a plan's dependencies, and of its motions' progress:
    types, ranges, names of activities.
    """
    data = plan["dependencies"]
    fault = shape_fault(data, "dependencies")
    if fault:
        return [fault]
    names = Counter(a["name"] for a in plan["activities"])
    told = Counter(task["activity"] for task in data["tasks"])
    found = [f"task '{n}' is no activity of the plan" for n in told if n not in names]
    found += [f"activity '{n}' is {told[n]} times among the tasks" for n in names if told[n] != 1]
    ways = [way for choice in data.get("choices", ()) for way in choice["ways"]]
    events = (
        e[side] for e in (*data["edges"], *data["bounds"], *ways) for side in ("first", "then")
    )
    unknown = dict.fromkeys(e[1] for e in events if e[1:] and e[1] not in names)
    found += [f"the dependencies speak of {short(n)}, which is not in the plan" for n in unknown]
    for motion in plan["motions"]:
        progress = motion.get("progress")
        if not isinstance(progress, list) or not all(is_number(p, 0.0) for p in progress):
            found.append(f"{motion_named(motion)} has no progress: a list of numbers from 0")
        elif len(progress) != len(motion["samples"]):
            count = f"{len(progress)} values of progress for {len(motion['samples'])} samples"
            found.append(f"{motion_named(motion)} has {count}")
        elif any(b < a for a, b in itertools.pairwise(progress)):
            found.append(f"{motion_named(motion)} has progress that goes back")
    return found


# ------------------------------------------------------------------ the file and its motions


def place_faults(plan: PlanDict, lives: Mapping[str, Life], events: Iterable[Event]) -> list[str]:
    """Return which values of progress are not those of the samples on their path, and which events
    speak of what is not driven there.
    """
    drives = drives_of(lives)
    found = []
    for motion in plan["motions"]:
        drive = drives.get((motion["activity"], motion["object"]))
        told = np.asarray(motion["progress"], dtype=np.float64)
        real = 0.0 * told if drive is None else np.maximum.accumulate(drive.path.natural_s)
        off = np.abs(told - real)
        if np.any(off > TOLERANCES.place):
            k = int(np.argmax(off))
            said = f"progress {told[k]:g} m at {motion['samples'][k][0]:g} s"
            found.append(f"{motion_named(motion)} has {said}, where its path is at {real[k]:g} m")
    return [*found, *dict.fromkeys(_lost(events, drives))]


def _lost(events: Iterable[Event], drives: Mapping[tuple[str, str], DriveCells]) -> Iterator[str]:
    for event in events:
        if event.at not in (At.REACH, At.LEAVE):
            continue
        drive = drives.get((event.activity, event.object))
        if drive is None:
            yield f"the dependencies speak of {event}, which is not driven"
        elif event.progress > drive.path.length + TOLERANCES.place:
            yield f"the dependencies speak of {event}, whose path has {drive.path.length:g} m"


def needs_of_motions(
    plan: PlanDict, lives: Mapping[str, Life], meetings: Iterable[Meeting]
) -> list[Edge]:
    """Return what the motions ask for, whatever the problem is."""
    found = [step for meeting in meetings for step in steps_of(meeting)]
    for name, life in lives.items():
        turns = dict.fromkeys(
            (item["activity"], "samples" in item or item["activity"] in life.rides)
            for item in in_turn(plan, name, life.rides)
        )
        for (one, _), (two, drives) in itertools.pairwise(turns):
            then = Event(At.START if drives else At.END, two)
            lag = TOLERANCES.strict if drives else 0.0
            found.append(
                Edge(Event(At.END, one), then, lag, "object", f"{one} and {two} both move {name}")
            )
    return found


# ------------------------------------------------------------------ what follows from what


def lacking(
    tasks: Mapping[str, PlannedTask], edges: Iterable[Edge], needs: Sequence[Edge]
) -> list[Edge]:
    """Return the needs that do not follow from ``edges``, with their lags.

    Raises :class:`ProblemError` where the edges have a cycle.
    """
    edges = list(edges)
    direct: dict[tuple[Event, Event], float] = {}
    for edge in edges:
        pair = (edge.first, edge.then)
        direct[pair] = max(edge.lag, direct.get(pair, 0.0))
    ends = [Event(at, name) for name in tasks for at in (At.START, At.END)]
    found = dict.fromkeys([ORIGIN, *ends])
    found.update(dict.fromkeys(e for n in (*edges, *needs) for e in (n.first, n.then)))
    made = tuple(Edge(*pair, lag) for pair, lag in direct.items())
    graph = Graph(tasks, tuple(found), (0.0,) * len(found), made)
    number = graph.number
    rank = {k: place for place, k in enumerate(graph.order)}
    after: dict[int, list[tuple[int, float]]] = {}
    for before, then in graph.implied:
        after.setdefault(before, []).append((then, 0.0))
    for (before, then), edge in zip(graph.pairs, made, strict=True):
        after.setdefault(before, []).append((then, edge.lag))
    later = _later(graph.order, after)
    left: dict[Event, list[Edge]] = {}
    for need in needs:
        follows = need.lag <= TOLERANCES.rounded and later[number[need.first]] >> number[need.then]
        if not follows & 1 and (
            direct.get((need.first, need.then), -1.0) < need.lag - TOLERANCES.rounded
        ):
            left.setdefault(need.first, []).append(need)
    missing: list[Edge] = []
    for first, wanted in left.items():
        latest = {number[first]: 0.0}
        for k in graph.order[rank[number[first]] :]:
            for then, lag in after.get(k, ()) if k in latest else ():
                latest[then] = max(latest.get(then, 0.0), latest[k] + lag)
        never = -math.inf
        missing += [
            n for n in wanted if latest.get(number[n.then], never) < n.lag - TOLERANCES.rounded
        ]
    return missing


def _later(order: Sequence[int], after: Mapping[int, Sequence[tuple[int, float]]]) -> list[int]:
    """Return for each number those that come after it, as the bits of a whole number."""
    found = [0] * len(order)
    for k in reversed(order):
        for then, _ in after.get(k, ()):
            found[k] |= found[then] | 1 << then
    return found


def named(items: Sequence[object], most: int = 12) -> list[str]:
    """Return faults in words, the first ``most`` of them one by one."""
    found = [str(item) for item in items[:most]]
    if len(items) > most:
        found.append(f"... and {len(items) - most} more of the kind")
    return found


# ------------------------------------------------------------------ the file and its problem


def graph_faults(told: Graph, made: Graph) -> list[str]:
    """Return what a file's graph lacks of the one that its problem asks for, and which of its own
    edges the plan itself does not keep.
    """
    fixed = ([e for e in graph.edges if e.fixed] for graph in (told, made))
    lost, every = lacking(told.tasks, *fixed), lacking(told.tasks, told.edges, made.edges)
    found = named(list(dict.fromkeys(map(str, (*lost, *every)))))
    own = {(n.first, n.then): n.lag for n in made.edges}
    broken = [
        need
        for need, (first, then) in zip(told.edges, told.pairs, strict=True)
        if need.lag > own.get((need.first, need.then), -math.inf) + TOLERANCES.rounded
        and told.times[then] < told.times[first] + need.lag - TOLERANCES.late
    ]
    found += named(
        [f"the plan itself does not keep that {n.then} waits for {n.first}" for n in broken]
    )
    return [*found, *_bound_faults(told, made), *_task_faults(told, made)]


def _bound_faults(told: Graph, made: Graph) -> list[str]:
    known: dict[tuple[Event, Event], float] = {}
    for b in told.bounds:
        pair = b.first, b.then
        known[pair] = min(b.most, known.get(pair, math.inf))
    lost = []
    for b in made.bounds:
        if known.get((b.first, b.then), math.inf) > b.most + TOLERANCES.rounded:
            lost.append(
                f"no bound says that {b.then} is at most {b.most:g} s after {b.first} ({b.why})"
            )
    return named(list(dict.fromkeys(lost)))


def _task_faults(told: Graph, made: Graph) -> list[str]:
    found = []
    for name, own in made.tasks.items():
        task = told.tasks[name]
        if set(task.who) != set(own.who):
            who, whom = (", ".join(sorted(w)) or "nobody" for w in (task.who, own.who))
            found.append(
                f"the task '{name}' is done by {who} in the file, by {whom} in the problem"
            )
        if abs(task.expected - own.expected) > TOLERANCES.rounded:
            lasts = f"{task.expected:g} s in the file, {own.expected:g} s in the plan"
            found.append(f"the task '{name}' lasts {lasts}")
    return named(found)


def refuse(faults: Sequence[str], plan: PlanDict) -> None:
    """Raise :class:`ProblemError` that names all faults, if there are any."""
    if faults:
        raise ProblemError(
            f"the plan of '{plan['problem']}' cannot be followed: {'; '.join(faults)}"
        )
