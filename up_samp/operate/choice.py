"""What is planned anew next: the most urgent order, by the robot that is free soon and could be
there first, with what it has not begun; or, where nothing waits, two robots whose orders might be
shared better.

Small problems are solved in a second. What all others do stays, but not who goes first. This is a
large-neighbourhood search over the day (Shaw 1998; with robots: Li et al., "Anytime multi-agent
path finding via large neighborhood search", IJCAI 2021), one move for each plan.
"""

from __future__ import annotations

import itertools
import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from shapely.geometry import Polygon

from up_samp.execution.executor import Executor
from up_samp.execution.state import TaskPhase
from up_samp.fleet.meanings import Kind, Meaning
from up_samp.fleet.outlines import placed
from up_samp.fleet.records import FleetRecords, Order, Resource, Stop, Task, can_do, visited
from up_samp.model import ProblemError
from up_samp.operate.clock import Clock
from up_samp.operate.horizon import DELIVERS, Cut, Cutter, Opened, on_board
from up_samp.operate.records import DayOrder, OrderState, Pose, Settings, Shape

ASIDE = 30.0
"""Seconds for which is put aside what no plan was found for, at first."""
PATIENCE = 60.0
"""Seconds: an order of e times the weight is as urgent as one that is due so much sooner; one that
says no due time is as if it was due ten times so long after it came.
"""


OUT, BACK = "out of order", "closed"
"""What is said of doors."""


