"""``Operation``: a rolling horizon over a day. What is committed stays; the rest is planned again.

One step (:meth:`Operation.step`) takes in what robots and people tell, writes it into the store,
asks the planner or takes its plan over, and tells every robot what it may do. Nothing in it waits
for the planner, which is another process; and nothing is told to a robot before the store has it.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from shapely.geometry import Polygon

from up_samp.execution.astray import place_of, pose_in
from up_samp.execution.executor import Executor
from up_samp.execution.reorder import cost
from up_samp.execution.reports import Command, Go, Heard, Hold, Reply, Report, words_of
from up_samp.execution.state import TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import pose_at
from up_samp.fleet.fleet import Fleet
from up_samp.fleet.meanings import Kind
from up_samp.fleet.records import Order, Task, visited
from up_samp.fleet.spelled_out import with_places
from up_samp.io.plan_dict import PlanDict
from up_samp.model import ProblemError, SampError
from up_samp.operate import upkeep
from up_samp.operate.choice import OUT, Day, OpenWork, check_stand, choose, too_late
from up_samp.operate.clock import Clock
from up_samp.operate.horizon import DELIVERS, driven_before, first_inside, meanings_of, pose_of
from up_samp.operate.planner import (
    Answer,
    Planner,
    check_fits,
    check_job,
    check_site,
    each_time,
    leaf_at,
)
from up_samp.operate.records import (
    DAY,
    DayOrder,
    OrderState,
    Pose,
    Robots,
    Settings,
    Shape,
    job_record,
    nothing_planned,
    since_now,
)
from up_samp.operate.stitch import Question, follow_on, goals_of, kept_of
from up_samp.operate.store import Store

SNAPSHOT = 60.0
"""Seconds after which all that has happened is kept as a whole, so that a restart is quick."""
RETRY = 5.0
"""Seconds after which the planner is asked again that found nothing, and after which a robot that
stands off its path is planned anew from there.
"""


class Operation(Day):
    """A day on the floor of ``fleet``, kept in ``store``: a new day, or one that goes on.

    :raises StoreError: where another process operates the same store.
    """

    def __init__(
        self,
        fleet: Fleet,
        *,
        store: Store,
        robots: Robots,
        clock: Clock,
        planner: Planner | None = None,
        settings: Settings = Settings(),
    ) -> None:
        check_site(fleet.records, settings.localisation)
        self.site = dataclasses.replace(
            with_places(fleet.records),
            orders=(),
            tasks=(),
            objective=fleet.records.objective if fleet.records.weighed else DAY,
        )
        self.folder: Path = fleet.folder
        self.store, self.robots, self.clock = store, robots, clock
        self.planner = planner or Planner()
        self.settings = settings
        self.meanings, self.tried, self.shut, self.areas, self.cramped = {}, {}, {}, {}, set()
        self.gone: dict[str, float] = {}
        """How much (m) of motions was driven when their plan began: robots count all of it."""
        self.poses = {n: self._home(r.start) for n, r in self.site.robots.items()}
        self.jobs, self.away, self.using, self.placed, self.aside = {}, {}, {}, {}, {}
        self.held: dict[str, str] = {}
        """Robots that are held where they are, and why."""
        self.unsure: dict[str, str] = {}
        """Robots that are held as they are less exact than planned with, and by how much."""
        self.commands: dict[str, Command] = {}
        self.wanted = ""
        """Why the rest is to be planned anew (``""``: it is not)."""
        self.costs: list[tuple[float, float, float, str, bool]] = []
        """(time, seconds, CPU seconds, why, taken) of each time that the rest was planned."""
        self._asked: tuple[Question, float, str] | None = None
        self._changed: set[str] = set()
        """Orders that were changed or cancelled since the planner was asked."""
        self._planned_at = self._snapshot_at = self._not_before = self._forecast = 0.0
        self._faults = 0
        self._off: dict[str, tuple[float, Pose | None]] = {}
        """Since when, and where, robots tell to stand that are not where their plan has them."""
        self._load([*upkeep.breaks_of(self.site), *fleet.records.jobs])

    # ------------------------------------------------------------------ a day begins, or goes on

    def _load(self, first: Iterable[Order | Task]) -> None:
        self.jobs = self.store.jobs()
        # simulated days are all one: what is drawn there depends on names
        mark = "" if self.clock.waits else f".{time.time_ns() // 10**6:x}"
        self.mark = self.store.day("mark", mark)
        for key in ("away", "using", "placed", "held", "unsure", "areas", "poses", "shut"):
            setattr(self, key, {**getattr(self, key), **(self.store.day(key) or {})})
        kept = self.store.snapshot()
        now = self.clock.now()
        self._follow(Executor(nothing_planned(self.site, self.poses), **self._following))
        self.executor.commands(now)
        if kept is not None:
            self._resume(*kept)
            with self.store:
                self.store.note(now, "operation", "", "goes on", "it was stopped or killed")
            self.wanted = "it goes on after a stop"
        if not self.jobs:
            for record in first:
                self.add(record)

    def _resume(self, number: int, saved: Mapping[str, Any], reports: list[Report]) -> None:
        """Go on where the store's last plan was."""
        self.origin, plan = self.store.plan(number)
        self.number = self.store.last_plan()
        executor = Executor.restore(plan, saved, **self._following)
        self._follow(executor)
        self._withdraw()
        with self.store:
            for report in reports:
                self._hear(report)
                executor.commands(report.time - self.origin)
            executor.commands(self.clock.now() - self.origin)  # what was told last may have begun
            self._happened()
            self._keep_snapshot()

    @property
    def _following(self) -> dict[str, Any]:
        s = self.settings
        return {"localisation": s.localisation, "latency": s.latency, "ahead": s.ahead}

    def _follow(self, executor: Executor) -> None:
        self.executor, self.meanings = executor, meanings_of(executor.plan)
        self.gone = {m["activity"]: driven_before(m) for m in executor.plan["motions"]}
        self.robots.follow(executor)
        self._limit()

    def _keep_snapshot(self) -> None:
        if number := self.executor.plan["number"]:
            self.store.put_snapshot(number, self.executor.save())
        self._snapshot_at = self.clock.now()

    # ------------------------------------------------------------------ what people say

    def add(self, record: Order | Task | Mapping[str, Any]) -> DayOrder:
        """Take an order or a task, or change one that is not begun; it is in the store then. One
        that recurs is as many orders, of which the first is returned.

        :raises FleetError: where something in it is wrong, or it speaks of what is not there.
        :raises ProblemError: where it has begun, or is done.
        """
        if isinstance(record, Mapping):
            record = job_record(record)
        check_job(record)
        self._note_begun()
        check_fits(self.site, record)
        every = each_time(record)
        for one in every:
            known = self.jobs.get(one.id)
            if known is not None and known.state not in (OrderState.WAITING, OrderState.PLANNED):
                raise ProblemError(f"'{one.id}' is {known.state.value}: it cannot be changed")
        first, *_ = [self._take_in(one) for one in every]
        return first

    def _take_in(self, record: Order | Task) -> DayOrder:
        now, known = self.clock.now(), self.jobs.get(record.id)
        job = DayOrder(record, now if known is None else known.came)
        with self.store:
            self.store.put_job(job)
            what = "came" if known is None else "changed"
            self.store.note(now, "order", job.id, what, self._to_come(record))
            self.jobs[job.id] = job
            self._withdraw(job.id)
        self.want(f"order '{job.id}' {'came' if known is None else 'was changed'}")
        return job

    def _to_come(self, record: Order | Task) -> str:
        """Return which orders one waits for that have not come yet ("": none)."""
        names = ", ".join(f"'{n}'" for n in record.after if n not in self.jobs)
        return names and f"it comes after {names}: not known yet"

    def cancel(self, name: str) -> DayOrder:
        """Cancel an order that is not begun.

        :raises ProblemError: where there is none, or it has begun.
        """
        self._note_begun()
        job = self._job(name)
        if job.state not in (OrderState.WAITING, OrderState.PLANNED):
            raise ProblemError(f"'{name}' is {job.state.value}: it cannot be cancelled")
        with self.store:
            self._set(job, OrderState.CANCELLED, "cancelled by hand")
            self._withdraw(name)
        if job.state is OrderState.PLANNED:
            self.want(f"order '{name}' was cancelled")
        return self.jobs[name]

    def _note_begun(self) -> None:
        """Note what has begun since the last step: it can be neither changed nor cancelled."""
        with self.store:
            self._happened()

    def _withdraw(self, order: str = "") -> None:
        """Let nothing begin any more of orders that were cancelled or changed, as the last one has
        just been: neither as the plan has it, nor as one has it that was asked for before.
        """
        if order:
            self._changed.add(order)
        gone = self.over()
        if gone.keys() - self.executor.withdrawn.keys():
            self.executor.withdrawn = gone
            if order:  # what is heard from now on is heard without them
                self._keep_snapshot()

    def _job(self, name: str) -> DayOrder:
        if name not in self.jobs:
            raise ProblemError(f"there is no order '{name}'")
        return self.jobs[name]

    def hold(self, robot: str = "", why: str = "by hand") -> None:
        """Hold a robot where it is, or all of them at once (an emergency stop of the fleet, which
        is no safety function).
        """
        now = self.clock.now()
        with self.store:
            for name in self._some(robot):
                self.held[name] = why
                self.store.note(now, "hold", name, "held", why)
            self.store.keep("held", self.held)
        self._command(now)

    def release(self, robot: str = "") -> None:
        """Let a robot that is held, or all of them, go on."""
        now = self.clock.now()
        with self.store:
            for name in self._some(robot):
                if self.held.pop(name, None) is not None:
                    self.store.note(now, "hold", name, "released")
            self.store.keep("held", self.held)

    def leave(self, robot: str, why: str = "out of order", pose: Pose | None = None) -> None:
        """Note that a robot does nothing any more, and stands at ``pose`` (none: where it last told
        to be); others drive round it.
        """
        (name,) = self._some(robot)
        self._check_stand(name, pose)
        now, here = self.clock.now(), pose or self.pose(name)
        with self.store:
            moved = math.dist(here, self.pose(name)) > 2 * self.error(name)
            used = () if moved else self._used_by(name) or self.using.get(name, ())
            self.away[name], self.poses[name], self.using[name] = why, here, used
            if pose is not None:  # what it tells of its motion says nothing now
                self._put(name, pose)
            self.store.note(now, "robot", name, "left", why)
            if name in self.adrift():
                until = "nothing more is planned until it tells to stand, or somebody says where"
                self.store.note(now, "robot", name, "may drive on", until)
            self._keep_fleet()
        self._other_floor(f"robot '{name}' is {why}")

    def join(self, robot: str, pose: Pose | None = None) -> None:
        """Note that a robot does its work again, from where it stands (``pose``: from there). Where
        the plan has it elsewhere, it stays until there is another one.
        """
        (name,) = self._some(robot)
        self._check_stand(name, pose)
        now = self.clock.now()
        with self.store:
            here, told = pose or self.pose(name), self._told_pose(name)
            if pose is None and math.dist(told, here) <= 2 * self.error(name):
                here = told
            self.poses[name] = here
            self.away.pop(name, None)
            self.using.pop(name, None)
            if math.dist(told, here) > self.error(name):
                self._put(name, here)
            self.store.note(now, "robot", name, "joined")
            self._keep_fleet()
        self._other_floor(f"robot '{name}' joined")

    def _used_by(self, robot: str) -> tuple[str, ...]:
        """Return the resources that a robot uses now for what it does at a place."""
        doing = map(self.meanings.__getitem__, self.executor.state.those(TaskPhase.RUNNING))
        here = (m for m in doing if m.robot == robot and m.kind in (Kind.PICKUP, *DELIVERS))
        first = ((visited(self.jobs[m.what].record), m.kind is Kind.PICKUP) for m in here)
        stops = (stops[0 if picked else -1] for stops, picked in first)
        return tuple(name for stop in stops for name in stop.resources)

    def _check_stand(self, robot: str, pose: Pose | None) -> None:
        if pose is not None:
            check_stand(self.site, robot, pose, {r: self.pose(r) for r in self.site.robots})

    def _put(self, robot: str, pose: Pose) -> None:
        """Note that a robot stands where no plan has it: others keep away from there."""
        self.placed[robot] = PLACED
        self.executor.update(robot, pose=pose, now=self.clock.now() - self.origin)
        self._keep_snapshot()  # what is heard from now on is heard with that

    def _keep_fleet(self) -> None:
        self.store.keep("away", self.away)
        self.store.keep("using", self.using)
        self.store.keep("placed", self.placed)
        self.store.keep("poses", self.poses)

    def _some(self, robot: str) -> list[str]:
        if robot and robot not in self.site.robots:
            raise ProblemError(f"there is no robot '{robot}'")
        return [robot] if robot else [*self.site.robots]

    def block(self, name: str, corners: Iterable[Iterable[float]]) -> None:
        """Let nobody enter an area from now on; who is in it, or cannot stop before, drives out."""
        shape = tuple((float(x), float(y)) for x, y in corners)
        if len(shape) < 3 or not Polygon(shape).is_valid:
            raise ProblemError(f"area '{name}' is no polygon")
        self._change_floor("area", name, "blocked", {**self.areas, name: shape}, self.shut)

    def unblock(self, name: str) -> None:
        """Open an area again."""
        if name not in self.areas:
            raise ProblemError(f"there is no blocked area '{name}'")
        left = {n: shape for n, shape in self.areas.items() if n != name}
        self._change_floor("area", name, "open again", left, self.shut)

    def close_door(self, door: str, state: str = OUT) -> None:
        """Let nobody drive through a door, or open it, from now on: it is ``OUT`` of order; or let
        it be opened again (``BACK``): it stands closed.
        """
        if door not in self.site.doors:
            raise ProblemError(f"there is no door '{door}' that robots open")
        self._change_floor("door", door, state, self.areas, {**self.shut, door: state})

    def _change_floor(
        self, kind: str, name: str, what: str, areas: dict[str, Shape], shut: dict[str, str]
    ) -> None:
        """Note what has become of an area, or a door."""
        with self.store:
            self.areas, self.shut = areas, shut
            self.store.keep("areas", areas)
            self.store.keep("shut", shut)
            self.store.note(self.clock.now(), kind, name, what)
            self._withdraw()
            self._limit()
            self._keep_snapshot()  # with how far everybody may go, and what had begun
        self._other_floor(f"{kind} '{name}' is {what}")

    def charge(self, robot: str) -> DayOrder:
        """Let a robot charge until it is full, once it has done what it is on the way to.

        :raises ProblemError: where it has no battery, or is to charge already.
        """
        (name,) = self._some(robot)
        if name in self.charging():
            raise ProblemError(f"'{name}' is to charge already")
        number = sum(upkeep.is_charge(job) for job in self.jobs)
        named = f"{upkeep.CHARGE}{name}.{number}"
        return self.add(upkeep.charge_task(self.site, name, named, self.clock.now()))

    def charging(self) -> set[str]:
        """Return the robots that are to charge, or do so."""
        some = (j for j in self.jobs.values() if upkeep.is_charge(j.id) and j.state.open)
        return {robot for job in some for robot in job.record.robots}

    def _limit(self) -> None:
        """Find out how far motions may go with the areas that are blocked."""
        doors = {n: self.site.doors[n] for n in self.shut}
        # a leaf is a thing that plans keep clear of
        clear = self.site.margin + 2 * max(map(self.error, self.site.robots), default=0.0)
        leaves = [Polygon(leaf_at(d, d.closed)).buffer(clear) for d in doors.values()]
        shapes = [*map(Polygon, self.areas.values()), *leaves]
        self.executor.state.limits = first_inside(self.executor, shapes)

    def _other_floor(self, why: str) -> None:
        """Ask for the rest to be planned anew, also what no plan was found for: there may be one
        now. Nobody is to take up what could not be brought to its end.
        """
        for some in (self.aside, self.tried, self.cramped):
            some.clear()
        with self.store:
            for job in self.hindered():
                self._set(job, OrderState.WAITING, why)
                self._withdraw(job.id)
        self.want(why)

    def want(self, why: str) -> None:
        """Ask for the rest to be planned anew."""
        if not self.wanted or self.wanted in (EVERY, OVERDUE):
            self.wanted = why

    # ------------------------------------------------------------------ one step

    def step(self) -> None:
        """Do what is to be done now, and let a tick pass."""
        now = self.clock.now()
        low = {*upkeep.low(self.site, self.robots.levels, self.settings.low)}
        for robot in low - self.charging():
            self.charge(robot)
        for robot, begins in upkeep.shift_changes(self).items():
            self.join(robot) if begins else self.leave(robot, upkeep.OFF)
        with self.store:
            for report in filter(self._sure, self.robots.reports(now)):
                self.store.put_report(report)
                self._hear(report)
            mute = upkeep.mute(self, self.robots.levels)
            self.robots.faults.extend(sorted(mute.difference(self.robots.faults)))
            for robot, words in self.robots.faults[self._faults :]:
                self.store.note(now, "robot", robot, "fault", words)
            self._faults = len(self.robots.faults)
            known = len(self.executor.state.fired)
            self.executor.commands(now - self.origin)
            if len(self.executor.state.fired) > known:
                self._snapshot_at = -math.inf  # no report tells what time lets begin
            self._happened()
            self._plan(now)
            if now - self._snapshot_at >= SNAPSHOT:
                self._keep_snapshot()
        self._command(now)
        self.clock.sleep(self.settings.tick)

    def close(self) -> None:
        """End the planner's process, and let others have the store."""
        self.planner.close()
        self.store.close()

    @property
    def idle(self) -> bool:
        """Whether nothing is left to do."""
        none = not any(j.state.open for j in self.jobs.values())
        return none and self.executor.finished

    def _sure(self, report: Report) -> bool:
        """Return whether what a robot tells is as exact as was planned with: else it is held, and
        where it tells to be is not believed, until it is.
        """
        who, error, most = report.robot, report.error, self.error(report.robot)
        if error is not None and (error > most) != (who in self.unsure):
            why = f"it may be {error:.2f} m from where it tells to be, not {most:g} m"
            if self.unsure.pop(who, None) is None:
                self.unsure[who] = why
            why = self.unsure.get(who, "")
            self.store.note(report.time, "report", who, "is held" if why else "is sure again", why)
            self.store.keep("unsure", self.unsure)
        ways = self.executor.state.ways_of
        # what it did at its place is done, wherever that is
        return who not in self.unsure or (report.done and not ways.get(report.activity, True))

    def _hear(self, report: Report) -> None:
        executor, name = self.executor, report.robot
        if name in self.placed and report.pose is None:
            return  # of what was ended by hand
        at = report.time - self.origin
        if report.done:
            reply = executor.done(report.activity, at, name)
            if reply.heard is Heard.AGAIN and name not in self.off_plan():
                self._fell_short(report)
            return
        if report.activity and executor.state.of_object.get(name) is None:
            return  # of a motion that is over, or of a plan before
        where: dict[str, Any] = {"pose": report.pose}
        if report.progress is not None:
            where = {"progress": report.progress - self.gone.get(report.activity, 0.0)}
        reply = executor.update(name, now=at, motion=report.activity or None, **where)
        if name in self.away.keys() - self.placed.keys():
            self._see(report, reply)
        elif name not in self.placed:
            self._find(report, reply)

    def _find(self, report: Report, reply: Reply) -> None:
        """Let a robot wait for a plan from where it stands that stands elsewhere than its plan has
        it for a while: an order never came, or messages of where it stopped.
        """
        name, here = report.robot, report.pose
        if reply.heard is not Heard.HELD:
            self._off.pop(name, None)
            return
        if name not in self._off:
            self.store.note(report.time, "report", name, "is held", reply.why)
        since, there = self._off.get(name, (report.time, here))
        if here is None or there is None or math.dist(here, there) > 2 * self.error(name):
            since, there = report.time, here
        self._off[name] = since, there
        if here is not None and report.time >= since + RETRY:
            self._stands_elsewhere(report, here, reply.why)

    def _fell_short(self, report: Report) -> None:
        """Let a robot wait for a plan from where it stands that says that it is at the end of its
        motion, and for a while tells to stand before that: it missed it, or was pushed.
        """
        state = self.executor.state
        way = state.of_object.get(report.robot)
        if way is None or way.activity != report.activity or state.closed(way) is not None:
            return
        if not state.arrived(way) and report.time - self.origin >= way.since + RETRY:
            why = f"it is {way.length - way.told:.2f} m from the end of '{way.activity}'"
            self._stands_elsewhere(report, self._told_pose(report.robot), why)

    def _stands_elsewhere(self, report: Report, here: Pose, why: str) -> None:
        name = report.robot
        self._off.pop(name, None)
        self.poses[name], self.placed[name] = here, PLACED
        self._keep_fleet()
        self._keep_snapshot()
        self.store.note(report.time, "robot", name, "stands elsewhere", why)
        self.want(f"robot '{name}' stands elsewhere than its plan has it")

    def _see(self, report: Report, reply: Reply) -> None:
        """Note where a robot is that does nothing: it still brakes, say."""
        name, here, least = report.robot, report.pose, 2 * self.error(report.robot)
        way = self.executor.state.of_object.get(name)
        if reply.heard is Heard.TAKEN and way is not None:
            # on its motion it never goes back, so that the last centimetres count, too
            path, least = self.executor.drives[way.activity, name].path, TOLERANCES.place
            here = pose_of(pose_at(path, way.progress))
        here = self._told_pose(name) if here is None else here
        if math.dist(here, self.poses[name]) > least:
            self.poses[name] = here
            self._keep_fleet()

    def pose(self, thing: str) -> Pose:
        """Return where a robot was last told to be, or where a door stands."""
        if thing in self.off_plan():
            return self.poses[thing]
        strayed = self.executor.state.strayed.get(thing)
        return self._told_pose(thing) if strayed is None else pose_of(strayed.pose)

    def _told_pose(self, thing: str) -> Pose:
        lives = self.executor.dependencies.lives
        if thing not in lives:
            return self.site.doors[thing].closed
        here = place_of(self.executor.state, lives[thing])
        if here is None:  # between what it did and what it does
            return self.cut().poses[thing]
        return pose_of(pose_in(self.executor.state, here))

    def _happened(self) -> None:
        """Note which orders have begun, and which are done."""
        for name, meaning in self.meanings.items():
            job = self.jobs.get(meaning.what)
            phase = self.executor.phase(name)
            if job is None or phase is TaskPhase.WAITING or not job.state.open:
                continue
            when = self.executor.state.now + self.origin
            if phase is TaskPhase.DONE and meaning.kind in DELIVERS:
                self._set(replace(job, robot=meaning.robot, done=when), OrderState.DONE)
            elif job.state is not OrderState.BEGUN or job.robot != meaning.robot:
                self._set(replace(job, robot=meaning.robot, begun=when), OrderState.BEGUN)

    def _set(self, job: DayOrder, state: OrderState, why: str = "") -> None:
        self.jobs[job.id] = replace(job, state=state)
        self.store.put_job(self.jobs[job.id])
        by = f" by {job.robot}" if job.robot else ""
        self.store.note(self.clock.now(), "order", job.id, f"{state.value}{by}", why)

    # ------------------------------------------------------------------ what robots are told

    def _command(self, now: float) -> None:
        """Tell everybody what to do; what is new is in the store first."""
        # who is in no plan stays: what it was told in one before is over
        every = dict.fromkeys(self.site.robots, Hold()) | self.executor.commands(now - self.origin)
        found = {who: self._allowed(who, c) for who, c in every.items()}
        new = {
            who: c for who, c in found.items() if words_of(c) != words_of(self.commands.get(who))
        }
        if new:
            with self.store:
                for who, command in new.items():
                    self.store.note(now, "told", who, *words_of(command))
        self.commands = found
        self.robots.tell(found, now)

    def _allowed(self, who: str, command: Command) -> Command:
        """Return a command as far as it may be given."""
        if who in self.held:
            return Hold((f"held {self.held[who]}",))
        if who in self.unsure:
            return Hold((self.unsure[who],))
        if who in self.off_plan():
            return Hold((self.away.get(who) or self.placed[who],))
        if isinstance(command, Go):
            return replace(command, until=command.until + self.gone.get(command.motion, 0.0))
        return command

    # ------------------------------------------------------------------ planning

    def _plan(self, now: float) -> None:
        if self._asked is not None:
            question, since, why = self._asked
            budget = self.settings.budget + self.settings.grace
            if self.clock.waits and now < since + budget:
                return
            answer = self.planner.taken(wait=self.clock.waits)
            if answer is None:
                return
            self._asked = None
            taken, reason = self._take(question, answer, why, since)
            self.costs.append((now, answer.seconds, answer.cpu, why, taken))
            self.store.note(
                now, "plan", str(answer.number), "taken" if taken else "dropped", reason
            )
            self._planned_at = now
            if not taken:
                self.again = now + RETRY
                if why not in (EVERY, OVERDUE):
                    self.want(why if why.startswith("again") else f"again: {why}")
        self._look(now)
        due = self.wanted and now >= self._not_before and not self.planner.busy
        if due and not self.adrift():
            self._ask(now)

    def _look(self, now: float) -> None:
        """Find out whether it is time to plan anew."""
        if waiting := (*self.waiting(), *self.dropped()):
            self.want("orders wait that are in no plan")
        for job in (j for j in waiting if not j.note and too_late(self, j)):
            why = "its windows are over: cancel it, or change them"
            self._set(replace(job, note=why), OrderState.WAITING, why)
        if now < self._planned_at + RETRY:
            return
        if self.stranded():
            self.want("robots stand that have nothing to do there")
        if self.executor.finished:
            return
        if now >= self._planned_at + self.settings.every:
            self.want(EVERY)
        elif self._end() > self._forecast + self.settings.late:
            self.want(OVERDUE)

    def _ask(self, now: float) -> None:
        """Ask the planner for a plan of what is left."""
        why, self.wanted = self.wanted, ""
        choice = self.choice()
        if choice is None:
            self._planned_at = now
            self._forecast = max(self._forecast, self._end())
            self._not_before = now + 5 * self.settings.tick
            return
        if why not in (EVERY, OVERDUE) and not self._needed(choice):
            why = EVERY
        cut, chosen = self.cut(choice.opened), choice.jobs
        staying = [self.jobs[n] for n in cut.jobs if n in self.jobs]
        carried = [(r, self.jobs[w]) for w, r in cut.carrying.items()]
        self.number += 1
        question = Question(
            number=self.number,
            mark=f"{self.number}{self.mark}",
            site=replace(upkeep.from_now(self.site, now), resources=self.unused()),
            folder=self.folder,
            cut=cut,
            kept=kept_of(self.executor, cut),
            jobs=tuple(self._left(j, now) for j in chosen),
            robots=tuple(choice.opened),
            beside=choice.beside,
            held=tuple((r, since_now(j.record, now, j.came)) for r, j in carried),
            on_board=self.on_board(),
            areas=self.areas,
            shut=frozenset(n for n, state in self.shut.items() if state == OUT).union(
                self.left_opening().values()
            ),
            levels=upkeep.start_levels(
                self.site, self.robots.levels, self.executor.drives, self.meanings, cut.kept
            ),
            kept_jobs=tuple(since_now(j.record, now, j.came) for j in staying),
            settings=self.settings,
            computing=self.clock.waits,
        )
        self.store.note(now, "plan", str(self.number), f"asked for {len(chosen)} orders", why)
        self._changed.clear()
        self.planner.ask(question)
        self._asked = question, now, why

    def _left(self, job: DayOrder, now: float) -> Any:
        """Return an order on the clock of a plan that begins ``now``, after what is not over."""
        before = sorted(self.unfinished(job.record.after))
        return replace(since_now(job.record, now, job.came), after=tuple(before))

    def choice(self) -> OpenWork | None:
        """Return what is planned next."""
        return choose(self)

    def _end(self) -> float:
        return self.executor.predicted_makespan() + self.origin

    def _needed(self, choice: OpenWork) -> bool:
        """Return whether something is planned that is in no plan."""
        left = {j.id for j in self.dropped()}
        more = any(j.state is not OrderState.PLANNED or j.id in left for j in choice.jobs)
        return more or any(r in (*self.stranded(), *self.stale()) for r in choice.opened)

    def _take(self, question: Question, answer: Answer, why: str, since: float) -> tuple[bool, str]:
        """Take a plan over if it is valid from now, and needed or better; say whether, and why."""
        robots = set(question.robots)
        if answer.plan is None:
            if not answer.found or robots <= self.cramped:
                self.put_aside([j.id for j in question.jobs], question.robots)
            self.cramped |= robots
            return False, answer.why
        if question.cut.away != self.off_plan():
            return False, "a robot has gone, or is back, since it was asked for"
        for name in question.cut.away:
            if math.dist(question.cut.poses[name], self.poses[name]) > self.error(name):
                return False, f"'{name}' still moved when it was asked for"
        known = {j.id for j in (*question.jobs, *question.kept_jobs)}
        if gone := sorted(self._changed & known):
            return False, f"'{gone[0]}' was changed or cancelled since it was asked for"
        plan = {**answer.plan, "number": answer.number}
        if twice := self._twice(plan):
            return False, f"'{twice}' would be done twice"
        try:
            executor = self._joined(plan, question, since)
        except SampError as error:
            self.cramped |= robots
            return False, " ".join(str(error).split())[:300]
        if why in (EVERY, OVERDUE):
            before = self._cost(self.executor, self.origin)
            if self._cost(executor, since) >= before - 1.0:
                return False, "what is driven is no worse"
        self.origin = since
        self.placed.clear()
        self._keep_fleet()
        self.shut = {n: s for n, s in self.shut.items() if s == OUT or n in question.shut}
        self.store.keep("shut", self.shut)
        self.store.put_plan(answer.number, self.clock.now(), self.origin, plan)
        self._follow(executor)
        self._forecast = self._end()
        self.cramped -= robots
        done = {m.what for m in self.meanings.values()}
        self.tried = {p: n for p, n in self.tried.items() if not (done | robots).intersection(p)}
        for job in [*self.jobs.values()]:
            if job.state is OrderState.WAITING and job.id in done:
                self._set(job, OrderState.PLANNED, f"plan {answer.number}")
            elif job.state is OrderState.PLANNED and job.id not in done:
                self._set(job, OrderState.WAITING, f"not in plan {answer.number}")
        self._withdraw()
        self._keep_snapshot()
        return True, why

    def _twice(self, plan: PlanDict) -> str:
        """Return an order that would be done twice ("": there is none)."""
        ends = Counter(m.what for m in meanings_of(plan).values() if m.kind in DELIVERS)
        kept = {m.what for n, m in self.meanings.items() if self._is_done(n) and m.kind in DELIVERS}
        over = {n for n, job in self.jobs.items() if job.state is OrderState.DONE} - kept
        return next((what for what, times in ends.items() if times > 1 or what in over), "")

    def _joined(self, plan: PlanDict, question: Question, since: float) -> Executor:
        """Return an executor that goes on with a new plan.

        :raises ProblemError: where something has begun meanwhile that the plan does not keep.
        """
        executor = Executor(plan, **self._following)
        follow_on(executor, self.executor, question.cut, since - self.origin)
        return executor

    def _cost(self, executor: Executor, origin: float) -> float:
        """Return what a plan costs by forecast: seconds until orders are done, and ten times those
        that they are late.
        """
        jobs = (j.record for j in self.jobs.values() if j.state.open)
        mine = [j if j.due is None else replace(j, due=j.due - origin) for j in jobs]
        goals = goals_of(meanings_of(executor.plan), mine)
        total = cost(goals, executor.retime())
        return total + origin * sum(g.weight for g in goals.values()) if goals else 0.0


PLACED = "it waits for a plan that begins where it stands"
EVERY, OVERDUE = "it is time to look again", "it is late"
