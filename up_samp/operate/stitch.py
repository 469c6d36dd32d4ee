"""One plan of two: what stays of the old one, and then the new one.

The new plan begins where everybody stands once what is kept is done, so it is put behind all of it;
then who goes first where paths meet is decided again, which gives everything its times. The graph
of both holds what the old one says of what is kept, what the new problem asks for, and that what is
kept comes first of all that shares a robot, a resource, or is to come after it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from up_samp.execution.build import Dependencies, Draft, tasks_of
from up_samp.execution.executor import Executor
from up_samp.execution.files import edge_from_dict, graph_to_dict
from up_samp.execution.graph import MEETING, ORIGIN, ZONE, At, Edge, Event
from up_samp.execution.lives import DriveCells, drives_of, errors_of, lives_of
from up_samp.execution.meetings import Key, Meeting, meetings_of
from up_samp.execution.reorder import Goal, propose, settle
from up_samp.execution.state import Forecast, MotionUnderWay, TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.fleet.meanings import Meaning
from up_samp.fleet.records import FleetRecords, Order, Task, visited
from up_samp.io.plan_dict import PlanDict, with_minor
from up_samp.model import ProblemError
from up_samp.motion.fleet.paths import ROUNDED
from up_samp.operate.horizon import DELIVERS, Cut, driven_before, meanings_of
from up_samp.operate.records import Pose, Settings, Shape
from up_samp.operate.zones import keep_zones

BUSY = "busy:"
"""Tasks of this prefix, which no order can have, stand for what robots still do of the plan before.
"""


@dataclass(frozen=True)
class Kept:
    """What stays of a plan, on the clock of the cut: activities, motions and changes as in plan
    files, and edges.
    """

    objects: tuple[dict[str, Any], ...] = ()
    activities: tuple[dict[str, Any], ...] = ()
    motions: tuple[dict[str, Any], ...] = ()
    changes: tuple[dict[str, Any], ...] = ()
    edges: tuple[Edge, ...] = ()
    expected: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, Pose] = field(default_factory=dict)
    meanings: Mapping[str, Meaning] = field(default_factory=dict)

    @property
    def until(self) -> int:
        """When all of it is over (units)."""
        return math.ceil(max((a["end"] for a in self.activities), default=0))


@dataclass(frozen=True)
class Question:
    """What is asked of the planner: the site, where the old plan is cut and what is kept of it, the
    orders and tasks to plan (``due`` from the cut on), the robots to do them (all others stay where
    they are then), areas that nobody may enter, and how the day is operated.
    """

    number: int
    site: FleetRecords
    folder: Path
    cut: Cut
    kept: Kept
    jobs: tuple[Order | Task, ...]
    robots: tuple[str, ...]
    mark: str = ""
    """What no other plan has, on no other day either: its activities are called by it."""
    beside: tuple[str, ...] = ()
    """Those of them that may go to rest at another place, to be out of the way."""
    held: tuple[tuple[str, Order], ...] = ()
    """Robots and the orders that they still have once all that is kept is done."""
    on_board: Mapping[str, str] = field(default_factory=dict)
    """The orders that are on board now, and of whom."""
    areas: Mapping[str, Shape] = field(default_factory=dict)
    shut: frozenset[str] = frozenset()
    """Doors through which nobody drives, and that nobody opens."""
    levels: Mapping[str, float] = field(default_factory=dict)
    """Of batteries from the cut on, in the user's units."""
    kept_jobs: tuple[Order | Task, ...] = ()
    settings: Settings = Settings()
    computing: bool = False
    """Whether ``seconds`` are those for which the planner computes, not those of the clock."""

    @property
    def seconds(self) -> float:
        """How long (s) a plan may be sought."""
        return self.settings.budget * (self.settings.stretch if self.computing else 1.0)

    @property
    def to_do(self) -> tuple[Order | Task, ...]:
        """The orders and tasks that the new plan is to end."""
        return *self.jobs, *(order for _, order in self.held)


def kept_of(executor: Executor, cut: Cut) -> Kept:
    """Return what stays of an executor's plan."""
    plan, state = executor.plan, executor.state
    names = set(cut.kept)
    entries = [a for a in plan["activities"] if a["name"] in names]
    first = min((a["start"] for a in entries), default=0)
    by = first * float(plan["seconds_per_unit"])
    activities = [{**a, "start": a["start"] - first, "end": a["end"] - first} for a in entries]
    motions = [_later(cut.part_of(m), -by) for m in plan["motions"] if m["activity"] in names]
    changes = [
        {**c, "time": round(c["time"] - by, 6)}
        for c in plan["changes"]
        if c["activity"] in names and c["activity"] not in cut.stops
    ]
    return Kept(
        tuple(plan["objects"]),
        tuple(activities),
        tuple(motions),
        tuple(changes),
        tuple(_edges(executor, cut)),
        {n: state.graph.tasks[n].expected for n in names},
        _initial(executor, cut, motions),
        {n: m for n, m in meanings_of(plan).items() if n in names},
    )


