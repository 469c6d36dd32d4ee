"""Both encodings of a problem have the same schedules, whichever reading of effects is taken."""

import random

import pytest
from schedule_oracle import holds

from up_samp.benchmarks import job_shop, logistics

SMALL = {
    "one robot": lambda e: logistics(1, 2, door="closed", sides="all", encoding=e),
    "corridor": lambda e: logistics(2, 2, door="closed", sides="corridor", encoding=e),
    "open": lambda e: logistics(2, 3, door="open", sides="all", encoding=e),
    "small shop": lambda e: job_shop(1, 2, 1, encoding=e),
    "shop": lambda e: job_shop(2, 2, 2, encoding=e),
}


def walk(problem, rng, patience=0.9):
    """Return a random schedule that has a fair chance to be right."""
    moves, stands = {}, {}
    routes = {}
    for a in problem.motion_activities:
        for c in a.motion_constraints:
            robot, origin, to = (str(x) for x in (c.movable, c.starting, c.waypoints[0]))
            moves.setdefault((robot, origin), []).append((a, to))
    starts = {str(m): str(c) for m, c in problem.initial_configuration}
    for a in problem.activities:
        if a.name.startswith(("pick", "op", "open")):
            stands[a.name] = a
    used, times, clock, at = set(), {}, {}, dict(starts)
    robots = [r for r in starts if r.startswith("r")]
    clock = {r: rng.randint(0, 2) for r in robots}

    def spend(robot, a):
        start = clock[robot] + (rng.randint(1, 3) if rng.random() < 0.97 else 0)
        low = a.duration.lower.constant_value()
        extra = 1 if rng.random() < 0.02 else 0
        slack = a.duration.upper.constant_value() - low + extra
        times[a.name] = (start, start + low + min(slack, rng.randint(0, 3) if slack else 0))
        clock[robot] = times[a.name][1]
        used.add(a.name)

    for _ in range(rng.randint(3, 14)):
        robot = min(robots, key=clock.get) if rng.random() < patience else rng.choice(robots)
        here = at[robot]
        todo = [s for n, s in stands.items() if n not in used and fits(n, robot, here)]
        if todo and rng.random() < 0.85:
            spend(robot, rng.choice(todo))
            continue
        exits = [(a, to) for a, to in moves.get((robot, here), ()) if a.name not in used]
        if exits:
            a, to = rng.choice(exits)
            spend(robot, a)
            at[robot] = to
    for robot in robots:
        home = [
            (a, to)
            for a, to in moves.get((robot, at[robot]), ())
            if to.startswith("depot") and a.name not in used
        ]
        if home and rng.random() < 0.9:
            spend(robot, home[0][0])
    return times, routes


def fits(name, robot, here):
    parts = name.split("_")
    if robot not in parts:
        return False
    if parts[0] == "pick":
        return here == f"item{parts[2][1:]}{parts[3]}"
    if parts[0] == "op":
        return here == f"machine{parts[2][1:]}"
    return here == "button" + parts[1][4:]


def mutate(times, rng):
    times = dict(times)
    names = sorted(times)
    kind = rng.randrange(4)
    if kind == 0 and names:
        del times[rng.choice(names)]
    elif kind == 1 and len(names) > 1:
        a, b = rng.sample(names, 2)
        sa, sb = times[a][0], times[b][0]
        times[a] = (sb, sb + times[a][1] - times[a][0])
        times[b] = (sa, sa + times[b][1] - times[b][0])
    elif kind == 2 and names:
        a = rng.choice(names)
        shift = rng.choice((-2, -1, 1, 2, 5))
        times[a] = (times[a][0] + shift, times[a][1] + shift)
    return times


def relaxed(problem):
    """Drop what says that everything must be done, so that random schedules often are right."""
    kept = [
        (c, s)
        for c, s in problem.base_scoped_constraints
        if not (c.is_present_exp() or (c.is_or() and all(x.is_present_exp() for x in c.args)))
    ]
    problem._base._constraints[:] = kept
    return problem


@pytest.mark.parametrize("case", SMALL)
def test_same_schedules(case):
    fluents, plain = (relaxed(SMALL[case](e)) for e in ("fluents", "no-fluents"))
    assert [a.name for a in fluents.activities] == [a.name for a in plain.activities]
    rng = random.Random(case)
    counts = {True: 0, False: 0}
    for _ in range(120):
        times, _ = walk(fluents, rng)
        for _ in range(rng.randint(0, 2)):
            times = mutate(times, rng)
        verdict = holds(plain, times)
        assert holds(fluents, times, "pddl") == verdict, times
        assert holds(fluents, times, "definition 3") == verdict, times
        counts[verdict] += 1
    assert min(counts.values()) >= 10, counts
