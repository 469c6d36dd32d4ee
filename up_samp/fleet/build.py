"""Write the records of a fleet problem as an ordinary UP problem, in the form that is solved best.

- Each robot has a fluent for its place. Moves need it at their start and set it at their end; what
  is done at places needs it over ``(start, end]``, so that it may begin as a move ends.
- What one robot does takes the robot, a resource of one unit: linear in size, where pairs are not.
- What can be done by several robots is one optional activity each, exactly one of them present.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from unified_planning.model import (
    Fluent,
    FNode,
    GlobalEndTiming,
    TimePointInterval,
    Timing,
)
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import LeftOpenTimeInterval
from unified_planning.shortcuts import (
    FALSE,
    LE,
    TRUE,
    BoolType,
    ConfigurationType,
    Equals,
    IntType,
    MinimizeMakespan,
    MovableType,
    Not,
    Or,
)

from up_samp.fleet.batteries import (
    GRAINS,
    Meter,
    first_level,
    lowest,
    step_of,
    steps_of,
)
from up_samp.fleet.crowds import Crowd, Passing
from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.loads import (
    MARK,
    attached_of,
    ends_of,
    is_under,
    load_pose,
    place_of,
    poses_of,
    ridden,
)
from up_samp.fleet.outlines import corners, movable
from up_samp.fleet.records import FleetRecords, Order, Outline, Pose, RobotType, Stop, Task
from up_samp.fleet.visits import WORK, Role, Successions, Visit, fits, moves_needed, visits_of
from up_samp.geometry import load_map


def build_problem(records: FleetRecords, folder: Path) -> SchedulingMotionProblem:
    """Return the UP problem of ``records``; their map is relative to ``folder``.

    :raises UnsupportedError: where something cannot be said to the engines.
    """
    return _Writer(records, folder).write()


def at_start(a: Activity) -> TimePointInterval:
    """Return the instant at which ``a`` starts."""
    return TimePointInterval(Timing(0, a.start))


def while_there(a: Activity) -> LeftOpenTimeInterval:
    """Return ``(start, end]`` of ``a``: a move may end as it begins."""
    return LeftOpenTimeInterval(Timing(0, a.start), Timing(0, a.end))


class _Writer:
    """A UP problem that grows record by record."""

    def __init__(self, records: FleetRecords, folder: Path) -> None:
        self.records = records
        self.problem = SchedulingMotionProblem(records.name)
        self.folder = folder
        self.map = str(folder / records.map)
        site = OccupancyMap(self.map, SE2(0.0, 0.0, 0.0))
        self.pose_type = ConfigurationType("pose", site, ConfigurationKind.SE2)
        self.places: dict[str, ConfigurationObject] = {}
        self.robots: dict[str, MovableObject] = {}
        self.doors: dict[str, MovableObject] = {}
        self.pallets: dict[str, MovableObject] = {}
        self.stands: dict[tuple[str, str], ConfigurationObject] = {}
        self.keep_out: dict[str, list[MovableObject]] = {}
        self.crowds: list[Crowd] = []
        self.rooms: dict[str, tuple[MovableObject, FNode]] = {}
        self.batteries: dict[str, FNode] = {}
        self.meter = Meter(records, folder)
        self.resources: dict[str, Fluent] = {}
        self.visits: dict[str, list[Visit]] = {r: visits_of(records, r) for r in records.robots}
        self.activities: dict[Visit, Activity] = {}
        self.machines: dict[str, Activity] = {}
        self.leaving: dict[str, Activity] = {}
        self.busy: dict[str, list[Activity]] = {r: [] for r in records.robots}
        self.robot_at: dict[str, FNode] = {}

    def write(self) -> SchedulingMotionProblem:
        for name, pose in poses_of(self.records).items():
            self.places[name] = self._pose(name, pose)
        for name, resource in self.records.resources.items():
            self.resources[name] = self.problem.add_resource(name, resource.capacity)
        self._robots()
        self._pallets()
        self._doors()
        self._zones()
        for visits in self.visits.values():
            for visit in visits:
                if visit.role is Role.CHARGE:
                    self._charge(visit)
                elif visit.role in WORK:
                    self._work(visit)
        for task in self.records.tasks:
            if not task.at:
                self._machine(task)
        for name in self.records.robots:
            self._moves(name)
            self._loads(name)
        self._jobs()
        self._after()
        self._priorities()
        self._left_out()
        for robot, activities in self.busy.items():
            self._one_at_a_time(robot, activities)
        if self.records.objective == "makespan":
            self.problem.add_quality_metric(MinimizeMakespan())
        return self.problem

    # -- what there is -------------------------------------------------------------------------
    def _pose(self, name: str, pose: Pose) -> ConfigurationObject:
        found = ConfigurationObject(name, self.pose_type, SE2(*pose))
        self.problem.add_object(found)
        return found

    def _robots(self) -> None:
        types = {name: MovableType(name) for name in self.records.robot_types}
        for name, robot in self.records.robots.items():
            kind = self.records.robot_types[robot.type]
            robot_object = movable(name, types[robot.type], kind)
            self.problem.add_object(robot_object)
            self.problem.set_initial_configuration(robot_object, self.places[robot.start])
            self.robots[name] = robot_object
            fluent = Fluent(f"{name}_at", self.pose_type)
            self.problem.add_fluent(fluent, default_initial_value=self.places[robot.start])
            self.robot_at[name] = fluent()
            if kind.battery is not None:
                level = Fluent(f"{name}_battery", IntType(lowest(kind.battery), GRAINS))
                self.problem.add_fluent(level, default_initial_value=first_level(kind.battery))
                self.batteries[name] = level()
            if robot.end is not None:
                end = Equals(self.robot_at[name], self.places[robot.end])
                self.problem.add_condition(TimePointInterval(GlobalEndTiming()), end)

    def _pallets(self) -> None:
        """Loads that travel with robots: they stand at their pickup at first."""
        for order in attached_of(self.records):
            assert order.attached is not None
            pickups, deliveries = ends_of(order)
            name = f"load{MARK}{order.id}"
            for place in dict.fromkeys((*pickups, *deliveries)):
                pose = load_pose(order.attached, self.records.places[place_of(place)].pose)
                self.stands[order.id, place] = self._pose(f"load{MARK}{place}", pose)
            at = self.stands[order.id, pickups[0]]
            self.pallets[order.id] = self._fixture(name, order.attached.footprint, at, "load")

    def _fixture(
        self, name: str, outline: Outline, pose: ConfigurationObject, kind: str = "fixture"
    ) -> MovableObject:
        fixture = MovableObject(
            name, MovableType(kind), footprint=corners(outline), motion_model=MotionModels.SE2
        )
        self.problem.add_object(fixture)
        self.problem.set_initial_configuration(fixture, pose)
        return fixture

    def _doors(self) -> None:
        for name, door in self.records.doors.items():
            closed = self._pose(f"{name}.closed", door.closed)
            opened = self._pose(f"{name}.open", door.open)
            self.doors[name] = self._fixture(name, door.leaf, closed)
            self.places[closed.name], self.places[opened.name] = closed, opened
            fluent = Fluent(f"{name}_at", self.pose_type)
            self.problem.add_fluent(fluent, default_initial_value=closed)
            self.robot_at[name] = fluent()

    def _zones(self) -> None:
        for name, zone in self.records.zones.items():
            here = self._pose(f"{name}.here", (0.0, 0.0, 0.0))
            area = self._fixture(name, zone.polygon, here)
            for kind in zone.keep_out:
                self.keep_out.setdefault(kind, []).append(area)
            if zone.max_robots is not None:
                self.crowds.append(Crowd(self.records, self.folder, name))
                self._room(name, area, zone.max_robots)

    def _room(self, name: str, area: MovableObject, most: int) -> None:
        """How many more robots may come into a zone."""
        inside = sum(self.crowds[-1].starts_inside(r) for r in self.records.robots)
        if inside > most:
            what = f"{inside} robots start in it; it takes {most}"
            raise FleetError([Fault(("zones", name, "max_robots"), what)])
        room = Fluent(f"{name}_room", IntType(0, most))
        self.problem.add_fluent(room, default_initial_value=most - inside)
        self.rooms[name] = (area, room())

    # -- what happens at places ----------------------------------------------------------------
    def _work(self, visit: Visit) -> None:
        """Add what a robot does at one of a visit's places."""
        length, window, resources = self._figures(visit)
        units = self._up(length)
        if visit.role is Role.OPEN:
            a: Any = self.problem.add_motion_activity(visit.name, units, optional=True)
            opened, state = self.places[f"{visit.what}.open"], self.robot_at[visit.what]
            a.add_motion_effect(self.doors[visit.what], opened)
            a.add_condition(at_start(a), Equals(state, self.places[f"{visit.what}.closed"]))
            a.add_effect(a.end, state, opened)
        else:
            a = self.problem.add_activity(visit.name, duration=units, optional=True)
        at = self.robot_at[visit.robot]
        here = [Equals(at, self.places[p]) for p in visit.places]
        a.add_condition(while_there(a), here[0] if len(here) == 1 else Or(here))
        self._limit(a, window, resources)
        self.activities[visit] = a
        self.busy[visit.robot].append(a)

    def _charge(self, visit: Visit) -> None:
        """Add the steps of a visit to a charger: one after the other, as many as are wanted."""
        mine = self.records.robots[visit.robot]
        battery = self.records.robot_types[mine.type].battery
        charger = self.records.places[visit.what].charger
        assert battery is not None
        assert charger is not None
        level, at = self.batteries[visit.robot], self.robot_at[visit.robot]
        before: Activity | None = None
        for step in range(1, steps_of(battery, charger) + 1):
            name = f"{visit.name}_{step}"
            a = self.problem.add_activity(name, self._up(charger.step), optional=True)
            a.add_condition(while_there(a), Equals(at, self.places[visit.what]))
            a.add_increase_effect(a.end, level, step_of(battery, charger))
            self.busy[visit.robot].append(a)
            if before is not None:
                self.problem.add_constraint(Or(Not(a.present), before.present))
                self.problem.add_constraint(LE(before.end, a.start), _present(before, a))
            before = a

    def _machine(self, task: Task) -> None:
        """Add what no robot does."""
        units = self._up(task.duration)
        a = self.problem.add_activity(task.id, duration=units, optional=task.optional)
        self._limit(a, task.window, task.resources)
        self.machines[task.id] = a

    def _figures(self, visit: Visit) -> tuple[float, tuple[float, float] | None, tuple[str, ...]]:
        """Return how long a visit lasts (s), its window and its resources."""
        if visit.role is Role.OPEN:
            return self.records.doors[visit.what].seconds, None, ()
        if visit.role is Role.TASK:
            task = next(t for t in self.records.tasks if t.id == visit.what)
            return task.duration, task.window, task.resources
        order = next(o for o in self.records.orders if o.id == visit.what)
        stop: Stop = order.pickup if visit.role is Role.PICKUP else order.delivery
        return stop.service, stop.window, stop.resources

    def _limit(
        self, a: Activity, window: tuple[float, float] | None, resources: Iterable[str]
    ) -> None:
        if window is not None:
            a.add_release_date(self._up(window[0]) if window[0] else 0)
            a.add_deadline(math.floor(window[1] / self.records.seconds_per_unit + 1e-9))
        for resource in resources:
            a.uses(self.resources[resource])

    def _up(self, seconds: float) -> int:
        """Return seconds as whole units, rounded up, at least one."""
        return max(1, math.ceil(seconds / self.records.seconds_per_unit - 1e-9))

    # -- moves -----------------------------------------------------------------------------------
    def _moves(self, robot: str) -> None:
        kind = self.records.robot_types[self.records.robots[robot].type]
        needed = moves_needed(self.visits[robot], Successions(self.records, kind))
        longest = self._longest(kind)
        for (origin, to), copies in needed.items():
            order = ridden(self.records, origin, to)
            verb = f"move_{robot}_{origin}_to_{to}"
            if order is not None:
                verb = f"carry_{order.id}_{robot}_{place_of(origin)}_to_{place_of(to)}"
            for number in range(1, copies + 1):
                name = verb + (f"_{number}" if number > 1 else "")
                self._move(robot, origin, to, name, longest)

    def _move(self, robot: str, origin: str, to: str, name: str, longest: int) -> None:
        mover = self.robots[robot]
        a = self.problem.add_motion_activity(name, optional=True)
        a.set_duration_bounds(1, longest)
        static = [*self.doors.values(), *self.keep_out.get(mover.type.name, ())]
        for crowd in self.crowds:
            area, room = self.rooms[crowd.zone]
            passing = crowd.passing(robot, origin, to)
            if passing is Passing.AROUND:
                static.append(area)
            if passing in (Passing.IN, Passing.THROUGH):
                a.add_decrease_effect(a.start, room, 1)
            if passing in (Passing.OUT, Passing.THROUGH):
                a.add_increase_effect(a.end, room, 1)
        a.add_motion_constraint(
            ActivityWaypoints(
                mover,
                self.places[origin],
                [self.places[to]],
                static_obstacles=static,
                dynamic_obstacles_at_start=self._moving(robot, origin, to),
            )
        )
        a.add_motion_effect(mover, self.places[to])
        amount = self.meter.drive(robot, origin, to)
        if amount:
            a.add_decrease_effect(a.start, self.batteries[robot], amount)
        order = ridden(self.records, origin, to)
        if order is not None:
            a.add_motion_effect(self.pallets[order.id], self.stands[order.id, to])
        a.add_condition(at_start(a), Equals(self.robot_at[robot], self.places[origin]))
        a.add_effect(a.end, self.robot_at[robot], self.places[to])
        self.busy[robot].append(a)

    def _moving(self, robot: str, origin: str, to: str) -> list[MovableObject]:
        """Return what else moves and is in the way of a drive: other robots, and all loads on the
        floor but for those that it takes along, or stands under when it begins or ends.
        """
        kind = self.records.robot_types[self.records.robots[robot].type]
        found = [r for name, r in self.robots.items() if name != robot]
        for order in attached_of(self.records):
            assert order.attached is not None
            mine = {name for end in ends_of(order) for name in end} & {origin, to}
            if not (mine and (len(mine) == 2 or is_under(kind, order.attached))):
                found.append(self.pallets[order.id])
        return found

    def _longest(self, kind: RobotType) -> int:
        """Return how long a move may take (units): four times along the map's edges, and a
        quarter of an hour, in which others can get out of the way.
        """
        width, height = load_map(self.map).size
        return self._up(8 * (width + height) / kind.v_max + 900)

    # -- what binds visits together ------------------------------------------------------------
    def _loads(self, robot: str) -> None:
        """State what fits on a robot at a time."""
        kind = self.records.robot_types[self.records.robots[robot].type]
        mine = {v.what for v in self.visits[robot] if v.role is Role.PICKUP}
        orders = [o for o in self.records.orders if o.id in mine]
        if len(orders) > 1 and not any(
            fits(pair, kind.capacity) for pair in itertools.combinations(orders, 2)
        ):
            self._hands(robot, orders)
            return
        for load in sorted({k for o in orders for k in o.load}):
            if sum(o.load.get(load, 0) for o in orders) > kind.capacity.get(load, 0):
                self._level(robot, load, kind.capacity[load], orders)

    def _hands(self, robot: str, orders: Sequence[Order]) -> None:
        """One order at a time: the robot's hands are free or not."""
        fluent = Fluent(f"{robot}_free", BoolType())
        self.problem.add_fluent(fluent, default_initial_value=TRUE())
        for order in orders:
            pick, deliver = self._pair(robot, order)
            pick.add_condition(at_start(pick), fluent())
            pick.add_effect(pick.end, fluent(), FALSE())
            deliver.add_effect(deliver.end, fluent(), TRUE())

    def _level(self, robot: str, load: str, capacity: int, orders: Sequence[Order]) -> None:
        """Room for loads of a kind: taken as a pickup begins, given back as a delivery ends."""
        fluent = Fluent(f"{robot}_room_{load}", IntType(0, capacity))
        self.problem.add_fluent(fluent, default_initial_value=capacity)
        for order in orders:
            amount = order.load.get(load, 0)
            if amount:
                pick, deliver = self._pair(robot, order)
                pick.add_decrease_effect(pick.start, fluent(), amount)
                deliver.add_increase_effect(deliver.end, fluent(), amount)

    def _pair(self, robot: str, order: Order) -> tuple[Activity, Activity]:
        pickups, deliveries = ends_of(order)
        pick = Visit(robot, Role.PICKUP, order.id, pickups)
        deliver = Visit(robot, Role.DELIVERY, order.id, deliveries)
        return self.activities[pick], self.activities[deliver]

    def _jobs(self) -> None:
        """Each job is done by exactly one robot, and orders are delivered by whom picked them."""
        for order in self.records.orders:
            pairs = [self._pair(v.robot, order) for v in self._visits(order.id, Role.PICKUP)]
            self._done_once(order, [pick for pick, _ in pairs], "pick")
            self._done_once(order, [deliver for _, deliver in pairs], "deliver")
            for pick, deliver in pairs:
                self._together(pick, deliver)
                order_kept = LE(pick.end, deliver.start)
                self.problem.add_constraint(order_kept, [pick.present, deliver.present])
        for task in self.records.tasks:
            if task.at:
                found = self._visits(task.id, Role.TASK)
                self._done_once(task, [self.activities[v] for v in found], "task")
            elif task.optional:
                self._done_once(task, [self.machines[task.id]], "task")

    def _visits(self, what: str, role: Role) -> list[Visit]:
        return [v for v in self.activities if v.what == what and v.role is role]

    def _done_once(self, job: Order | Task, activities: Sequence[Activity], part: str) -> None:
        """Exactly one of ``activities`` is there, or one that stands for leaving the part out.

        That one lasts as long as they do: the scheduler reads alternatives of equal length as one
        thing to be done, and finds first plans in which it is.
        """
        ways = [*activities]
        if job.optional and job.penalty is not None:
            length = int(activities[0].duration.lower.constant_value())
            skip = self.problem.add_activity(f"skip_{part}_{job.id}", length, optional=True)
            self._together(skip, self._leaving(job.id, job.penalty))
            ways.append(skip)
        self._exactly_one(ways)

    def _leaving(self, job: str, penalty: float) -> Activity:
        if job not in self.leaving:
            units = self._up(penalty)
            a = self.problem.add_activity(f"leave_out_{job}", duration=units, optional=True)
            self.leaving[job] = a
        return self.leaving[job]

    def _left_out(self) -> None:
        """What is left out counts as seconds of makespan: it comes after all else, one by one."""
        last = set(self.leaving.values())
        for leaving in self.leaving.values():
            for a in self.problem.activities:
                if a not in last:
                    self.problem.add_constraint(LE(a.end, leaving.start), _present(a, leaving))
        self._one_at_a_time("nobody", list(self.leaving.values()))

    def _exactly_one(self, activities: Sequence[Activity]) -> None:
        self.problem.add_constraint(Or([a.present for a in activities]))
        for a, b in itertools.combinations(activities, 2):
            self.problem.add_constraint(Or(Not(a.present), Not(b.present)))

    def _together(self, a: Activity, b: Activity) -> None:
        self.problem.add_constraint(Or(Not(a.present), b.present))
        self.problem.add_constraint(Or(Not(b.present), a.present))

    def _ends(self, job: str) -> list[Activity]:
        """Return the activities of which one ends a job."""
        if job in self.machines:
            return [self.machines[job]]
        roles = (Role.DELIVERY, Role.TASK)
        return [a for v, a in self.activities.items() if v.what == job and v.role in roles]

    def _begins(self, job: str) -> list[Activity]:
        if job in self.machines:
            return [self.machines[job]]
        roles = (Role.PICKUP, Role.TASK)
        return [a for v, a in self.activities.items() if v.what == job and v.role in roles]

    def _after(self) -> None:
        for job in self.records.jobs:
            for earlier in job.after:
                if earlier in self.leaving:
                    self._only_with(job, earlier)
                for a, b in itertools.product(self._ends(earlier), self._begins(job.id)):
                    self.problem.add_constraint(LE(a.end, b.start), _present(a, b))

    def _only_with(self, job: Order | Task, earlier: str) -> None:
        """Where ``earlier`` is left out, ``job`` is, too."""
        skipped = Not(self.leaving[earlier].present)
        own = [self.leaving[job.id].present] if job.id in self.leaving else []
        self.problem.add_constraint(Or([skipped, *own]))

    def _priorities(self) -> None:
        """Who has a higher priority begins no later."""
        jobs = self.records.jobs
        levels = sorted({j.priority for j in jobs}, reverse=True)
        for high, low in itertools.pairwise(levels):
            firsts = [a for j in jobs if j.priority == high for a in self._begins(j.id)]
            others = [a for j in jobs if j.priority == low for a in self._begins(j.id)]
            for a, b in itertools.product(firsts, others):
                self.problem.add_constraint(LE(a.start, b.start), _present(a, b))

    def _one_at_a_time(self, who: str, activities: Sequence[Activity]) -> None:
        if len(activities) > 1:
            busy = self.problem.add_resource(f"busy{MARK}{who}", 1)
            for a in activities:
                a.uses(busy)


def _present(*activities: Activity) -> list[FNode]:
    return [a.present for a in activities if a.optional]