def _later(motion: Mapping[str, Any], by: float) -> dict[str, Any]:
    return {**motion, "samples": [[round(r[0] + by, 9), *r[1:]] for r in motion["samples"]]}


def whole_motion(motion: Mapping[str, Any]) -> dict[str, Any]:
    """Return a motion of a plan with progress from where its robot began it."""
    return {**motion, "progress": [p + driven_before(motion) for p in motion["progress"]]}


def _edges(executor: Executor, cut: Cut) -> Iterator[Edge]:
    """Yield what the old graph says of what is kept, beside who lets whom pass, or into a zone."""
    names = {*cut.kept, ORIGIN.activity}
    for edge in executor.state.graph.edges:
        ends = edge.first, edge.then
        if edge.kind in (MEETING, ZONE) or not {e.activity for e in ends} <= names:
            continue
        first, then = map(cut.on_part, ends)
        if first is not None and then is not None:
            lag = edge.lag - cut.since if first == ORIGIN else edge.lag
            yield Edge(first, then, lag, edge.kind, edge.why)


def _initial(executor: Executor, cut: Cut, motions: list[dict[str, Any]]) -> dict[str, Pose]:
    """Return where everything is before what is kept: where the first motion of it begins, or
    where it stays.
    """
    moved = {c["object"] for c in executor.plan["changes"] if c["activity"] in cut.kept}
    now = {o["name"]: tuple(o["initial"]) for o in executor.plan["objects"]}
    for change in sorted(executor.plan["changes"], key=lambda c: c["time"]):
        over = Event(At.END, change["activity"]) in executor.state.fired
        if over and change["object"] in moved:
            now[change["object"]] = tuple(change["configuration"])
    found = {n: now[n] if n in moved else cut.poses.get(n, now[n]) for n in now}
    for motion in sorted(motions, key=lambda m: -m["samples"][0][0]):
        found[motion["object"]] = tuple(motion["samples"][0][1:])
    return found


def stitched(ask: Question, new: PlanDict, meanings: Mapping[str, Meaning]) -> PlanDict:
    """Return one plan, in order, with its dependencies: of what is kept, and of a ``new`` one.
    ``meanings`` are those of the new plan's activities, which get ``#mark`` behind their names.

    Raises :class:`ProblemError` where nobody could follow it.
    """
    kept, said = ask.kept, new["dependencies"]
    names = {
        a["name"]: f"{a['name']}#{ask.mark}"
        for a in new["activities"]
        if not meanings[a["name"]].what.startswith(BUSY)
    }
    plan = _behind(kept, new, names, ask.site)
    known = {**kept.meanings, **{n: meanings[old] for old, n in names.items()}}
    plan["meanings"] = {n: [m.kind.value, m.what, m.robot] for n, m in known.items()}
    tasks = (t for t in said["tasks"] if t["activity"] in names)
    expected = {**kept.expected, **{names[t["activity"]]: float(t["expected"]) for t in tasks}}
    needs = [*kept.edges, *_renamed(map(edge_from_dict, said["edges"]), names)]
    for one, two in _after(ask, names.values(), known):
        first, then, why = Event(At.END, one), Event(At.START, two), f"{one} was there before"
        needs.append(Edge(first, then, TOLERANCES.strict, "object", why))
    goals = goals_of(known, (*ask.kept_jobs, *ask.to_do))
    open_ = _dependencies(ask, plan, said, needs, expected, ask.settings.lead)
    told = ask.settings.lead, ask.settings.ahead, ask.cut.gone
    plan = ordered(plan, open_, goals, ask.cut.begun, *told)
    last = _dependencies(ask, plan, said, needs, expected)
    plan["dependencies"] = {
        **graph_to_dict(last.graph),
        "localisation": last.localisation,
        "narrow": said.get("narrow", []),
    }
    return with_minor(plan) | {"on_board": dict(ask.on_board)}


