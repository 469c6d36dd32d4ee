"""Sites of robots, places, doors and tasks: like the published families, or small and random."""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Task:
    """Done once, by one robot, at one of ``places``; after the tasks in ``after``.

    ``helped``: somebody who needs no place may do it as well, by no machine. Nobody starts it
    before ``released``, but for the first robot where it is ``early``.
    """

    places: tuple[int, ...]
    length: int
    machine: int | None = None
    after: tuple[int, ...] = ()
    helped: bool = False
    released: int = 0
    early: bool = False


@dataclass(frozen=True)
class Site:
    """``roads[a, b]`` is how long a move takes; ``doors[place]`` is where its door is opened.

    ``starts`` are places. ``home``: all have to be where they started in the end. ``private``:
    nobody goes where another one starts. ``visits[robot]`` is where it has to arrive some time.
    """

    starts: tuple[int, ...]
    roads: dict[tuple[int, int], int]
    tasks: tuple[Task, ...]
    doors: dict[int, int] = field(default_factory=dict)
    home: bool = False
    private: bool = False
    visits: dict[int, int] = field(default_factory=dict)

    def ways(self, robot: int) -> list[tuple[tuple[int, int], int]]:
        """Return the roads of a robot."""
        closed = set(self.starts) - {self.starts[robot]} if self.private else set()
        return [(pair, length) for pair, length in self.roads.items() if not closed & {*pair}]

    @property
    def places(self) -> list[int]:
        """All places."""
        return sorted({*self.starts, *itertools.chain(*self.roads)})


def shop(robots: int, jobs: int, machines: int, seed: int = 0) -> Site:
    """Return a job shop like the published ones: every machine in a room with a door."""
    rng = random.Random(seed)
    spots = [(30 + 25 * m + rng.randint(-4, 4), 41) for m in range(machines)]
    spots += [(30 + 25 * m, 29) for m in range(machines)]
    starts = tuple(range(2 * machines, 2 * machines + robots))
    spots += [(rng.randint(5, 25 * machines + 30), rng.choice([20, 25])) for _ in range(robots)]
    tasks: list[Task] = []
    for _ in range(jobs):
        order = rng.sample(range(machines), machines)
        for i, m in enumerate(order):
            after = (len(tasks) - 1,) if i else ()
            tasks.append(Task((m,), rng.randint(1, 10), m, after))
    places = [*range(2 * machines), *starts]
    roads = {pair: _length(spots, *pair) for pair in itertools.permutations(places, 2)}
    return Site(starts, roads, tuple(tasks), {m: machines + m for m in range(machines)})


def store(robots: int, items: int, seed: int = 0) -> Site:
    """Return logistics like the published one: out to an item and home, items on two sides."""
    rng = random.Random(seed)
    spots = [(60 + 12 * (i % 4), 32 - 5 * (i // 4)) for i in range(items)]
    spots += [(60 + 12 * (i % 4), 42 - 25 * (i // 4)) for i in range(items)]
    spots += [(46, 30)]
    spots += [(15 + 10 * r, 59) for r in range(robots)]
    button, starts = 2 * items, tuple(range(2 * items + 1, 2 * items + 1 + robots))
    roads = {}
    for place in (*range(2 * items), button):
        for home in starts:
            roads[home, place] = roads[place, home] = _length(spots, home, place)
        if place != button:
            roads[button, place] = _length(spots, button, place)
    tasks = tuple(Task((i, items + i), rng.randint(1, 2)) for i in range(items))
    return Site(starts, roads, tasks, dict.fromkeys(range(items), button), True, True)


def _length(spots, a, b):
    (x, y), (u, v) = spots[a], spots[b]
    return max(1, int(((x - u) ** 2 + (y - v) ** 2) ** 0.5 / 2))


def small(seed: int) -> Site:
    """Return a random site that is small enough to be solved constraint by constraint."""
    rng = random.Random(seed)
    places = range(rng.choice([2, 3, 3]))
    starts = tuple(rng.choice(places) for _ in range(rng.choice([1, 1, 2])))
    pairs = list(itertools.permutations(places, 2))
    roads = {
        p: rng.randint(1, 4) for p in rng.sample(pairs, rng.randint(len(pairs) // 2, len(pairs)))
    }
    tasks = []
    for t in range(rng.choice([1, 2, 2, 3])):
        spots = tuple(rng.sample(list(places), rng.choice([1, 1, 2])))
        after = (rng.randrange(t),) if t and rng.random() < 0.4 else ()
        tasks.append(Task(spots, rng.randint(1, 3), rng.choice([None, 0, 1]), after))
    doors = {rng.choice(places): rng.choice(places)} if rng.random() < 0.4 else {}
    home = rng.random() < 0.3
    visits = {r: rng.choice(places) for r in range(len(starts)) if rng.random() < 0.4}
    helped = [replace(task, helped=rng.random() < 0.2) for task in tasks]
    return Site(starts, roads, _released(helped, seed), doors, home, visits=visits)


def _released(tasks, seed: int) -> tuple[Task, ...]:
    """Return tasks of which some are released at some time."""
    rng = random.Random(f"released {seed}")
    if rng.random() < 0.5:
        return tuple(tasks)
    return tuple(
        replace(task, released=rng.choice([0, 2, 5, 9, 14]), early=rng.random() < 0.3)
        for task in tasks
    )


def dispatch(seed: int) -> Site:
    """Return tasks apart from each other, each for one of several robots that all might do it."""
    rng = random.Random(f"dispatch {seed}")
    robots, tasks = rng.choice([2, 2, 3]), rng.choice([2, 2, 3])
    spots = [(rng.randint(0, 20), rng.randint(0, 20)) for _ in range(robots + tasks)]
    roads = {pair: _length(spots, *pair) for pair in itertools.permutations(range(len(spots)), 2)}
    visited = tuple(Task((robots + t,), rng.randint(1, 3)) for t in range(tasks))
    home = rng.random() < 0.5
    return Site(tuple(range(robots)), roads, _released(visited, seed), home=home)
