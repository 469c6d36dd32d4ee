"""Random problems with few robots, and with loads of all sorts: thousands of them are solved soon.

Floors, bodies and styles are those of :mod:`tests.fuzz.wide`.
"""

from __future__ import annotations

import random
from dataclasses import replace

from tests.fuzz.cases import Case, Load, Robot
from tests.fuzz.wide import wide_case

ROBOTS = (1,) * 13 + (2,) * 5 + (3,) * 2
JOBS = 2
"""For each robot at most."""


def small_case(seed: int, maps: tuple[str, ...] = ()) -> Case:
    """Return the problem of a seed: one to three robots, one to two jobs each."""
    rng = random.Random(f"small {seed}")
    case = wide_case(rng.randrange(1 << 40), maps)
    robots = tuple(
        replace(r, goals=r.goals[-JOBS:] if _leads_on(r) else r.goals[-1:])
        for r in case.robots[: rng.choice(ROBOTS)]
    )
    names = {r.name for r in robots}
    case = replace(
        case,
        seed=seed,
        robots=robots,
        idle=tuple(n for n in case.idle if n in names),
        loads=(),
    )
    if rng.random() < 0.7:
        return case
    return _relay(rng, case) or replace(case, loads=random_loads(rng, case))


def _leads_on(robot: Robot) -> bool:
    """Whether the last two jobs are not where the robot is at first."""
    return robot.start not in {p for goals in robot.goals[-JOBS:] for p in goals}


def random_loads(rng: random.Random, case: Case) -> tuple[Load, ...]:
    """Return a load for some robot: on one job or several.

    The first carrier takes it from where it is sure to be then; loads of bicycles and flyers are
    left out, as the package refuses these by name.
    """
    able = [r for r in case.robots if r.moves not in ("bicycle", "flyer")]
    if not able:
        return ()
    robot = rng.choice(able)
    jobs = [j for j in range(len(robot.goals)) if j == 0 or len(robot.goals[j - 1]) == 1]
    first = rng.choice(jobs)
    last = rng.choice(range(first, len(robot.goals)))
    carried = [(robot.name, job) for job in range(first, last + 1)]
    side = rng.choice(("ahead", "ahead", "left", "on"))
    turned = side != "on" and rng.random() < 0.2
    return (Load(f"load_{robot.name}", tuple(carried), robot.shape, side, turned),)


def _relay(rng: random.Random, case: Case) -> Case | None:
    """Return a case in which one robot brings a load and the next one takes it on, or None."""
    able = [r for r in case.robots if r.moves not in ("bicycle", "flyer")]
    free = [p for p in case.floor.places if all(p != r.start for r in case.robots)]
    if len(able) < 2 or len(free) < 3 or rng.random() < 0.4:
        return None
    one, other = rng.sample(able, 2)
    meeting, *ends = rng.sample(free, 3)
    robots = []
    for robot in case.robots:
        if robot in (one, other):
            end = ends[robot is other]
            robots.append(replace(robot, goals=((meeting,), (end,))))
        else:
            robots.append(robot)
    carried = ((one.name, 0), (other.name, 1))
    side = rng.choice(("ahead", "left", "on"))
    turned = side != "on" and rng.random() < 0.2
    load = Load(f"load_{one.name}", carried, one.shape, side, turned)
    return replace(case, robots=tuple(robots), loads=(load,))
