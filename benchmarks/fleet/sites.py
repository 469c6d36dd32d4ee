"""Three sites, solved, beside what a routing solver finds where nobody is in anybody's way.

``python benchmarks/fleet/sites.py [SITE SECONDS]`` prints a row for each of ``hospital``,
``factory`` and ``nav2_warehouse`` (where ``NAV2_MAPS`` says in which folder its map lies): the
makespan of the best plan within ``SECONDS`` of computing, its bound, and the makespan that
OR-Tools' routing solver finds in as many seconds by the clock. It is told the drives' least
seconds, rides, services, capacities, breaks, batteries, orders' order and priorities; its robots
drive through each other, lifts take any number, and times are no whole units.
"""

from __future__ import annotations

import itertools
import math
import runpy
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from ortools.constraint_solver import pywrapcp
from ortools.constraint_solver import routing_enums_pb2 as enums
from unified_planning.shortcuts import AnytimePlanner, PlanValidator, get_environment

from up_samp import Fleet
from up_samp.fleet.batteries import Meter
from up_samp.fleet.floors import floor_of, legs_between, lift_between, ride_seconds
from up_samp.fleet.meanings import Kind
from up_samp.fleet.spelled_out import spelled_out
from up_samp.fleet.visits import Visit, visits_of
from up_samp.model.deadline import computing_time

EXAMPLES = Path(__file__).parents[2] / "examples"
SITES = ("hospital", "factory", "nav2_warehouse")
TICKS = 10
"""A second, or a metre: the routing solver counts in whole numbers."""
HORIZON = 3600 * TICKS
DONE = (Kind.PICKUP, Kind.DELIVERY, Kind.TASK, Kind.CHARGE)


def fleet_of(site: str, folder: Path) -> Fleet:
    """Return an example's fleet, all done as early as possible; its file goes to ``folder``."""
    example = EXAMPLES / f"{site}.py"
    names = runpy.run_path(str(example))
    file = names["fleet"].save(folder / "problem.yaml")
    data = yaml.safe_load(file.read_text(encoding="utf-8")) | {"objective": "makespan"}
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    return Fleet.from_file(file)