def _behind(kept: Kept, new: PlanDict, names: Mapping[str, str], site: FleetRecords) -> PlanDict:
    """Return one plan, without meanings and dependencies, of what is kept and of a new one behind
    it; ``names``: what the new one's activities are called in it, those that are part of it.
    """
    unit, by = float(new["seconds_per_unit"]), kept.until
    # what was proven of the new problem was not proven of what comes before and after, too
    own = ("dependencies", "minor", "status", "lower_bound", "bound_kind")
    plan = {k: v for k, v in new.items() if k not in own}
    plan |= {"status": "SOLVED_SATISFICING", "lower_bound": None}
    # areas, and leaves that nobody moves, are there as long as the new problem has them
    left = {*site.robots, *site.doors} - {o["name"] for o in new["objects"]}
    plan["objects"] = [
        {**o, "initial": list(kept.initial.get(o["name"], o["initial"]))}
        for o in (*new["objects"], *(o for o in kept.objects if o["name"] in left))
    ]
    plan["activities"] = [
        *kept.activities,
        *(
            {**a, "name": names[a["name"]], "start": a["start"] + by, "end": a["end"] + by}
            for a in new["activities"]
            if a["name"] in names
        ),
    ]
    # the new problem has doors open that are still to be opened, and what is kept may be of a time
    # when nobody was to move a door: all heed them
    doors = {c["object"] for c in (*kept.changes, *new["changes"])}
    moved = (_later({**m, "activity": names[m["activity"]]}, by * unit) for m in new["motions"])
    plan["motions"] = [
        {**m, "avoid": sorted({*m["avoid"], *doors})} for m in (*kept.motions, *moved)
    ]
    plan["changes"] = [
        *kept.changes,
        *(
            {**c, "activity": names[c["activity"]], "time": round(c["time"] + by * unit, 6)}
            for c in new["changes"]
        ),
    ]
    plan["motions"].sort(key=lambda m: m["samples"][0][0])
    plan["makespan"] = max((a["end"] for a in plan["activities"]), default=0)
    return plan


def _renamed(edges: Iterable[Edge], names: Mapping[str, str]) -> Iterator[Edge]:
    """Yield what edges say of activities that are called otherwise in the whole plan."""
    for edge in edges:
        ends = edge.first, edge.then
        if edge.kind != MEETING and {e.activity for e in ends} <= {"", *names}:
            first, then = (replace(e, activity=names.get(e.activity, "")) for e in ends)
            yield replace(edge, first=first, then=then)


def _dependencies(
    ask: Question,
    plan: PlanDict,
    said: Mapping[str, Any],
    needs: Iterable[Edge],
    expected: Mapping[str, float],
    lead: float = 0.0,
) -> Dependencies:
    """Return what depends on what, beside what is needed anyhow. ``said``: the new plan's own
    dependencies; ``expected``: how long (s) activities last; ``lead``: nothing new begins within so
    many seconds, and where what is kept cannot go first everywhere, it is left open who does.
    """
    lives = lives_of(plan)
    fresh = [name for name in plan["meanings"] if name not in ask.kept.meanings]
    who = {n: ((robot,) if robot else ()) for n, (_, _, robot) in plan["meanings"].items()}
    tasks = tasks_of(plan, who, expected)
    margin, error = float(said["margin"]), float(said.get("localisation", 0.0))
    # once it has its times these say who goes first everywhere
    meetings = tuple(meetings_of(lives, margin, error, leaving=fresh if lead else ()))
    sides: dict[Key, bool] = {}
    for meeting in meetings:
        sides |= meeting.untimed

    def told(met: Iterable[Meeting]) -> Dependencies:
        draft = Draft(tasks, lives)
        for need in needs:
            draft.put(need)
        for name in fresh if lead else ():
            begin, why = Event(At.START, name), "it is planned until then"
            draft.put(Edge(ORIGIN, begin, lead, "constraint", why))
        for meeting in met:
            draft.add_meeting(meeting, sides)
        choices = keep_zones(draft, lives, ask.site, errors_of(lives, error))
        graph = draft.graph(margin)
        return Dependencies(graph, lives, meetings, choices, error, sides=sides)

    try:
        return told(meetings)
    except ProblemError:
        if not lead:
            raise
        crossed = {k for m in meetings if not m.activities.isdisjoint(fresh) for k in m.keys}
        return replace(told(()), undecided=frozenset(crossed - sides.keys()))


def _after(
    ask: Question, new: Collection[str], known: Mapping[str, Meaning]
) -> Iterator[tuple[str, str]]:
    """Yield which new activities come after which kept ones: the robot's own; who uses a resource
    that was used; and what is to come after an order that is under way.
    """
    kept = [a["name"] for a in ask.kept.activities]
    yield from (
        (one, two)
        for one, two in itertools.product(kept, new)
        if known[one].robot and known[two].robot == known[one].robot
    )
    before, after = {j.id: j for j in ask.kept_jobs}, {j.id: j for j in ask.to_do}
    for one, two in itertools.product(ask.kept.meanings, new):
        job, later = before.get(known[one].what), after.get(known[two].what)
        if job and later and (job.id in later.after or _resources(job) & _resources(later)):
            yield one, two


