"""How good is "without traffic"? A warehouse's jobs shared by OR-Tools' routing solver, which is
kept by others, on the drive times that our own assignment uses.

``python benchmarks/scale/yardstick.py [20x60 SEED SECONDS CHANGEOVER]`` prints the makespan of both
where robots heed each other at stations only: a station holds one robot, ``CHANGEOVER`` s pass from
when one may leave to when the next is there, and whoever does not stay at its last station drives
home. Ours gets ``SECONDS`` of computing, theirs as many by the clock. The bound knows of no
change-over.
"""

from __future__ import annotations

import math
import random
import sys
import time
from typing import Any
from unittest import mock

from ortools.constraint_solver import pywrapcp
from ortools.constraint_solver import routing_enums_pb2 as enums
from unified_planning.shortcuts import AnytimePlanner, get_environment

import up_samp  # noqa: F401  (registers the engines)
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.model import Deadline
from up_samp.model.deadline import computing_time
from up_samp.search.fleet.assignment import assign, exchanged
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.evaluator_kernel import CostWeights, WorkTables
from up_samp.search.fleet.solve import LargeProblem, guess_of
from up_samp.search.fleet_bound.bound import state_bounds
from up_samp.search.search import Search

TICKS = 10
"""A second: the routing solver counts in whole numbers."""
HORIZON = 1000 * TICKS


class Enough(BaseException):
    """Ends a solve whose problem is read."""


def opened(size: str, seed: int) -> tuple[Search, LargeProblem]:
    """Return a warehouse as the search for first plans sees it."""
    found: list[tuple[Search, LargeProblem]] = []

    def noted(search: Search, large: LargeProblem, _: Deadline) -> None:
        found.append((search, large))
        raise Enough

    robots, orders = map(int, size.split("x"))
    problem = warehouse(robots, orders, encoding="compact", seed=seed)
    get_environment().credits_stream = None
    with (
        mock.patch("up_samp.search.fleet.solve.deals_of", noted),
        AnytimePlanner(name="samp-refine[cpsat]", params={"seed": 0}) as engine,
    ):
        try:
            next(engine.get_solutions(problem))
        except Enough:
            return found[0]
    raise RuntimeError("the problem is not large")


