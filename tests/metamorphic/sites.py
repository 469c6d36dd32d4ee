"""Small sites with floors: what is meant by a problem, before it is written in any style.

A :class:`MotionSite` is a :class:`~tests.scheduling.cpsat.sites.Site` whose places are poses on a
floor and whose doors are leaves on it. Lengths of roads are not said: the motions tell them.
"""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass, field

from tests.scheduling.cpsat.sites import Site, Task
from up_samp.benchmarks.places import RESOLUTION, Rectangle, draw
from up_samp.geometry import write_map

Pose = tuple[float, float, float]
"""``(x, y, theta)``: m, m, rad, world frame."""

UP = math.pi / 2
ROBOT = ((-0.4, -0.25), (0.4, -0.25), (0.4, 0.25), (-0.4, 0.25))
GAP = 1.4
"""Width of a doorway, m; its leaf is 0.2 m longer and slides along the wall."""
THICK = 0.2


@dataclass(frozen=True)
class Floor:
    """``poses[place]`` and ``leaves[place]``: where the leaf of its door is, shut and open."""

    size: tuple[float, float]
    walls: tuple[Rectangle, ...]
    poses: dict[int, Pose]
    leaves: dict[int, tuple[Pose, Pose]] = field(default_factory=dict)

    def write(self, folder, name: str):
        """Write the map into ``folder``; return its YAML file."""
        return write_map(folder, name, draw(self.size, self.walls), RESOLUTION)


@dataclass(frozen=True)
class MotionSite(Site):
    """A site on a floor.

    ``only[task]`` names the robots that may do it. One robot does all tasks of a team, in their
    order. Of each load (the first of a pair of tasks) and its unload, one robot does both and no
    other load in between. ``prepared`` unloads happen within a preparation (see ``PREPARE``); those
    are made one at a time.
    """

    name: str = ""
    floor: Floor = field(default_factory=lambda: Floor((1, 1), (), {}))
    only: dict[int, tuple[int, ...]] = field(default_factory=dict)
    teams: tuple[tuple[int, ...], ...] = ()
    carried: tuple[tuple[int, int], ...] = ()
    prepared: tuple[int, ...] = ()


PREPARE = (12, 4, 10)
"""Units that a preparation takes; a prepared task is done between these units after its start."""


def _hall(width: float, height: float, walls: list[Rectangle]) -> tuple[Rectangle, ...]:
    edge = 0.2
    outer = [
        (0.0, 0.0, width, edge),
        (0.0, height - edge, width, height),
        (0.0, 0.0, edge, height),
        (width - edge, 0.0, width, height),
    ]
    return (*outer, *walls)


def _doorway(left: float, right: float, x: float, y: float) -> list[Rectangle]:
    """Return a wall from ``left`` to ``right`` at height ``y`` with a doorway around ``x``."""
    low, high = y - THICK / 2, y + THICK / 2
    return [(left, low, x - GAP / 2, high), (x + GAP / 2, low, right, high)]


def _roads(places) -> dict[tuple[int, int], int]:
    return dict.fromkeys(itertools.permutations(places, 2), 1)


def shop(seed: int, robots: int = 2, jobs: int = 2, machines: int = 1) -> MotionSite:
    """Return a job shop: each machine in a room behind a door, buttons in the hall."""
    rng = random.Random(f"shop-{seed}")
    walls, poses, leaves = [], {}, {}
    for m in range(machines):
        left = 6.0 * m
        walls += _doorway(left, left + 6, left + 3, 6.0)
        if m:
            walls.append((left - 0.1, 6.0, left + 0.1, 9.0))
        poses[m] = (left + rng.choice((2.0, 3.0, 4.0)), 7.6, UP)
        poses[machines + m] = (left + 1.2, 4.9, UP)
        leaves[m] = ((left + 3, 5.8, 0.0), (left + 4.6, 5.8, 0.0))
    starts = tuple(range(2 * machines, 2 * machines + robots))
    for k, start in enumerate(starts):
        poses[start] = (1.5 + 1.5 * k, rng.choice((1.2, 2.2)), UP)
    tasks: list[Task] = []
    for _ in range(jobs):
        for i, m in enumerate(rng.sample(range(machines), machines)):
            after = (len(tasks) - 1,) if i else ()
            tasks.append(Task((m,), rng.randint(1, 5), m, after))
    return MotionSite(
        starts,
        _roads(sorted(poses)),
        tuple(tasks),
        {m: machines + m for m in range(machines)},
        name="shop",
        floor=Floor((6.0 * machines, 9.0), _hall(6.0 * machines, 9.0, walls), poses, leaves),
    )


def store(seed: int, robots: int = 2, items: int = 2) -> MotionSite:
    """Return logistics: items reached from two sides, a corridor behind a door, all come home."""
    rng = random.Random(f"store-{seed}")
    button, starts = 2 * items, tuple(range(2 * items + 1, 2 * items + 1 + robots))
    xs = rng.sample([5.5, 7.0, 8.5], items)
    poses: dict[int, Pose] = {i: (xs[i], 3.4, 0.0) for i in range(items)}
    poses |= {items + i: (xs[i], 1.2, 0.0) for i in range(items)}
    poses[button] = (2.8, 2.4, UP)
    for k, start in enumerate(starts):
        poses[start] = (1.0 + 1.6 * k, 6.0, -UP)
    walls = [(4.4, 2.0, 10.0, 2.4), (4.4, 4.4, 10.0, 4.8)]
    roads = {}
    for place in range(2 * items + 1):
        for home in starts:
            roads[home, place] = roads[place, home] = 1
        if place != button:
            roads[button, place] = 1
    tasks = tuple(Task((i, items + i), rng.randint(1, 2)) for i in range(items))
    leaves = {0: ((4.2, 3.4, UP), (4.2, 5.9, UP))}
    return MotionSite(
        starts, roads, tasks, {0: button}, True, True,
        name="store",
        floor=Floor((10.0, 7.0), _hall(10.0, 7.0, walls), poses, leaves),
    )  # fmt: skip


