"""Who goes first wherever paths meet: what it takes, against cells looked at one by one; what is
decided, against all that could be; what is driven then, judged.
"""

import itertools
import math
import random
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.search.fleet.test_better_rounds import first_tours
from up_samp.model import Deadline
from up_samp.motion.fleet.conflicts import passing_gaps, runs_in
from up_samp.scheduling.partial_order.differences import Difference, Earliest
from up_samp.search.fleet.right_of_way import Crossings
from up_samp.validation import validate_plan

INF = math.inf


def held(rng, cells):
    """Return when cells are entered, from 0 s on, with rests before and after."""
    steps = np.cumsum([0.0, *(rng.uniform(0.2, 1.0) for _ in range(cells))])
    return np.array([-INF, *steps, INF])


def overlap(rows, a, b, shift):
    """Return whether two bodies that move are in conflicting cells at some instant, if the second
    one starts ``shift`` s after the first one.
    """
    return any(
        max(a[i], b[j] + shift) < min(a[i + 1], b[j + 1] + shift) - 1e-9
        for i, low, high in rows
        for j in range(low, high + 1)
    )


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), shift=st.floats(-12, 12))
def test_who_passes_all_obstacles_on_one_side_meets_nobody(seed, shift):
    rng = random.Random(seed)
    n, m = rng.randint(2, 8), rng.randint(2, 8)
    a, b = held(rng, n), held(rng, m)
    cells = np.zeros((n + 2, m + 2), dtype=bool)
    for _ in range(rng.randint(1, 3)):  # blocks among the cells that are driven
        i, j = sorted(rng.choices(range(1, n + 1), k=2)), sorted(rng.choices(range(1, m + 1), k=2))
        cells[i[0] : i[1] + 1, j[0] : j[1] + 1] = True
    rows = runs_in(cells)
    gaps = passing_gaps(rows, a, b, 3)
    passes = all(shift >= one[0, 0, 0] or -shift >= one[1, 0, 0] for one in gaps)
    if passes:
        assert not overlap(rows, a, b, shift)
    # a single block is passed wherever that is possible
    single = len({(low, high) for _, low, high in rows}) == 1 and len(gaps) == 1
    if single and not passes:
        assert overlap(rows, a, b, shift)
    assert np.all(gaps[:, :, 1, :] == -INF)
    assert np.all(gaps[:, :, :, 1] == -INF)


def test_a_rest_is_left_before_or_come_to_after():
    a, b = np.array([-INF, 0.0, 1.0, 2.0, INF]), np.array([-INF, 0.0, 1.0, 2.0, 3.0, INF])
    # cell 2 of the first one meets the second one's goal, cell 1 its start
    rows = np.array([[1, 0, 0], [2, 4, 4]])
    start, goal = passing_gaps(rows, a, b, 3)
    # before the other one came to its start, or after it has left it
    assert start[0, 0, 1] == 1.0
    assert start[1, 0, 0] == 0.0
    # before it comes to its goal, or after it has left that again
    assert goal[0, 0, 0] == 2.0 - 3.0
    assert goal[1, 1, 0] == -1.0
    # who rests heeds nobody, and is heeded by those who move and heed it
    assert len(passing_gaps(rows, a, b, 1)) == 2
    assert np.all(passing_gaps(rows, a, b, 2) == -INF)


def drawn(rng):
    """Return crossings of two or three robots that make two motions each, drawn at random."""
    chains = {f"r{k}": [f"r{k}m{i}" for i in range(2)] for k in range(rng.randint(2, 3))}
    names = [name for chain in chains.values() for name in chain]
    numbers, unit = itertools.count(), rng.choice((1.0, 0.4, 1 / 3, 0.01))  # s
    ways = {
        name: [
            SimpleNamespace(number=next(numbers), natural=SimpleNamespace(duration=d * unit))
            for d in rng.choices(range(2, 7), k=rng.choice((1, 1, 2)))
        ]
        for name in names
    }
    differences = [
        Difference(("end", one), ("start", other), rng.randint(0, 2))
        for one, other in chains.values()
    ]
    for name in names:
        least = round(min(way.natural.duration for way in ways[name]) / unit)
        differences.append(Difference(("start", name), ("end", name), least))
    known = {}

    def passing(one, path, other, there):
        key = path.number, there.number
        if key not in known:
            some = np.full((rng.choice((0, 1, 1)), 2, 2, 2), -INF)
            for gaps in some:
                gaps[0, 0, 0], gaps[1, 0, 0] = rng.randint(-4, 6), rng.randint(-4, 6)
                if rng.random() < 0.3:  # one of them rests where the other one comes by
                    gaps[1, 1, 0] = rng.randint(-4, 0)
            known[key] = some * unit
        return known[key]

    rng.shuffle(differences)
    listed = rng.sample(sorted(chains), len(chains))
    chains = {robot: chains[robot] for robot in listed}
    earliest = Earliest(rng.sample(names, len(names)), differences)
    optional = frozenset(c[-1] for c in chains.values() if rng.random() < 0.3)
    return Crossings(chains, ways, optional, differences, earliest.times, unit, passing, 60)


