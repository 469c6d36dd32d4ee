"""Activities at places: pickups, deliveries, tasks, doors, charging, machines, breaks; shifts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, And, Equals, Or

from up_samp.fleet.batteries import pieces_of, usable
from up_samp.fleet.fields import Windows
from up_samp.fleet.meanings import (
    Kind,
    Meaning,
    ends_before,
    only_with,
)
from up_samp.fleet.records import Break, Stop, Task, seats_of
from up_samp.fleet.site import Site
from up_samp.fleet.visits import ENDS, WORK, Visit, visits_of
from up_samp.upio.expressions import at_start, present, whole


class Work:
    """Activities at places, each optional: which robot does what where is decided later.

    ``busy`` holds for each robot what only it can do, one at a time; drives join them.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._records = site.records
        self.visits = {r: visits_of(self._records, r) for r in self._records.robots}
        self.activities: dict[Visit, Activity] = {}
        self.machines: dict[str, dict[str, Activity]] = {}
        self.closings: list[tuple[str, Activity, Activity, int]] = []
        """Doors that are opened, and close by themselves so many units later."""
        self.busy: dict[str, list[Activity]] = {r: [] for r in self._records.robots}
        self.users: dict[str, list[Activity]] = {}
        """By resource."""
        for visits in self.visits.values():
            for visit in visits:
                if visit.kind is Kind.CHARGE:
                    self._charge(visit)
                elif visit.kind in WORK:
                    self._work(visit)
        for robot, mine in self._records.robots.items():
            for number, rest in enumerate(mine.breaks, 1):
                self._rest(robot, number, rest)
        for task in self._records.tasks:
            if not task.at:
                self._machine(task)

    def limit_shifts(self) -> None:
        """State that robots do nothing and drive nowhere outside their shifts: once all that they
        may do is there.
        """
        for robot, mine in self._records.robots.items():
            shift = tuple(filter(None, (mine.shift,)))
            for a in self.busy[robot]:
                self._limit(a, shift, ())

    def of(self, what: str, kind: Kind, option: str | None = None) -> list[Activity]:
        """Return the activities of a kind of a job, one for each robot that may do it: of one
        option, or (None) of all.
        """
        mine = [v for v in self.activities if (v.what, v.kind) == (what, kind)]
        return [self.activities[v] for v in mine if option in (None, v.option)]

    def sides(self, robot: str, order: str) -> tuple[list[Activity], list[Activity]]:
        """Return a robot's pickups and deliveries of an order: one of each happens, or none."""
        mine = [v for v in self.visits[robot] if v.what == order]
        picks, delivers = ([self.activities[v] for v in mine if v.kind is kind] for kind in ENDS)
        return picks, delivers

    def seats(self, task: Task) -> list[list[Activity]]:
        """Return the activities of a task, seat by seat: one of each does it."""
        return [self.of(task.id, Kind.TASK, seat) for seat in seats_of(task)]

    def begins(self, job: str) -> list[Activity]:
        """Return the activities of which one begins a job."""
        if job in self.machines:
            return list(self.machines[job].values())
        order = self._records.order_of.get(job)
        on_board = order is not None and order.pickup.on is not None
        return self._led(job, Kind.DELIVERY if on_board else Kind.PICKUP)

    def ends(self, job: str) -> list[Activity]:
        """Return the activities of which one ends a job."""
        if job in self.machines:
            return list(self.machines[job].values())
        return self._led(job, Kind.DELIVERY)

    def _led(self, job: str, kind: Kind) -> list[Activity]:
        """Return an order's activities of a kind, or those of a task: of a crew, which begins and
        ends together, those of its first seat.
        """
        task = self._records.task_of.get(job)
        return self.of(job, kind) if task is None else self.seats(task)[0]

    def _work(self, visit: Visit) -> None:
        """Add what a robot does at one of a visit's places."""
        site = self._site
        length, windows, resources = self._figures(visit)
        units = site.up(length)
        name = site.fresh(visit.name, meaning_of(visit))
        if visit.kind is Kind.OPEN:
            a: Any = site.problem.add_motion_activity(name, units, optional=True)
            state = site.at[visit.what]
            a.add_condition(at_start(a), Equals(state, site.spots[f"{visit.what}.closed"]))
            self._swing(a, visit.what, "open")
            self._shut(visit, a)
        else:
            a = site.problem.add_activity(name, duration=units, optional=True)
        here = [Equals(site.at[visit.robot], site.spots[p]) for p in visit.places]
        a.add_condition(whole(a), here[0] if len(here) == 1 else Or(here))
        self._limit(a, windows, resources)
        self.activities[visit] = a
        self.busy[visit.robot].append(a)

    def _shut(self, visit: Visit, opening: Activity) -> None:
        """Let a door close by itself, so long after it has been opened."""
        site, problem = self._site, self._site.problem
        door = self._records.doors[visit.what]
        if door.closes is None:
            return
        meaning = Meaning(Kind.CLOSE, visit.what)
        name = site.fresh(visit.name.replace(Kind.OPEN.value, "close", 1), meaning)
        a: Any = problem.add_motion_activity(name, site.up(door.closes), optional=True)
        only_with(problem, a, opening)
        problem.add_constraint(Equals(opening.end, a.start), present(opening, a))
        self._swing(a, visit.what, "closed")
        self.closings.append((visit.what, opening, a, site.up(door.closes)))

    def _swing(self, a: Any, door: str, state: str) -> None:
        """Move a door's leaves to where they are open, or closed."""
        for leaf in self._site.doors[door]:
            a.add_motion_effect(leaf, self._site.places[f"{leaf.name}.{state}"])
        a.add_effect(a.end, self._site.at[door], self._site.spots[f"{door}.{state}"])

    def _charge(self, visit: Visit) -> None:
        """Add the steps of a visit to a charger: one after the other, as many as are wanted; or the
        one in which the battery is swapped.
        """
        site, problem = self._site, self._site.problem
        battery = site.records.kind_of(visit.robot).battery
        charger = self._records.places[visit.what].charger
        assert battery is not None
        assert charger is not None
        level, at = site.batteries[visit.robot], site.at[visit.robot]

        def step(number: int, seconds: float) -> Activity:
            name = site.fresh(f"{visit.name}_{number}", meaning_of(visit))
            a = problem.add_activity(name, site.up(seconds), optional=True)
            a.add_condition(whole(a), Equals(at, site.spots[visit.what]))
            self.busy[visit.robot].append(a)
            return a

        if charger.swap is not None:
            a = step(1, charger.swap)
            a.add_effect(a.end - 1, level, usable(battery))
        before: Activity | None = None
        number = 0
        for piece in pieces_of(battery, charger):
            for time in range(piece.times):
                number += 1
                a = step(number, charger.step)
                if piece.top < usable(battery):  # above it this would be too quick
                    a.add_condition(at_start(a), LE(level, piece.top - piece.gives))
                # A unit early: with a drive that starts at its end, the two would add up, and a
                # step too much for a full battery would still be driven with.
                a.add_increase_effect(a.end - 1, level, piece.gives)
                if before is not None:
                    if time:  # a battery that is full enough begins with a slower piece
                        only_with(problem, a, before)
                    ends_before(problem, before, a)
                before = a

    def _rest(self, robot: str, number: int, rest: Break) -> None:
        """Add a break: the robot stands wherever it is."""
        name = self._site.fresh(f"break_{robot}_{number}", Meaning(Kind.BREAK, "", robot))
        a = self._site.problem.add_activity(name, self._site.up(rest.duration))
        self._limit(a, (rest.window,), ())
        self.busy[robot].append(a)

    def _machine(self, task: Task) -> None:
        """Add what no robot does."""
        problem, modes = self._site.problem, task.modes
        ways = [(name, m.duration, m.resources) for name, m in modes.items()]
        if task.duration is not None:
            ways = [("", task.duration, ())]
        self.machines[task.id] = {}
        for mode, duration, resources in ways:
            name = f"{task.id}_{mode}" if mode else task.id
            name = self._site.fresh(name, Meaning(Kind.TASK, task.id))
            optional = task.optional or bool(mode)
            a = problem.add_activity(name, self._site.up(duration), optional=optional)
            self._limit(a, task.window, (*task.resources, *resources))
            self.machines[task.id][mode] = a

    def _figures(self, visit: Visit) -> tuple[float, Windows, tuple[str, ...]]:
        """Return how long a visit lasts (s), its windows and its resources."""
        match visit.kind:
            case Kind.OPEN:
                return self._records.doors[visit.what].seconds, (), ()
            case Kind.TASK:
                task = self._records.task_of[visit.what]
                assert task.duration is not None
                first = visit.option in ("", task.at[0])  # a crew takes them once
                return task.duration, task.window, task.resources if first else ()
            case Kind.PICKUP:
                stop: Stop = self._records.order_of[visit.what].pickup
            case _:
                stop = self._records.order_of[visit.what].delivery
        return stop.service, stop.window, stop.resources

    def _limit(self, a: Activity, windows: Windows, resources: Iterable[str]) -> None:
        spans = [(self._site.up(w[0]) if w[0] else 0, self._site.down(w[1])) for w in windows]
        if spans:
            a.add_release_date(min(opens for opens, _ in spans))
            a.add_deadline(max(closes for _, closes in spans))
        if len(spans) > 1:
            within = [And(GE(a.start, opens), LE(a.end, closes)) for opens, closes in spans]
            self._site.problem.add_constraint(Or(within), present(a))
        for resource in resources:
            a.uses(self._site.resources[resource])
            self.users.setdefault(resource, []).append(a)


def meaning_of(visit: Visit) -> Meaning:
    """Return what the activities of a visit stand for."""
    return Meaning(visit.kind, visit.what, visit.robot)