def _resources(job: Order | Task) -> set[str]:
    return {r for stop in visited(job) for r in stop.resources}


# ------------------ From one plan to the next


def follow_on(executor: Executor, old: Executor, cut: Cut, by: float) -> None:
    """Let the executor of a new plan go on where an ``old`` one is, whose clock began ``by`` s
    earlier.

    Raises :class:`ProblemError` where something has begun meanwhile that the plan does not keep,
    or a robot is beyond where it would have to wait.
    """
    kept, spans = set(cut.kept), old.times()
    done: list[str] = []
    under_way: dict[str, dict[str, float]] = {}
    times: dict[str, tuple[float, float | None]] = {}
    for name, phase in old.state.phase.items():
        if phase is TaskPhase.WAITING:
            continue
        if name not in kept:
            if name not in cut.begun:
                raise ProblemError(f"'{name}' has begun meanwhile")
            continue
        start, end = spans[name]
        times[name] = start - by, None if end is None else end - by
        if phase is TaskPhase.DONE:
            done.append(name)
        else:
            gone = cut.starts.get(name, 0.0)
            under_way[name] = {w.object: w.told - gone for w in old.state.ways_of[name]}
    executor.join(max(0.0, old.now - by), done=done, under_way=under_way, times=times)
    executor.state.pace.load(old.state.pace.saved())
    for robot, where in old.state.strayed.items():  # others still keep away from there
        executor.update(robot, pose=where.pose, now=max(0.0, old.now - by))
    least: dict[str, float] = {}
    for robot, way in executor.state.of_object.items():
        before = old.state.of_object[robot]
        executor.state.heard[robot], way.since = old.state.heard[robot] - by, before.since - by
        gone = cut.starts.get(way.activity, 0.0)
        # it goes on to where it was told that it may, or where it can stand
        least[robot] = old.state.committed(before) - gone
        way.let = max(0.0, before.let - gone)
        if (most := old.state.limits.get(way.activity)) is not None:
            executor.state.limits[way.activity] = most - gone
        _move_gates(executor, old, cut, way, least[robot])
    executor.state.follow_all()
    executor.bar()  # who seemed to be beyond a gate may not be
    for robot, way in executor.state.of_object.items():
        beyond = least[robot] - executor.state.until(way)
        if beyond > old.state.tolerance:
            raise ProblemError(f"'{robot}' is {beyond:.2f} m beyond where it would have to wait")


def _move_gates(
    executor: Executor, old: Executor, cut: Cut, way: MotionUnderWay, least: float
) -> None:
    """Let a motion under way come to ``least`` m, to where the old plan lets it drive whatever
    comes, before it waits at gates that only let those go first whom the old plan lets go first
    there, too.

    Both plans cut the paths anew and join what is near, so that their gates for one meeting may be
    a few cells apart; how far the two may drive by the old one's has been safe all along. Where the
    new plan turns round who goes first, its gate stays where it is.
    """
    state = executor.state
    while (gate := state.next_gate(way)) is not None and gate[0] < least:
        at, number = gate
        events, when = state.graph.events, state.when
        there = cut.on_whole(events[number])
        firsts = [cut.on_whole(edge.first) for k, edge in state.into[number] if when[k] is None]
        if not firsts or not all(_lets_first(old, first, there) for first in firsts):
            return
        state.move_gate(number, least - at)


def _lets_first(old: Executor, first: Event, then: Event) -> bool:
    """Return whether an old plan has a motion wait near where ``then`` is for what is near where
    ``first`` is on another one: as near as its body is large.
    """
    state, near = old.state, old.drives[then.activity, then.object].path.radius
    return any(
        abs(edge.first.progress - first.progress) <= near
        for at, number in state.of_object[then.object].gates
        if abs(at - then.progress) <= near
        for _, edge in state.into[number]
        if edge.kind == MEETING
        if edge.first.activity == first.activity
    )


# ------------------ A plan of two, put in order


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
        executor = Executor(plan, dependencies=told, ahead=ahead)
        here = {n: s for n, s in begun.items() if n in told.graph.tasks}
        ways = executor.state.ways_of
        executor.join(
            0.0,
            under_way={n: {w.object: gone.get(n, 0.0) for w in ways[n]} for n in here},
            times={n: (-s, None) for n, s in here.items()},
        )
        return executor

    executor = under_way(told, gone)
    executor.goals, executor.lead, executor.horizon = goals, lead, math.inf
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
    known = drive.planned[1]
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