class Day:
    """What there is to choose from: the state of an operation, and what follows from it now."""

    settings: Settings
    clock: Clock
    site: FleetRecords
    executor: Executor
    """Of the plan that is driven: at first of one in which everybody stands."""
    origin: float = 0.0
    """When the executor's clock began (s of the day)."""
    number: int = 0
    """The plan's."""
    meanings: dict[str, Meaning]
    jobs: dict[str, DayOrder]
    poses: dict[str, Pose]
    away: dict[str, str]
    """Robots that do nothing now, and why."""
    using: dict[str, tuple[str, ...]]
    """What resources robots use that do nothing now, as they left in the middle of something."""
    placed: dict[str, str]
    """Robots that stand where the plan does not have them, and why they stay until one does."""
    areas: dict[str, Shape]
    """Areas that nobody may enter now."""
    shut: dict[str, str]
    """Doors that are ``OUT`` of order, or were (``BACK``) and stand closed, by what nobody is to
    drive through them of the plan.
    """
    aside: dict[str, float]
    """Until when (s of the day) orders and robots are put aside that no plan was found for."""
    again: float = 0.0
    """When (s of the day) those may be tried again, where there is nothing else."""
    cramped: set[str]
    """Robots that are planned anew from where they stand in nobody's way: no order was found of all
    in which others let them go first from where they could stand sooner.
    """
    tried: dict[tuple[str, str], int]
    """How often no plan was found for an order (by name) and a robot that was to do it."""

    def put_aside(self, orders: Sequence[str], robots: Sequence[str]) -> None:
        """Put aside, for longer each time, what no plan was found for: there may be none for long,
        and others are not to wait for that.
        """
        now = self.clock.now()
        for pair in itertools.product(orders or [""], robots):
            self.tried[pair] = self.tried.get(pair, 0) + 1
        self.aside = {name: until for name, until in self.aside.items() if until > now}
        for name in (*orders, *robots):
            count = sum(n for pair, n in self.tried.items() if name in pair)
            self.aside[name] = now + ASIDE * 2.0 ** min(count - 1, 4)

    def turns(self) -> tuple[float, ...]:
        """Return until when (s of the day) what is planned now may have been put aside: first what
        is not, and then, once it is time for that, anything.
        """
        now = self.clock.now()
        return (now, math.inf) if now >= self.again else (now,)

    def error(self, robot: str) -> float:
        """Return how far (m) from where it tells to be a robot may be."""
        return self.site.senses(robot).get("localisation", self.settings.localisation)

    def _home(self, place: str) -> Pose:
        return self.site.places[place].pose

    def _is_done(self, name: str) -> bool:
        return self.executor.phase(name) is TaskPhase.DONE

    def waiting(self) -> list[DayOrder]:
        """Return the orders that are in no plan."""
        return [j for j in self.jobs.values() if j.state is OrderState.WAITING]

    def unfinished(self, names: Iterable[str]) -> set[str]:
        """Return which of some orders are still to be done, those that are still to come, too."""
        return {n for n in names if n not in self.jobs or self.jobs[n].state.open}

    def sure(self) -> set[str]:
        """Return the orders that the plan brings to their ends, as things are."""
        cut = self.cut()
        return {*cut.jobs} - cut.carrying.keys()

    def off_plan(self) -> frozenset[str]:
        """Return the robots that do nothing of what the plan says, and stand at their poses."""
        return frozenset((*self.away, *self.placed))

    def adrift(self) -> list[str]:
        """Return the robots that do nothing any more, and of which nobody knows yet where they will
        stand: they may drive on to where they were let. By the plan that is driven others wait.
        """
        state = self.executor.state
        some = (w for r, w in state.of_object.items() if r in self.away.keys() - self.placed.keys())
        return [w.object for w in some if not state.stands(w)]

    def left_opening(self) -> dict[str, str]:
        """Return the doors that robots were opening which do nothing any more, by activity: they
        may open nevertheless, and nobody knows how they stand (but of those said to be closed).
        """
        return {
            name: meaning.what
            for name, meaning in self.meanings.items()
            if meaning.kind is Kind.OPEN
            and meaning.robot in self.away
            and self.executor.phase(name) is TaskPhase.RUNNING
            and self.shut.get(meaning.what) != BACK
        }

    def unused(self) -> dict[str, Resource]:
        """Return the site's resources without what robots use of them that do nothing now."""
        using = Counter(itertools.chain.from_iterable(self.using.values()))
        some = self.site.resources.items()
        return {n: replace(r, capacity=r.capacity - using[n]) for n, r in some}

    def there(self) -> list[str]:
        """Return the robots that do their work."""
        return [r for r in self.site.robots if r not in self.away]

    def stranded(self) -> list[str]:
        """Return robots that have nothing to do, and stand where they should not stay: not where
        they end, or with an order. Who cannot bring that to its end now waits.
        """
        if not self.meanings:
            return []  # nobody has been told to go anywhere
        cut = self.cut()
        busy = self.busy(cut)
        ends = {r: visited(self.jobs[o].record)[-1] for o, r in cut.carrying.items()}
        found = []
        for name in self.there():
            end = self.site.robots[name].end
            home = end is None or math.dist(cut.poses[name][:2], self._home(end)[:2]) < 0.01
            wanted = _can_stop(self, ends[name]) if name in ends else not home
            if name not in busy and wanted:
                found.append(name)
        return found

    def busy(self, cut: Cut) -> set[str]:
        """Return the robots that are still to do something of what a cut keeps."""
        left = (n for n in cut.kept if n not in cut.stops and not self._is_done(n))
        return {self.meanings[n].robot for n in left}

    def over(self) -> dict[str, str]:
        """Return what is not to begin any more of what the plan says, and why: its order was
        cancelled, or changed.
        """
        found = {}
        reasons = {OrderState.CANCELLED: "is cancelled", OrderState.WAITING: "was changed"}
        for name, meaning in self.meanings.items():
            if self.executor.phase(name) is not TaskPhase.WAITING:
                continue
            job = self.jobs.get(meaning.what)
            if job is not None and job.state in reasons:
                found[name] = f"order '{job.id}' {reasons[job.state]}"
            elif meaning.kind is Kind.OPEN and self.shut.get(meaning.what) == OUT:
                found[name] = f"door '{meaning.what}' is {OUT}"
        return found

    def stale(self) -> list[str]:
        """Return robots that were still to do what is cancelled, or was changed."""
        found = dict.fromkeys(self.meanings[name].robot for name in self.over())
        return [r for r in found if r not in self.away]

    def free_at(self) -> dict[str, tuple[float, Pose]]:
        """Return in how many seconds each robot will have done its last order, and where; without
        those that still have one then, as they cannot bring it to its end.
        """
        there = self.there()
        cut = self.cut(opened=dict.fromkeys(there, Opened.TAIL))
        loaded = {*cut.carrying.values()}
        return {r: (cut.free.get(r, 0.0), cut.poses[r]) for r in there if r not in loaded}

    def cut(self, opened: Mapping[str, Opened] | None = None) -> Cut:
        """Return where the plan can be cut now, so that there is time to plan; ``opened``: the
        robots that are planned anew (None: nobody).
        """
        now = self.clock.now()
        cutter = Cutter(
            self.executor,
            broken={r: self.poses[r] for r in self.off_plan()},
            limits=self._limits(),
            opened=opened or {},
            cramped=self.cramped,
            opening=self.left_opening(),
        )
        found = cutter.cut(self.settings.lead)
        closed = {n: self.site.doors[n].closed for n, s in self.shut.items() if s == BACK}
        return replace(found, since=now - self.origin, poses={**found.poses, **closed})

    def on_board(self) -> dict[str, str]:
        """Return which orders are on board now, and of whom."""
        return on_board(self.executor, self.meanings, [*filter(self._is_done, self.meanings)])

    def _limits(self) -> Mapping[str, float]:
        """Return how far (m) motions may go: up to areas that are blocked, and to robots that stand
        where no plan has them.
        """
        found = dict(self.executor.state.limits)
        if self.executor.state.strayed.keys() & self.off_plan():
            for (name, _), most in self.executor.state.bars.items():
                found[name] = min(most, found.get(name, most))
        return found

    def hindered(self) -> list[DayOrder]:
        """Return the orders that are planned and not begun, and that cannot be brought to their
        ends now: a robot that does nothing stands there, or an area is blocked.
        """
        planned = (j for j in self.jobs.values() if j.state is OrderState.PLANNED)
        return [j for j in planned if not all(_can_stop(self, s) for s in visited(j.record))]

    def dropped(self) -> list[DayOrder]:
        """Return orders that were in a plan, that nobody has on board and that nobody will do any
        more: their robots do nothing now, or did so for a while.
        """
        found = {m.what for m in self.meanings.values() if m.robot not in self.off_plan()}
        found |= self.on_board().keys()
        planned = (OrderState.PLANNED, OrderState.BEGUN)
        return [j for j in self.jobs.values() if j.state in planned and j.id not in found]


