"""Classic job-shop data with known optima, flexible shops and transports, as UP problems."""

from __future__ import annotations

import random
from typing import Any

from unified_planning.model import Fluent, Object, TimePointInterval
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.timing import GlobalEndTiming
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Not,
    Or,
    UserType,
)

FT06 = """
2 1 0 3 1 6 3 7 5 3 4 6
1 8 2 5 4 10 5 10 0 10 3 4
2 5 3 4 5 8 0 9 1 1 4 7
1 5 0 5 2 5 3 3 4 8 5 9
2 9 1 3 4 5 5 4 0 3 3 1
1 3 3 3 5 9 0 10 4 4 2 1
"""
FT10 = """
0 29 1 78 2 9 3 36 4 49 5 11 6 62 7 56 8 44 9 21
0 43 2 90 4 75 9 11 3 69 1 28 6 46 5 46 7 72 8 30
1 91 0 85 3 39 2 74 8 90 5 10 7 12 6 89 9 45 4 33
1 81 2 95 0 71 4 99 6 9 8 52 7 85 3 98 9 22 5 43
2 14 0 6 1 22 5 61 3 26 4 69 8 21 7 49 9 72 6 53
2 84 1 2 5 52 3 95 8 48 9 72 0 47 6 65 4 6 7 25
1 46 0 37 3 61 2 13 6 32 5 21 9 32 8 89 7 30 4 55
2 31 0 86 1 46 5 74 4 32 6 88 8 19 9 48 7 36 3 79
0 76 1 69 3 76 5 51 2 85 9 11 6 40 7 89 4 26 8 74
1 85 0 13 2 61 6 7 8 64 9 76 5 47 3 52 4 90 7 45
"""
LA01 = """
1 21 0 53 4 95 3 55 2 34
0 21 3 52 4 16 2 26 1 71
3 39 4 98 1 42 2 31 0 12
1 77 0 55 4 79 2 66 3 77
0 83 3 34 2 64 1 19 4 37
1 54 2 43 4 79 0 92 3 62
3 69 4 77 1 87 2 87 0 93
2 38 0 60 1 41 3 24 4 83
3 17 1 49 4 25 0 44 2 98
4 77 3 79 2 43 1 75 0 96
"""
LA02 = """
0 20 3 87 1 31 4 76 2 17
4 25 2 32 0 24 1 18 3 81
1 72 2 23 4 28 0 58 3 99
2 86 1 76 4 97 0 45 3 90
4 27 0 42 3 48 2 17 1 46
1 67 0 98 4 48 3 27 2 62
4 28 1 12 3 19 0 80 2 50
1 63 0 94 2 98 3 50 4 80
4 14 0 75 2 50 1 41 3 55
4 72 2 18 1 37 3 79 0 61
"""
LA05 = """
1 72 0 87 4 95 2 66 3 60
4 5 3 35 0 48 2 39 1 54
1 46 3 20 2 21 0 97 4 55
0 59 3 19 4 46 1 34 2 37
4 23 2 73 3 25 1 24 0 28
3 28 0 45 4 5 1 78 2 83
0 53 3 71 1 37 4 29 2 12
4 12 2 87 3 33 1 55 0 38
2 49 3 83 1 40 0 48 4 7
2 65 3 17 0 90 4 27 1 23
"""
Jobs = list[list[tuple[int, int]]]
"""``jobs[j]`` is a list of (machine, duration)."""


def parse(text: str) -> Jobs:
    """Read lines of machine-duration pairs."""
    jobs = []
    for line in text.strip().splitlines():
        numbers = [int(x) for x in line.split()]
        jobs.append(list(zip(numbers[::2], numbers[1::2], strict=True)))
    return jobs


def taillard(jobs: int, machines: int, time_seed: int, machine_seed: int) -> Jobs:
    """Return a job shop of Taillard, "Benchmarks for basic scheduling problems", 1993."""
    times = _Taillard(time_seed)
    durations = [[times.draw(1, 99) for _ in range(machines)] for _ in range(jobs)]
    order = _Taillard(machine_seed)
    shop = []
    for row in durations:
        route = list(range(machines))
        for i in range(machines):
            j = order.draw(i, machines - 1)
            route[i], route[j] = route[j], route[i]
        shop.append(list(zip(route, row, strict=True)))
    return shop


