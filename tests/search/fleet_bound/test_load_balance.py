"""Jobs assigned as evenly as can be, against all ways to assign them."""

import itertools
import random
from collections import Counter
from types import SimpleNamespace

from up_samp.search.fleet_bound.bound import called, load_balance
from up_samp.search.fleet_bound.work import JobMode


def random_share(seed):
    """Return a fleet that does jobs, in drives of random lengths, and the ways to do them."""
    rng = random.Random(seed)
    places = ["a", "b", "c", "d"]
    kinds = [0, 0, 1][: rng.choice([1, 2, 3])]
    starts = Counter((kind, rng.choice(places)) for kind in kinds)
    far = {(kind, p, q): rng.randint(1, 9) for kind in (0, 1) for p in places for q in places}
    comings = {(kind, p): rng.randint(1, 12) for kind in (0, 1) for p in places}
    ways = []
    for job, kind in itertools.product(range(rng.choice([2, 3, 4])), sorted(set(kinds))):
        goal, end = rng.choice(places), rng.choice(places)
        legs = ((kind, goal, end),)
        busy, origins = rng.randint(0, 5), frozenset(places)
        after = frozenset({goal, end})
        ways.append(JobMode(job, kind, busy, legs, kind, goal, (goal, end), after, origins))
    work = SimpleNamespace(
        sizes=Counter(kinds),
        starts=starts,
        units=lambda leg: far[leg],
        comings={at: comings[at] for at in sorted(called(ways))},
    )
    robots = [(kind, place) for (kind, place), n in sorted(starts.items()) for _ in range(n)]
    return work, ways, robots


def tour(work, ways, jobs, robot):
    """Return the least time in which a robot does jobs in an order, with whatever detours."""
    kind, here = robot
    total, comings = 0, work.comings
    for job in jobs:
        way = next((w for w in ways if (w.job, w.kind) == (job, kind)), None)
        if way is None:
            return None
        straight = way.units(here, work.units)
        detour = min(comings[kind, p] + way.units(p, work.units) for p in "abcd")
        total += min(straight, detour)
        here = way.ends[-1]
    return total


def best_share(work, ways, robots):
    """Return the least makespan of all ways to assign the jobs."""
    jobs = sorted({w.job for w in ways})
    best = None
    for whose in itertools.product(range(len(robots)), repeat=len(jobs)):
        last = 0
        for r, robot in enumerate(robots):
            mine = [j for j, who in zip(jobs, whose, strict=True) if who == r]
            ends = [tour(work, ways, order, robot) for order in itertools.permutations(mine)]
            last = None if None in ends or last is None else max(last, min(ends))
        if last is not None:
            best = last if best is None else min(best, last)
    return best


def test_no_way_to_share_jobs_is_better_than_the_share():
    shares = []
    for seed in range(60):
        work, ways, robots = random_share(seed)
        (bound, legs) = load_balance(work, ways, work.comings, 60.0)
        best = best_share(work, ways, robots)
        assert bound <= best + 1e-6, seed
        assert legs
        shares.append(bound / best)
    assert sum(shares) / len(shares) > 0.6
