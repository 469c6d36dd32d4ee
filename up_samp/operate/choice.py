"""What is planned anew next: the robot that is free first and the order that is worth most then,
with what it has not begun; or, where nothing waits, two robots whose orders might be shared better.

Small problems are solved in a second. What all others do stays, but not who goes first. This is a
large-neighbourhood search over the day (Shaw 1998; with robots: Li et al., "Anytime multi-agent
path finding via large neighborhood search", IJCAI 2021), one move for each plan.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from up_samp.execution.executor import Executor
from up_samp.execution.state import TaskPhase
from up_samp.fleet.records import FleetRecords, Order
from up_samp.fleet.statements import Kind, Meaning
from up_samp.operate.clock import Clock
from up_samp.operate.horizon import DELIVERS, Cut, Opened
from up_samp.operate.records import DayOrder, OrderState, Pose
from up_samp.operate.settings import Settings

PATIENCE = 2.0
"""An order that could wait for so many times its own length is worth a third of a late one."""


class Day(Protocol):
    """What there is to choose from: an operation, as :class:`up_samp.operate.loop.Operation`."""

    settings: Settings
    clock: Clock
    site: FleetRecords
    executor: Executor | None
    meanings: dict[str, Meaning]
    jobs: dict[str, DayOrder]
    number: int

    def stranded(self) -> list[str]:
        """Return robots that stand where they should not stay."""

    def stale(self) -> list[str]:
        """Return robots that are to do what is cancelled, or was changed."""

    def waiting(self) -> list[DayOrder]:
        """Return the orders that are in no plan."""

    def dropped(self) -> list[DayOrder]:
        """Return orders whose robot has gone before it had them."""

    def free_at(self) -> dict[str, tuple[float, Pose]]:
        """Return in how many seconds each robot will have done its last order, and where."""

    def cut(self, opened: Mapping[str, Opened] | None = None) -> Cut:
        """Return where the plan can be cut."""


@dataclass(frozen=True)
class OpenWork:
    """``opened``: the robots that are planned anew, and what of theirs; ``jobs``: what they do."""

    opened: Mapping[str, Opened]
    jobs: tuple[DayOrder, ...] = ()


def choose(day: Day) -> OpenWork | None:
    """Return what to plan next; None: nothing is left to plan."""
    stranded = day.stranded()[:2]
    if stranded:
        opened = dict.fromkeys(stranded, Opened.ALL)
        return OpenWork(opened, tuple(_theirs(day, opened)))
    stale = day.stale()[:2]
    if stale:
        opened = dict.fromkeys(stale, Opened.ALL)
        return OpenWork(opened, tuple(_theirs(day, opened)))
    waiting = [j for j in (*day.waiting(), *day.dropped()) if _ready(day, j)]
    if waiting and day.settings.commit == "begun":
        return _dispatched(day, waiting)
    if waiting:
        return _for_order(day, min(waiting, key=urgency))
    return _shared_anew(day)


def _dispatched(day: Day, waiting: Sequence[DayOrder]) -> OpenWork | None:
    """Return the order that is worth most for who is free first, and who could be there first;
    None: nobody is free soon.

    What else waits may be given to anybody later on. Which order is next is told by its apparent
    tardiness cost (Vepsalainen & Morton, "Priority rules for job shops with weighted tardiness
    costs", 1987): what a second of a robot's time is worth for it.
    """
    free = {r: f for r, f in day.free_at().items() if f[0] <= day.settings.soon}
    for robot in sorted(free, key=lambda r: (free[r][0], r)):
        left = [j for j in waiting if _able(day, j, robot)]
        if not left:
            continue
        job = max(left, key=lambda j: _worth(day, j, robot, *free[robot]))
        opened = {_first_there(day, job, free): Opened.ALL}
        jobs = (job, *_theirs(day, opened))
        if len(jobs) <= day.settings.most:
            return OpenWork(opened, jobs)
        return OpenWork(dict.fromkeys(opened, Opened.TAIL), (job,))
    return None


def _first_there(day: Day, job: DayOrder, free: Mapping[str, tuple[float, Pose]]) -> str:
    able = (r for r in free if _able(day, job, r))
    return min(able, key=lambda r: (_there(day, job, r, *free[r]), r))


def _worth(
    day: Day, job: DayOrder, robot: str, when: float, pose: Pose
) -> tuple[float, float, float]:
    """Return a key of which order a robot should do next: the greatest one."""
    record = job.record
    lasts = max(1.0, _there(day, job, robot, 0.0, pose) + _handling(day, job, robot))
    due = math.inf if record.due is None else record.due
    slack = max(0.0, due - day.clock.now() - when - lasts)
    return record.priority, record.weight / lasts * math.exp(-slack / (PATIENCE * lasts)), -job.came


def _handling(day: Day, job: DayOrder, robot: str) -> float:
    """Return how long (s) a robot has to do with a job once it is there, on straight lines."""
    record = job.record
    if not isinstance(record, Order):
        return record.duration or 0.0
    speed = day.site.robot_types[day.site.robots[robot].type].v_max
    ends = ([day.site.places[p].pose[:2] for p in s.at] for s in (record.pickup, record.delivery))
    way = min(math.dist(one, two) for one, two in itertools.product(*ends))
    return record.pickup.service + way / speed + record.delivery.service


def urgency(job: DayOrder) -> tuple[float, float, float]:
    """Return a key: orders of higher priority first, then those due first, then by coming."""
    due = job.record.due
    return -job.record.priority, math.inf if due is None else due, job.came


def _ready(day: Day, job: DayOrder) -> bool:
    """Return whether what comes before an order is in the plan, or over."""
    before = (day.jobs.get(name) for name in job.record.after)
    return all(b is None or b.state is not OrderState.WAITING for b in before)


def _for_order(day: Day, job: DayOrder) -> OpenWork | None:
    free = day.free_at()
    if day.settings.commit == "none":
        everybody = dict.fromkeys(free, Opened.ALL)
        return OpenWork(everybody, (job, *_theirs(day, everybody)))
    free = {r: f for r, f in free.items() if f[0] <= day.settings.soon}
    if not any(_able(day, job, r) for r in free):
        return None
    return OpenWork({_first_there(day, job, free): Opened.TAIL}, (job,))


def _able(day: Day, job: DayOrder, robot: str) -> bool:
    record, mine = job.record, day.site.robots[robot]
    named = not record.robots or robot in record.robots
    load = record.load if isinstance(record, Order) else {}
    room = day.site.robot_types[mine.type].capacity
    fits = all(room.get(kind, 0) >= n for kind, n in load.items())
    return named and fits and set(record.skills) <= set(mine.skills)


def _there(day: Day, job: DayOrder, robot: str, when: float, pose: Pose) -> float:
    """Return when a robot could be at an order's pickup, on straight lines."""
    record = job.record
    at = (record.pickup if isinstance(record, Order) else record).at
    speed = day.site.robot_types[day.site.robots[robot].type].v_max
    spots = (day.site.places[p].pose for p in at)
    return when + min(math.dist(pose[:2], spot[:2]) for spot in spots) / speed


def _theirs(day: Day, robots: Mapping[str, Opened]) -> Sequence[DayOrder]:
    """Return the orders of some robots that are in the plan and that nobody is on the way to."""
    if day.executor is None:
        return ()
    kept = set(day.cut(opened=robots).jobs)
    found = dict.fromkeys(
        m.what
        for n, m in day.meanings.items()
        if m.robot in robots
        and m.kind in DELIVERS
        and day.executor.phase(n) is TaskPhase.WAITING
        and m.what not in kept
    )
    jobs = (day.jobs[n] for n in found if n in day.jobs)
    return [j for j in jobs if j.state is OrderState.PLANNED]


def _shared_anew(day: Day) -> OpenWork | None:
    """Return two robots whose orders could be shared anew."""
    planned = {
        m.robot
        for m in day.meanings.values()
        if m.kind is Kind.PICKUP
        and m.what in day.jobs
        and day.jobs[m.what].state is OrderState.PLANNED
    }
    free = [r for r in day.free_at() if r not in planned]
    if day.settings.commit != "begun" or not planned:
        return None
    rng = random.Random(f"{day.settings.seed} {day.number}")
    one = rng.choice(sorted(planned))
    other = rng.choice(sorted({*planned, *free} - {one}) or [one])
    opened = dict.fromkeys((one, other), Opened.ALL)
    jobs = _theirs(day, opened)
    return OpenWork(opened, tuple(jobs)) if 0 < len(jobs) <= day.settings.most else None