def haulage(seed: int, robots: int = 2, items: int = 2) -> MotionSite:
    """Return transport: items are carried from their pallets to the one machine, treated, taken."""
    rng = random.Random(f"haulage-{seed}")
    pallets, machines = range(items), range(items, 2 * items)
    starts = tuple(range(2 * items, 2 * items + robots))
    poses: dict[int, Pose] = {p: (2.0 + 3.0 * p, 1.2, UP) for p in pallets}
    poses |= {m: (1.5 + 3.5 * (m - items), 6.5, UP) for m in machines}
    for k, start in enumerate(starts):
        poses[start] = (1.2 + 2.0 * k, 3.8, rng.choice((UP, -UP)))
    tasks, carried = [], []
    for p in pallets:
        to = items + rng.randrange(items)
        tasks += [Task((p,), rng.randint(1, 3)), Task((to,), 2, to, (2 * p,))]
        carried.append((2 * p, 2 * p + 1))
    return MotionSite(
        starts, _roads(sorted(poses)), tuple(tasks),
        name="haulage",
        floor=Floor((8.0, 8.0), _hall(8.0, 8.0, [(3.6, 3.2, 5.2, 4.6)]), poses),
        carried=tuple(carried),
    )  # fmt: skip


def kits(seed: int, robots: int = 2, parts: int = 2) -> MotionSite:
    """Return kitting: each kit's parts in order by one robot, unloaded while that is prepared."""
    rng = random.Random(f"kits-{seed}")
    count = robots
    spots = [(x, y, UP) for x in (4.0, 5.6, 7.2) for y in (1.2, 6.6)]
    dealt = rng.sample(spots, count * parts)
    poses: dict[int, Pose] = dict(enumerate(dealt))
    starts = tuple(range(count * parts, count * parts + robots))
    for k, start in enumerate(starts):
        poses[start] = (1.2, 2.0 + 3.5 * k, 0.0)
    tasks, teams, prepared, only = [], [], [], {}
    for kit in range(count):
        first = len(tasks)
        for s in range(parts):
            after = (len(tasks) - 1,) if s else ()
            tasks.append(Task((kit * parts + s,), 2, None, after))
        tasks.append(Task((starts[kit % robots],), 2, None, (len(tasks) - 1,)))
        only |= {t: (kit % robots,) for t in range(first, len(tasks)) if rng.random() < 0.2}
        prepared.append(len(tasks) - 1)
        teams.append(tuple(range(first, len(tasks))))
    return MotionSite(
        starts, _roads(sorted(poses)), tuple(tasks),
        name="kits",
        floor=Floor((8.0, 8.0), _hall(8.0, 8.0, [(2.8, 3.6, 6.0, 4.2)]), poses),
        only=only, teams=tuple(teams), prepared=tuple(prepared),
    )  # fmt: skip


def doors(seed: int, robots: int = 2, leaves: int = 1) -> MotionSite:
    """Return doors in sequence: each robot has to get to its goal, behind all of them (at even
    seeds this is a task, at odd ones one of some moves is asked for).
    """
    rng = random.Random(f"doors-{seed}")
    walls, poses, shut, buttons = [], {}, {}, {}
    for d in range(leaves):
        x = 4.0 + 3.5 * d
        low, high = x - THICK / 2, x + THICK / 2
        walls += [(low, 0.0, high, 3.0 - GAP / 2), (low, 3.0 + GAP / 2, high, 6.0)]
        poses[d] = (x - 1.2, rng.choice((2.0, 4.0)), rng.choice((UP, -UP)))
    goals = range(leaves, leaves + robots)
    starts = tuple(range(leaves + robots, leaves + 2 * robots))
    width = 4.0 + 3.5 * leaves
    for k in range(robots):
        y = 1.4 + 3.2 * k
        poses[goals[k]] = (width - 1.0, y, rng.choice((UP, -UP)))
        poses[starts[k]] = (1.2, y, 0.0)
    for d in range(leaves):
        x = 3.8 + 3.5 * d
        shut[-1 - d] = ((x, 3.0, UP), (x, 4.6, UP))
        buttons[-1 - d] = d
    tasks = () if seed % 2 else tuple(Task((goal,), 1) for goal in goals)
    return MotionSite(
        starts, _roads(sorted(poses)), tasks, buttons,
        name="doors",
        floor=Floor((width, 6.0), _hall(width, 6.0, walls), poses, shut),
        only={k: (k,) for k in range(robots)} if tasks else {},
        visits=dict(enumerate(goals)) if not tasks else {},
    )  # fmt: skip


FAMILIES = {make.__name__: make for make in (shop, store, haulage, kits, doors)}
