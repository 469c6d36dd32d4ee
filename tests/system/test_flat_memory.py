"""Memory stays flat over many solves in one process: what is remembered is bounded.

Unified Planning's environment keeps every expression, object and type for good; what is counted
here is what is ours.
"""

import gc
from collections import Counter

import pytest
from unified_planning.shortcuts import OneshotPlanner

import up_samp  # noqa: F401  (registers the engines)
from tests.fuzz.problems import SECONDS, build, random_case


def solve(seed, folder, engine="cpsat"):
    here = folder / f"{seed}"
    here.mkdir(exist_ok=True)
    problem = build(random_case(seed), here)
    with OneshotPlanner(
        name=f"samp-refine[{engine}]", params={"seconds_per_unit": SECONDS}
    ) as planner:
        planner.solve(problem, timeout=3.0)


def ours():
    """Return how many objects of this package's types there are."""
    gc.collect()
    names = (f"{type(o).__module__}.{type(o).__qualname__}" for o in gc.get_objects())
    return Counter(n for n in names if n.startswith("up_samp."))


def resident():
    """Return the memory of this process that is in use (MB)."""
    gc.collect()
    with open("/proc/self/status") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def test_nothing_of_a_solve_stays(tmp_path):
    seeds = (103, 104, 106)
    for seed in seeds:
        solve(seed, tmp_path)
    before = ours()
    for seed in seeds:
        solve(seed, tmp_path)
    grown = {name: n for name, n in (ours() - before).items() if n > 2}
    assert grown == {}


@pytest.mark.long
def test_memory_is_flat_over_two_hundred_solves(tmp_path):
    engines = ("cpsat", "aries", "aries-opt", "cpsat")
    seen, known = [], []
    for k in range(200):
        solve(k % 40, tmp_path, engines[k % 4])
        if k % 20 == 19:
            seen.append(resident())
            known.append(sum(ours().values()))
    # all problems were met once after 40: from 80 on nothing new is learned
    assert known[-1] <= 1.05 * known[3]
    assert seen[-1] - seen[3] < 25.0, seen