@dataclass(frozen=True)
class OpenWork:
    """``opened``: the robots that are planned anew, and what of theirs; ``jobs``: what they do.
    ``beside``: those of them that may go to rest somewhere else, to be out of the way.
    """

    opened: Mapping[str, Opened]
    jobs: tuple[DayOrder, ...] = ()
    beside: tuple[str, ...] = ()


def choose(day: Day) -> OpenWork | None:
    """Return what to plan next; None: nothing is left to plan. What no plan was found for a moment
    ago is put aside while there is anything else.
    """
    now, stuck = day.clock.now(), day.stranded() or day.stale()
    open_ = (j for j in (*day.waiting(), *day.dropped()) if not too_late(day, j))
    waiting = [j for j in open_ if ready(day, j)]
    for until in day.turns():
        if robots := _stuck(day, stuck, until):
            in_vain = max(day.tried.get(("", r), 0) for r in robots)
            beside = tuple(_beside(day, robots, _bound_for(day, robots), in_vain))
            opened = dict.fromkeys((*robots, *beside), Opened.ALL)
            # what was sought twice in vain is not to keep a robot where it stands
            jobs = (j for j in theirs(day, opened) if _tries(day, j, robots) < 2)
            return OpenWork(opened, tuple(jobs), beside)
        some = [j for j in waiting if day.aside.get(j.id, now) <= until]
        if found := _dispatched(day, some):
            return found
    return None if waiting else _shared_anew(day)


def _stuck(day: Day, robots: Sequence[str], until: float) -> list[str]:
    """Return who is planned next of robots that have to go on, and are put aside no longer than
    ``until``: two, and where no plan was found for two each alone, without delay, the last first.
    Where there is none for the one, or no time for both, the other may clear the way.
    """
    now, tried = day.clock.now(), {r: day.tried.get(("", r), 0) for r in robots}
    some = [r for r in robots if day.aside.get(r, now) <= until or tried[r] == 1][:2]
    return some[-1:] if any(tried[r] % 2 for r in some) else some


def _bound_for(day: Day, robots: Iterable[str]) -> list[str]:
    """Return where robots go that have nothing to do: with what they carry, and home."""
    carried = (day.jobs[o].record for o, r in day.cut().carrying.items() if r in robots)
    places = itertools.chain.from_iterable(visited(order)[-1].at for order in carried)
    return [*places, *filter(None, (day.site.robots[r].end for r in robots))]