class _Taillard:
    """Taillard's portable linear congruential generator."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def draw(self, low: int, high: int) -> int:
        k = self.seed // 127773
        self.seed = 16807 * (self.seed % 127773) - k * 2836
        if self.seed < 0:
            self.seed += 2147483647
        return low + int(self.seed / 2147483647 * (high - low + 1))


SHOPS: dict[str, tuple[Jobs, int]] = {
    "ft06": (parse(FT06), 55),
    "la01": (parse(LA01), 666),
    "la02": (parse(LA02), 655),
    "la05": (parse(LA05), 593),
    "ft10": (parse(FT10), 930),
    "ta01": (taillard(15, 15, 840612802, 398197754), 1231),
}
"""Name -> (jobs, optimal makespan)."""


def job_shop(name: str, uses: bool = True) -> SchedulingProblem:
    """Return a classic job shop, machines as unit resources or as pairwise disjunctions."""
    jobs, _ = SHOPS[name]
    problem = SchedulingProblem(name)
    machines = 1 + max(m for job in jobs for m, _ in job)
    resources = [problem.add_resource(f"m{m}", 1) for m in range(machines)] if uses else []
    on: list[list[Any]] = [[] for _ in range(machines)]
    for j, job in enumerate(jobs):
        before = None
        for k, (machine, duration) in enumerate(job):
            a = problem.add_activity(f"o{j}_{k}", duration)
            if uses:
                a.uses(resources[machine])
            for b in () if uses else on[machine]:
                problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)))
            on[machine].append(a)
            if before is not None:
                problem.add_constraint(LE(before.end, a.start))
            before = a
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def flexible_shop(jobs: int, operations: int, machines: int, seed: int) -> SchedulingProblem:
    """Return a flexible job shop: each operation on one of three machines (optional activities)."""
    rng = random.Random(f"flexible-{jobs}-{operations}-{machines}-{seed}")
    problem = SchedulingProblem(f"flexible-{jobs}x{operations}x{machines}-{seed}")
    on: list[list[Any]] = [[] for _ in range(machines)]
    for j in range(jobs):
        previous: list[Any] = []
        for k in range(operations):
            choices = []
            for m in sorted(rng.sample(range(machines), min(3, machines))):
                a = problem.add_activity(f"o{j}_{k}_{m}", rng.randint(2, 12), optional=True)
                for b in on[m]:
                    apart = Or(LE(a.end, b.start), LE(b.end, a.start))
                    problem.add_constraint(apart, scope=[a.present, b.present])
                on[m].append(a)
                for b in previous:
                    problem.add_constraint(LE(b.end, a.start), scope=[a.present, b.present])
                choices.append(a)
            problem.add_constraint(Or(a.present for a in choices))
            for i, a in enumerate(choices):
                for b in choices[:i]:
                    problem.add_constraint(Not(And(a.present, b.present)))
            previous = choices
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def transport(robots: int, items: int, seed: int) -> SchedulingProblem:
    """Return a transport with fluents: robots fetch items from shelves and bring them home."""
    rng = random.Random(f"transport-{robots}-{items}-{seed}")
    problem = SchedulingProblem(f"transport-{robots}-{items}-{seed}")
    place = UserType("place")
    homes = [Object(f"home{r}", place) for r in range(robots)]
    shelves = [Object(f"shelf{i}", place) for i in range(items)]
    problem.add_objects([*homes, *shelves])
    spots = {o: (rng.randint(0, 30), rng.randint(0, 20)) for o in [*homes, *shelves]}
    picks: list[list[Any]] = [[] for _ in range(items)]
    end = TimePointInterval(GlobalEndTiming())
    for r in range(robots):
        at = problem.add_fluent(f"at{r}", place, default_initial_value=homes[r])
        hands = problem.add_fluent(f"free{r}", BoolType(), default_initial_value=True)
        busy: list[Any] = []
        for i, shelf in enumerate(shelves):
            (x, y), (u, v) = spots[homes[r]], spots[shelf]
            length = abs(x - u) + abs(y - v) + 1
            out = _move(problem, f"out{r}_{i}", length, at, homes[r], shelf)
            back = _move(problem, f"back{r}_{i}", length, at, shelf, homes[r])
            back.add_effect(back.end, hands, True)
            pick = problem.add_activity(f"pick{r}_{i}", 2, optional=True)
            pick.add_condition(pick.start, Equals(at, shelf))
            pick.add_condition(pick.start, hands)
            pick.add_effect(pick.end, hands, False)
            picks[i].append(pick)
            busy += [out, back, pick]
        problem.add_condition(end, Equals(at, homes[r]))
        for k, a in enumerate(busy):
            for b in busy[:k]:
                apart = Or(LT(a.end, b.start), LT(b.end, a.start))
                problem.add_constraint(apart, scope=[a.present, b.present])
    for choices in picks:
        problem.add_constraint(Or(a.present for a in choices))
        for i, a in enumerate(choices):
            for b in choices[:i]:
                problem.add_constraint(Not(And(a.present, b.present)))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def _move(problem: Any, name: str, length: int, at: Fluent, origin: Any, to: Any) -> Any:
    a = problem.add_activity(name, length, optional=True)
    a.add_condition(a.start, Equals(at, origin))
    a.add_effect(a.end, at, to)
    return a