class Routes:
    """A fleet's jobs as a routing problem: nodes are what is done where, then starts, then ends."""

    def __init__(self, fleet: Fleet) -> None:
        self.records = spelled_out(fleet.records)
        self.meter = Meter(self.records, fleet.folder)
        self.robots = list(self.records.robots)
        self.visits = {r: visits_of(self.records, r) for r in self.robots}
        some = (v for r in self.robots for v in self.visits[r] if v.kind in DONE)
        every = ((v.kind, v.what, v.option, v.number, p) for v in some for p in v.places)
        self.nodes = list(dict.fromkeys(every))
        self.travel = cache(self._travel)
        count = len(self.nodes)
        starts = [count + k for k in range(len(self.robots))]
        ends = [count + len(self.robots) + k for k in range(len(self.robots))]
        self.manager = pywrapcp.RoutingIndexManager(ends[-1] + 1, len(starts), starts, ends)
        self.routing = pywrapcp.RoutingModel(self.manager)

    def place(self, r: int, node: int) -> str | None:
        """Return where a robot is at a node; None at an end that may be anywhere."""
        if node < len(self.nodes):
            return str(self.nodes[node][-1])
        mine = self.records.robots[self.robots[r]]
        return mine.start if node < len(self.nodes) + len(self.robots) else mine.end

    def _travel(self, robot: str, origin: str, to: str) -> tuple[float, float]:
        """Return the seconds and metres of the quickest way, rides with it."""
        ways = []
        for way in legs_between(self.records, origin, to) if origin != to else [()]:
            seconds = metres = 0.0
            for a, b in way:
                lift = lift_between(self.records, a, b)
                floors = floor_of(self.records, a), floor_of(self.records, b)
                ridden = (0.0, ride_seconds(self.records, lift, *floors)) if lift else None
                more, took = ridden or self.meter.length(robot, a, b)
                seconds, metres = seconds + took, metres + more
            ways.append((seconds, metres))
        return min(ways)

    def service(self, node: int) -> float:
        """Return how long something lasts (s)."""
        if node >= len(self.nodes):
            return 0.0
        kind, what, _, _, place = self.nodes[node]
        if kind is Kind.CHARGE:
            charger = self.records.places[place].charger
            return charger.step  # type: ignore[union-attr]
        if kind is Kind.TASK:
            return float(self.records.task_of[what].duration or 0.0)
        order = self.records.order_of[what]
        return float((order.pickup if kind is Kind.PICKUP else order.delivery).service)

    def given(self, node: int) -> float:
        """Return how many metres of a battery a node gives back."""
        kind, _, _, _, place = self.nodes[node]
        charger = self.records.places[place].charger if kind is Kind.CHARGE else None
        return 0.0 if charger is None else (charger.per_second or 0.0) * charger.step

    def cost(self, r: int, i: int, j: int, *, metres: bool) -> int:
        """Return the ticks from one node to another for a robot: of time, or of a battery."""
        a, b = self.manager.IndexToNode(i), self.manager.IndexToNode(j)
        here, there = self.place(r, a), self.place(r, b)
        way = self.travel(self.robots[r], here, there) if here and there else (0.0, 0.0)
        if metres:
            given = self.given(a) if a < len(self.nodes) else 0.0
            return math.floor(TICKS * (way[1] - given))
        return math.floor(TICKS * (self.service(a) + way[0]))

    def solved(self, seconds: float) -> float:
        """Return the makespan that the routing solver finds (s; ``inf``: none)."""
        told = [self._told(r, metres=False) for r in range(len(self.robots))]
        self.routing.AddDimensionWithVehicleTransits(told, HORIZON, HORIZON, True, "time")
        for r, number in enumerate(told):
            self.routing.SetArcCostEvaluatorOfVehicle(number, r)
        clock = self.routing.GetDimensionOrDie("time")
        clock.SetGlobalSpanCostCoefficient(1000)
        self._jobs(clock)
        self._breaks(clock)
        self._batteries()
        asked = pywrapcp.DefaultRoutingSearchParameters()
        asked.first_solution_strategy = enums.FirstSolutionStrategy.PARALLEL_CHEAPEST_INSERTION
        asked.local_search_metaheuristic = enums.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
        asked.time_limit.seconds = math.ceil(seconds)
        found = self.routing.SolveWithParameters(asked)
        if found is None:
            return math.inf
        last = range(len(self.robots))
        return max(found.Max(clock.CumulVar(self.routing.End(r))) for r in last) / TICKS

    def _told(self, r: int, *, metres: bool) -> int:
        def cost(i: int, j: int) -> int:
            return self.cost(r, i, j, metres=metres)

        return int(self.routing.RegisterTransitCallback(cost))

    def _of(self, kind: Kind, what: str) -> list[int]:
        return [
            self.manager.NodeToIndex(k)
            for k, node in enumerate(self.nodes)
            if node[:2] == (kind, what)
        ]

    def _able(self, kind: Kind, what: str) -> list[int]:
        found: Iterator[Visit] = itertools.chain(*self.visits.values())
        able = {v.robot for v in found if (v.kind, v.what) == (kind, what)}
        return [self.robots.index(r) for r in sorted(able)]

    def _jobs(self, clock: Any) -> None:
        """State that each job is done once, in order, by whom may, one load at a time."""
        solver, begins, ends = self.routing.solver(), {}, {}
        for job in self.records.jobs:
            halves = (Kind.PICKUP, Kind.DELIVERY) if job.id in self.records.order_of else None
            if halves is None:
                seats = self._of(Kind.TASK, job.id)
                for seat in seats:
                    self.routing.VehicleVar(seat).SetValues(self._able(Kind.TASK, job.id))
                    solver.Add(clock.CumulVar(seat) == clock.CumulVar(seats[0]))
                begins[job.id] = ends[job.id] = seats[0]
                continue
            (pick,), (drop,) = (self._of(kind, job.id) for kind in halves)
            self.routing.AddPickupAndDelivery(pick, drop)
            solver.Add(self.routing.VehicleVar(pick) == self.routing.VehicleVar(drop))
            self.routing.VehicleVar(pick).SetValues(self._able(Kind.PICKUP, job.id))
            begins[job.id], ends[job.id] = pick, drop
        for job in self.records.jobs:
            for earlier in job.after:
                over = clock.CumulVar(ends[earlier])
                lasts = TICKS * self.service(self.manager.IndexToNode(ends[earlier]))
                solver.Add(clock.CumulVar(begins[job.id]) >= over + int(lasts))
            for other in self.records.jobs:
                if other.priority < job.priority:
                    mine, later = begins[job.id], begins[other.id]
                    solver.Add(clock.CumulVar(mine) <= clock.CumulVar(later))
        loads = {n: 1 for o in self.records.order_of for n in self._of(Kind.PICKUP, o)}
        loads |= {n: -1 for o in self.records.order_of for n in self._of(Kind.DELIVERY, o)}
        taken = self.routing.RegisterUnaryTransitCallback(lambda i: loads.get(i, 0))
        self.routing.AddDimensionWithVehicleCapacity(taken, 0, [1] * len(self.robots), True, "load")

    def _breaks(self, clock: Any) -> None:
        lasts = [
            int(TICKS * self.service(self.manager.IndexToNode(i)))
            for i in range(self.routing.Size())
        ]
        solver = self.routing.solver()
        for r, name in enumerate(self.robots):
            some = []
            for rest in self.records.robots[name].breaks:
                ticks, (opens, closes) = int(TICKS * rest.duration), rest.window or (0, 3600)
                latest = int(TICKS * closes) - ticks
                some.append(
                    solver.FixedDurationIntervalVar(int(TICKS * opens), latest, ticks, False, "")
                )
                over = some[-1].SafeEndExpr(0)
                solver.Add(clock.CumulVar(self.routing.End(r)) >= over)  # no day ends before it
            if some:
                clock.SetBreakIntervalsOfVehicle(some, r, lasts)

    def _batteries(self) -> None:
        """What is taken of a battery never exceeds what it has above its reserve."""
        charges = [
            self.manager.NodeToIndex(k) for k, n in enumerate(self.nodes) if n[0] is Kind.CHARGE
        ]
        for node in charges:
            self.routing.AddDisjunction([node], 0)
        kinds = [self.records.robot_types[r.type] for r in self.records.robots.values()]
        if not charges or any(kind.battery is None for kind in kinds):
            return
        told = [self._told(r, metres=True) for r in range(len(self.robots))]
        slack = int(TICKS * max(self.given(self.manager.IndexToNode(i)) for i in charges))
        most = int(TICKS * max(k.battery.capacity - k.battery.reserve for k in kinds))  # type: ignore[union-attr]
        self.routing.AddDimensionWithVehicleTransits(told, slack, most, False, "taken")
        used = self.routing.GetDimensionOrDie("taken")
        for i in range(self.routing.Size()):
            if i not in charges:
                used.SlackVar(i).SetMax(0)
        for r, robot in enumerate(self.records.robots.values()):
            full = kinds[r].battery.capacity  # type: ignore[union-attr]
            level = full if robot.level is None else robot.level
            used.CumulVar(self.routing.Start(r)).SetValue(int(TICKS * (full - level)))


def measured(site: str, seconds: float) -> dict[str, float | None]:
    """Return a site's makespan (None: no valid plan), its bound, and the routing solver's (s)."""
    with tempfile.TemporaryDirectory() as folder, computing_time():
        fleet, plan, told = fleet_of(site, Path(folder)), None, {}
        get_environment().credits_stream = None
        with AnytimePlanner(name="samp-refine[cpsat]", params=fleet.settings) as engine:
            for result in engine.get_solutions(fleet.problem, timeout=seconds):
                plan, told = result.plan or plan, result.metrics or told
        with PlanValidator(name="samp-validator") as judge:
            valid = plan is not None and bool(judge.validate(fleet.problem, plan))
        theirs = Routes(fleet).solved(seconds)
    found = float(told["makespan"]) if valid else None
    return {"makespan": found, "bound": float(told["lower_bound"]), "without_traffic": theirs}


def main(only: str = "", seconds: str = "60") -> None:
    """Print the table."""
    print("| site | plan | bound | routing without traffic |")
    print("|---|---|---|---|")
    for site in (only,) if only else SITES:
        found = measured(site, float(seconds)).values()
        print(f"| {site} | {' | '.join('-' if x is None else f'{x:g}' for x in found)} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