def _tries(day: Day, job: DayOrder, robots: Iterable[str]) -> int:
    """Return how often no plan was found for an order that one of some robots was to do."""
    return max((day.tried.get((job.id, r), 0) for r in robots), default=0)


def _dispatched(day: Day, waiting: Sequence[DayOrder]) -> OpenWork | None:
    """Return the most urgent order that who is free first may do, and who could be there first;
    None: nobody is free soon.

    What else waits may be given to anybody later on. The most urgent order is next.
    """
    free = {r: f for r, f in day.free_at().items() if f[0] <= day.settings.soon}
    for robot in sorted(free, key=lambda r: (free[r][0], r)):
        left = [j for j in waiting if may_do(day, j, robot, *free[robot])]
        if not left:
            continue
        job = max(left, key=_urgency)
        first = first_there(day, job, free)
        ends = [place for stop in visited(job.record) for place in stop.at]
        beside = tuple(_beside(day, [first], ends, _tries(day, job, day.site.robots)))
        opened = dict.fromkeys((first, *beside), Opened.ALL)
        jobs = tuple({j.id: j for j in (job, *theirs(day, opened))}.values())
        if len(jobs) <= day.settings.most:
            return OpenWork(opened, jobs, beside)
        return OpenWork(dict.fromkeys(opened, Opened.TAIL), (job,), beside)
    return None


def _beside(day: Day, robots: Sequence[str], places: Sequence[str], in_vain: int) -> Iterator[str]:
    """Yield who has nothing to do soon and is planned with some robots that go to some places: who
    stands at one of these for good, by the plan, or so near that they could not, and for each time
    that no plan was found one more, the nearest first: they may do it themselves, or go out of the
    way. After as many as orders are planned at a time it begins with nobody again: there is less
    time for each of many.
    """
    in_vain %= day.settings.most + 1
    ends = day.cut(dict.fromkeys(robots, Opened.ALL)).poses  # where others end what they drive
    others = [(r, ends[r]) for r, f in day.free_at().items() if f[0] <= day.settings.soon]
    spots = [day.site.places[p].pose for p in places]

    def far(other: tuple[str, Pose]) -> tuple[float, str]:
        return min((math.dist(other[1][:2], s[:2]) for s in spots), default=0.0), other[0]

    for name, pose in sorted((o for o in others if o[0] not in robots), key=far):
        there = body_at(day.site, name, pose)
        bodies = [body_at(day.site, *stand) for stand in itertools.product(robots, spots)]
        if any(body.distance(there) <= day.site.margin for body in bodies):
            yield name
        elif in_vain:
            in_vain -= 1
            yield name


def first_there(day: Day, job: DayOrder, free: Mapping[str, tuple[float, Pose]]) -> str:
    """Return the robot that could be first at an order's pickup, of those that may do it and were
    tried least in vain: another one may stand where it would have to go.
    """
    now = day.clock.now()

    def key(robot: str) -> tuple[int, bool, float, str]:
        in_vain = day.tried.get((job.id, robot), 0)
        aside = day.aside.get(robot, now) > now
        return in_vain, aside, _there(day, job, robot, *free[robot]), robot

    return min((r for r in free if may_do(day, job, r, *free[r])), key=key)


def may_do(day: Day, job: DayOrder, robot: str, when: float, pose: Pose) -> bool:
    """Return whether a robot can do an order before its shift ends: by straight lines, and with a
    way home that is as long as the way there.
    """
    takes = 2 * _there(day, job, robot, 0.0, pose) + _handling(day, job, robot)
    in_time = day.clock.now() + when + takes <= day.site.robots[robot].hours[1]
    return in_time and can_do(day.site, robot, job.record)


def _urgency(job: DayOrder) -> tuple[float, float, float]:
    """Return a key of which order is done next: the greatest one. How near it is does not count:
    robots that take what is near crowd there, and what is far is left for later.
    """
    record = job.record
    due = job.came + 10.0 * PATIENCE if record.due is None else record.due
    return record.priority, PATIENCE * math.log(record.weight) - due, -job.came


def _handling(day: Day, job: DayOrder, robot: str) -> float:
    """Return how long (s) a robot has to do with a job once it is there, on straight lines."""
    record = job.record
    if not isinstance(record, Order):
        return record.duration or 0.0
    speed = day.site.kind_of(robot).v_max
    ends = ([day.site.places[p].pose[:2] for p in s.at] for s in (record.pickup, record.delivery))
    way = min(itertools.starmap(math.dist, itertools.product(*ends)))
    return record.pickup.service + way / speed + record.delivery.service