def soonest(asked, made, chosen, sides):
    """Return when all is over by longest ways, None where that has no end."""
    arcs = [(d.first, d.then, d.lag) for d in asked.differences]
    for name, way in chosen.items():
        arcs.append((("start", name), ("end", name), way.natural.duration / asked.unit))
    then = {a: b for chain in asked.chains.values() for a, b in itertools.pairwise(chain)}
    for (one, other), gaps in sides:
        for (leaves, comes), gap in np.ndenumerate(gaps):
            if gap == -INF:
                continue
            gone = then.get(one) if leaves else one
            if gone is None or gone not in made or comes:
                return None
            # ways and gaps last whole units here
            arcs.append((("start", gone), ("start", other), gap / asked.unit + 0.001))
    at = dict.fromkeys(asked.earliest, 0.0)
    for _ in range(len(at) + 2):
        before = dict(at)
        for first, second, lag in arcs:
            at[second] = max(at[second], at[first] + lag)
        for name in chosen:  # ends are whole units
            at["end", name] = math.ceil(at["end", name] - 1e-6)
        if at == before:
            return max(at["end", name] for name in made)
    return None


def best_of_all(asked):
    """Return the least makespan, of all ways, sides, and motions that may be left out."""
    names = [name for chain in asked.chains.values() for name in chain]
    best = INF
    for left in itertools.product(*(((), (n,)) for n in sorted(asked.optional))):
        made = {name for name in names if (name,) not in left}
        order = sorted(made)
        for ways in itertools.product(*(asked.ways[name] for name in order)):
            chosen = dict(zip(order, ways, strict=True))
            meet = []
            for one, other in itertools.combinations(asked.chains.values(), 2):
                for a, b in itertools.product(one, other):
                    if a in made and b in made:
                        some = asked.passing(a, chosen[a], b, chosen[b])
                        meet += [(((a, b), g[0]), ((b, a), g[1])) for g in some]
            for sides in itertools.product(*meet):
                found = soonest(asked, made, chosen, sides)
                best = min(best, INF if found is None else found)
    return best


def test_what_is_decided_is_the_best_of_all():
    rng, compared = random.Random(0), 0
    while compared < 25:
        asked = drawn(rng)
        rows = [
            len(asked.passing(a, p, b, q))
            for one, other in itertools.combinations(asked.chains.values(), 2)
            for a, b in itertools.product(one, other)
            for p, q in itertools.product(asked.ways[a], asked.ways[b])
        ]
        if sum(rows) > 9:
            continue
        compared += 1
        driven = asked.decide({}, Deadline.never())
        least = best_of_all(asked)
        if driven is None:
            assert least == INF
            continue
        last = max(start + way.natural.duration for way, start in driven.values()) / asked.unit
        # passings are a little further apart than they have to be, for each of them in a row
        assert least <= math.ceil(last - 1e-3) <= least + 1
        assert asked.optional | driven.keys() == asked.ways.keys()
        # with as little time as there may be, most of them cannot meet any more
        tight = replace(asked, limit=int(least) + 1).decide({}, Deadline.never())
        assert tight is not None
        assert replace(asked, limit=int(least) - 1).decide({}, Deadline.never()) is None


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_what_is_decided_at_once_is_a_plan(seed):
    problem, (tours, first), build, _ = first_tours((4, 8), seed)
    # nobody waits on its way, so it may take longer than the first tours
    limit = math.ceil(1.2 * first.lean().makespan)
    found = tours.coordinated(first.driven(), limit, Deadline.never())
    assert found is not None
    assert found.lean().makespan <= limit
    whole = build(found.lean(), found.trajectories())
    assert validate_plan(problem, whole).violations == ()
    # followed again it is no later, and it is the same whatever was done before
    again = tours.follow(found.driven())
    assert again is not None
    assert again.lean().makespan <= found.lean().makespan
    assert tours.coordinated(first.driven(), limit, Deadline.never()).ends() == found.ends()


def test_nothing_is_found_where_there_is_no_time():
    _, (tours, first), _, _ = first_tours((3, 6))
    assert tours.coordinated(first.driven(), first.lean().makespan // 2, Deadline.never()) is None