class Routes:
    """The jobs of a warehouse as a routing problem. Each way to do a job is two nodes, where its
    load is taken and where it is given away; a node for each station is for the robot that stays
    there; then come the robots' starts, and the end.
    """

    def __init__(self, work: WorkTables) -> None:
        self.work, self.robots = work, len(work.start)
        names = [tuple(map(int, key)) for key in zip(work.of, work.entry, work.exit, strict=True)]
        self.ways = sorted(set(names))
        self.mode = {(self.ways.index(n), int(work.robot[o])): o for o, n in enumerate(names)}
        self.stay = 2 * len(self.ways)
        self.start = self.stay + int(work.place.max()) + 1
        self.end = self.start + self.robots

    def last(self, o: int) -> int:
        """Return the stop at which an option ends."""
        return int(self.work.head[o + 1]) - 1

    def seconds(self, r: int, a: int, b: int) -> float:
        """Return what a robot needs from arriving at one node to arriving at another."""
        work, many = self.work, len(self.ways)
        to = self.mode.get((b, r))
        if a >= self.start and to is not None:
            return float(work.rides[work.kind[r], work.start[r], work.entry[to]])
        if a >= self.stay:
            return 0.0 if b == self.end else math.inf
        o = self.mode.get((a % many, r))
        if o is None:
            return math.inf
        head, last = int(work.head[o]), self.last(o)
        if a < many:
            took = work.stays[head:last].sum() + work.drive[head : last + 1].sum()
            return float(took) if b == a + many else math.inf
        stay = float(work.stays[last])
        if to is not None:
            return stay + float(work.rides[work.kind[r], work.exit[o], work.entry[to]])
        if b == self.end:
            return stay + max(0.0, float(work.home[o]))
        return stay if b == self.stay + int(work.place[last]) else math.inf

    def solved(self, changeover: float, seconds: float) -> float:
        """Return the makespan (s) that the routing solver finds; ``inf``: none."""
        starts = list(range(self.start, self.end))
        ends = [self.end] * self.robots
        manager = pywrapcp.RoutingIndexManager(self.end + 1, self.robots, starts, ends)
        routing = pywrapcp.RoutingModel(manager)
        evaluators = [self._transit(routing, manager, r) for r in range(self.robots)]
        routing.AddDimensionWithVehicleTransits(evaluators, HORIZON, HORIZON, True, "time")
        for r, evaluator in enumerate(evaluators):
            routing.SetArcCostEvaluatorOfVehicle(evaluator, r)
        clock = routing.GetDimensionOrDie("time")
        clock.SetGlobalSpanCostCoefficient(1000)
        self._stations(routing, manager, clock, changeover)
        for r in range(self.robots):
            routing.AddVariableMinimizedByFinalizer(clock.CumulVar(routing.End(r)))
        asked = pywrapcp.DefaultRoutingSearchParameters()
        first, meta = enums.FirstSolutionStrategy, enums.LocalSearchMetaheuristic
        asked.first_solution_strategy = first.PARALLEL_CHEAPEST_INSERTION
        asked.local_search_metaheuristic = meta.GUIDED_LOCAL_SEARCH
        asked.time_limit.seconds = math.ceil(seconds)
        found = routing.SolveWithParameters(asked)
        if found is None:
            return math.inf
        return max(found.Value(clock.CumulVar(routing.End(r))) for r in range(self.robots)) / TICKS

    def _transit(self, routing: Any, manager: Any, r: int) -> int:
        def told(i: int, j: int) -> int:
            took = self.seconds(r, manager.IndexToNode(i), manager.IndexToNode(j))
            return 2 * HORIZON if math.isinf(took) else math.ceil(TICKS * took)

        return int(routing.RegisterTransitCallback(told))

    def _stations(self, routing: Any, manager: Any, clock: Any, changeover: float) -> None:
        """State that jobs are done once, in time, and one after the other at a station."""
        work, solver, many = self.work, routing.solver(), len(self.ways)
        held: dict[int, list[Any]] = {}
        for job in range(len(work.first) - 1):
            mine = [n for n, way in enumerate(self.ways) if way[0] == job]
            for shift in (0, many):
                routing.AddDisjunction([manager.NodeToIndex(n + shift) for n in mine], 10**9)
        for n in range(many):
            pick, drop = manager.NodeToIndex(n), manager.NodeToIndex(many + n)
            routing.AddPickupAndDelivery(pick, drop)
            solver.Add(routing.VehicleVar(pick) == routing.VehicleVar(drop))
            modes = {r: o for (way, r), o in self.mode.items() if way == n}
            routing.VehicleVar(pick).SetValues([-1, *modes])
            stay = max(math.ceil(TICKS * work.stays[self.last(o)]) for o in modes.values())
            due = min(work.due[o] for o in modes.values())
            if due < math.inf:
                clock.CumulVar(drop).SetMax(int(TICKS * due) - stay)
            rest = stay + math.ceil(TICKS * changeover), routing.ActiveVar(drop), f"way {n}"
            work_there = solver.FixedDurationIntervalVar(clock.CumulVar(drop), *rest)
            held.setdefault(int(work.place[self.last(min(modes.values()))]), []).append(work_there)
        for place in range(self.start - self.stay):
            node = manager.NodeToIndex(self.stay + place)
            routing.AddDisjunction([node], 0)
            rest = HORIZON, routing.ActiveVar(node), f"stay {place}"
            held.setdefault(place, []).append(
                solver.FixedDurationIntervalVar(clock.CumulVar(node), *rest)
            )
        for place, some in held.items():
            if place >= 0:
                solver.Add(solver.DisjunctiveConstraint(some, f"place {place}"))


def annealed(large: LargeProblem, evaluator: AssignmentEvaluator, seconds: float) -> float:
    """Return the least makespan (s) of our own assignments, made again and again."""
    rng, best, deadline = random.Random(0), math.inf, Deadline.after(seconds)
    found = assign(evaluator, deadline, rng, large.tuning)
    while not deadline.expired():
        ends = found.evaluator.ends(found.tours).values()
        best = min(best, max(end for end, _ in ends))
        found = exchanged(found, rng, deadline, share=0.3, warmth=0.1, another=True)
    return best


def main(
    size: str = "20x60", seed: str = "0", seconds: str = "60", changeover: str = "2.6"
) -> None:
    """Print a row."""
    with computing_time():
        search, large = opened(size, int(seed))
        rules = CostWeights(handover=float(changeover), steep=100.0)
        evaluator = AssignmentEvaluator(guess_of(search, large), large.jobs, rules)
        own = annealed(large, evaluator, float(seconds))
        state_bounds(search, large.problem, large.jobs, relative=True)
        began = time.process_time()
        theirs = Routes(evaluator.work()).solved(float(changeover), float(seconds))
        took, bound = time.process_time() - began, search.bounds.lower
    gap = f"{min(own, theirs) / bound - 1:.1%}"
    print("| warehouse, seed | ours | OR-Tools routing (CPU s) | relative bound | gap |")
    print("|---|---|---|---|---|")
    print(f"| {size}, {seed} | {own:.0f} | {theirs:.0f} ({took:.0f}) | {bound} | {gap} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