def ready(day: Day, job: DayOrder) -> bool:
    """Return whether an order can be planned: it may begin soon, what comes before it is over, or
    will be by the plan (not so what is on board of a robot that does nothing now), and nobody
    stands for good where it is picked up or delivered.
    """
    if job.record.release > day.clock.now() + day.settings.soon:
        return False
    before = day.unfinished(job.record.after)
    if before and not before <= day.sure():
        return False
    return all(_can_stop(day, stop) for stop in visited(job.record))


def too_late(day: Day, job: DayOrder) -> bool:
    """Return whether all windows of a stop of an order are over: it cannot be planned any more."""
    last = (max((w[1] for w in s.window), default=math.inf) for s in visited(job.record))
    return job.came + min(last) <= day.clock.now()


def _can_stop(day: Day, stop: Stop | Task) -> bool:
    """Return whether some robot could stand at one of a stop's places, beside those that do nothing
    now, and outside areas that are blocked, and these use nothing that it takes.
    """
    resources = day.unused()
    if any(resources[name].capacity < 1 for name in stop.resources):
        return False
    away = (body_at(day.site, r, day.poses[r]) for r in day.away)
    taken = [*zip(away, itertools.repeat(day.site.margin))]
    taken += [(Polygon(shape), 0.0) for shape in day.areas.values()]
    kinds = {robot.type: r for r, robot in day.site.robots.items()}
    poses = [day.site.places[place].pose for place in stop.at]
    bodies = (body_at(day.site, *stand) for stand in itertools.product(kinds.values(), poses))
    return not taken or any(
        all(body.distance(other) > apart for other, apart in taken) for body in bodies
    )


def body_at(site: FleetRecords, robot: str, pose: Pose) -> Polygon:
    """Return where a robot's body is at a pose."""
    return Polygon(placed(site.kind_of(robot).footprint, pose))


def check_stand(site: FleetRecords, robot: str, pose: Pose, others: Mapping[str, Pose]) -> None:
    """Raise where somebody says that a robot stands at a pose at which one of ``others`` does: by
    more than a tenth of a body, as nobody measures it exactly.
    """
    here = body_at(site, robot, pose)
    for other, at in others.items():
        there = body_at(site, other, at)
        both = here.intersection(there).area
        if other != robot and both > 0.1 * min(here.area, there.area):
            raise ProblemError(
                f"'{robot}' cannot stand at {tuple(pose)}: '{other}' stands there; say first where "
                "that one was moved to"
            )


def _there(day: Day, job: DayOrder, robot: str, when: float, pose: Pose) -> float:
    """Return when a robot could be at an order's pickup, on straight lines."""
    first, *_ = visited(job.record)
    speed = day.site.kind_of(robot).v_max
    spots = (day.site.places[p].pose for p in first.at)
    return when + min(math.dist(pose[:2], spot[:2]) for spot in spots) / speed


def theirs(day: Day, robots: Mapping[str, Opened]) -> Sequence[DayOrder]:
    """Return the orders of some robots that are in the plan and that nobody is on the way to, as
    far as they can still be planned.
    """
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
    return [j for j in jobs if j.state is OrderState.PLANNED and ready(day, j)]


def _shared_anew(day: Day) -> OpenWork | None:
    """Return two robots whose orders could be shared anew, but for what is put aside."""
    left = {n for n, until in day.aside.items() if until > day.clock.now()}
    planned = {
        m.robot
        for m in day.meanings.values()
        if m.kind is Kind.PICKUP
        and m.robot not in day.off_plan() | left
        and m.what in day.jobs
        and day.jobs[m.what].state is OrderState.PLANNED
    }
    free = [r for r in day.free_at() if r not in planned | left]
    if not planned:
        return None
    rng = random.Random(f"{day.settings.seed} {day.number}")
    one = rng.choice(sorted(planned))
    other = rng.choice(sorted({*planned, *free} - {one}) or [one])
    opened = dict.fromkeys((one, other), Opened.ALL)
    jobs = theirs(day, opened)
    return OpenWork(opened, tuple(jobs)) if 0 < len(jobs) <= day.settings.most else None
