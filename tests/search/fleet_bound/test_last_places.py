"""Jobs assigned to robots that cannot all stay where they end, against all ways to assign them."""

import itertools
import random
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.usual import usually
from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.geometry import lay_out
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet_bound.bound import FinalOccupancy, _counted, final_occupancy, load_balance
from up_samp.search.fleet_bound.work import JobMode, JobWork
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.upio import read_problem
from up_samp.upio.write_relaxation import relax

HOME = "home"


def world(seed):
    """Return a fleet, jobs done at places where one robot may stay, and where robots begin. Who
    does not stay drives home.
    """
    rng = random.Random(seed)
    places = ["a", "b", "c"][: rng.choice([1, 2, 3])]
    kinds = [0, 0, 1, 1][: rng.choice([2, 3, 4])]
    far = {(k, p, q): rng.randint(1, 9) for k in (0, 1) for p in (*places, HOME) for q in places}
    far |= {(k, p, HOME): rng.randint(1, 20) for k in (0, 1) for p in places}
    ways = []
    for job, kind in itertools.product(range(rng.choice([2, 3, 4])), sorted(set(kinds))):
        goal, end = rng.choice(places), rng.choice(places)
        legs = ((kind, goal, end),) if goal != end else ()
        origins = frozenset((*places, HOME))
        busy, after = rng.randint(0, 5), frozenset[str]()
        ways.append(JobMode(job, kind, busy, legs, kind, goal, (end,), after, origins))
    starts = Counter((kind, HOME) for kind in kinds)
    sizes, length = Counter(kinds), lambda leg: far[leg] if leg[1] != leg[2] else 0
    work = SimpleNamespace(sizes=sizes, starts=starts, units=length)
    aways = {(k, p, None): ((k, p, HOME),) for k in set(kinds) for p in places}
    often = {away: sizes[away[0]] for away in aways}
    last = FinalOccupancy(frozenset(places), aways, often, everybody=True)
    return work, ways, kinds, last


def tours(work, ways, kind, jobs):
    """Yield when a robot that starts at home has done jobs in some order, and where it is then."""
    for order in itertools.permutations(jobs):
        total, here = 0, HOME
        for job in order:
            (way,) = (w for w in ways if (w.job, w.kind) == (job, kind))
            total += way.units(here, work.units)
            here = way.ends[-1]
        yield total, here


def ends(work, kinds, chosen):
    """Return the least makespan of tours of which one robot at most stays at a place."""
    at = {}
    for r, (_, here) in enumerate(chosen):
        if here != HOME:
            at.setdefault(here, []).append(r)
    totals = []
    for stays in itertools.product(*at.values()):
        driven = [
            total + (work.units((kinds[r], here, HOME)) if here != HOME and r not in stays else 0)
            for r, (total, here) in enumerate(chosen)
        ]
        totals.append(max(driven))
    return min(totals)


def best_of(work, ways, kinds):
    """Return the least makespan of all ways to assign the jobs."""
    jobs, best = sorted({w.job for w in ways}), None
    for whose in itertools.product(range(len(kinds)), repeat=len(jobs)):
        each = []
        for r, kind in enumerate(kinds):
            mine = [job for job, who in zip(jobs, whose, strict=True) if who == r]
            each.append(list(tours(work, ways, kind, mine)))
        for chosen in itertools.product(*each):
            then = ends(work, kinds, chosen)
            best = then if best is None else min(best, then)
    return best


def bound_of(work, ways, last):
    """Return what is proven, one bound after the other."""
    since = 0
    while True:
        bound, _ = load_balance(work, ways, {}, 60.0, last, since)
        found = max(since, int(-(-(bound - 1e-6) // 1)))
        if found == since:
            return since
        since = found


@pytest.mark.parametrize("first", usually(20, of=(0, 20)))
def test_no_way_to_share_jobs_and_to_stay_is_better_than_the_share(first):
    higher, shares = 0, []
    for seed in range(first, first + 20):
        work, ways, kinds, last = world(seed)
        best, bound = best_of(work, ways, kinds), bound_of(work, ways, last)
        without = bound_of(work, ways, FinalOccupancy())
        assert without <= bound <= best, seed
        higher += bound > without
        shares.append(bound / best)
    assert higher > 3
    assert sum(shares) / len(shares) > 0.45


def last_of(problem, **changed):
    """Return where one robot of a problem at most stays in the end.

    :param changed: of all drives.
    """
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)
    tasks = tuple(replace(task, **changed) for task in relaxation.snapshot.tasks)
    facts = Facts(replace(relaxation.snapshot, tasks=tasks), relaxation.choices)
    jobs, service = find_jobs(problem, snapshot), open_service(snapshot, grid, Parameters())
    work, counted = JobWork(problem, facts, service, jobs), _counted(jobs)
    return final_occupancy(work, facts.snapshot, service, work.ways(counted), (jobs, counted))


def test_one_robot_stays_at_a_station_and_the_others_drive_home():
    last = last_of(warehouse(4, 3, encoding="compact"))
    assert last.everybody
    assert last.places == {"station0", "station1"}
    assert last.aways
    assert {start for _, start, _ in last.aways} == last.places
    assert all(goal.startswith("dock") for _, _, goal in last.aways)


def test_robots_that_are_not_heeded_may_stay_together():
    problem = warehouse(4, 4, encoding="compact")
    some = frozenset(f"robot{r}" for r in range(3))
    assert not last_of(problem, static=some).places
    assert last_of(problem, static=some | {"robot3"}).places
