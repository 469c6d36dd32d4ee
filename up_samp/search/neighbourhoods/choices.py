"""Neighbourhoods: which robots are freed, and when. Each is one function of a plan.

Each takes the plan, random numbers and how many robots to free, and returns them; the rest of the
plan is kept.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from up_samp.search.neighbourhoods.view import View


@dataclass(frozen=True)
class Freed:
    """Robots that are freed between two times (units): what they do then is decided anew."""

    robots: frozenset[str]
    since: float = -math.inf
    until: float = math.inf

    def within(self, other: Freed) -> bool:
        """Return whether ``other`` frees all of this, too."""
        inside = other.since <= self.since and self.until <= other.until
        return inside and self.robots <= other.robots


Choice = Callable[[View, random.Random, int], Freed]


def random_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free some robots, whichever."""
    return Freed(frozenset(chance.sample(view.robots, min(size, len(view.robots)))))


def last_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free a robot that is done late, and those that are done first: they could help."""
    ends = view.last_ends
    by_end = sorted(view.robots, key=lambda r: (ends[r], r))
    late = [r for r in by_end if ends[r] == ends[by_end[-1]]]
    chosen = {chance.choice(late)}
    for robot in _by_rank([r for r in by_end if r not in chosen], chance):
        if len(chosen) >= size:
            break
        chosen.add(robot)
    return Freed(frozenset(chosen))


def time_window(view: View, chance: random.Random, size: int) -> Freed:
    """Free twice as many robots in a part of the time."""
    makespan = view.plan.schedule.makespan
    length = makespan * chance.uniform(0.25, 0.6)
    since = chance.uniform(-0.1 * makespan, makespan - 0.8 * length)
    busy = view.busy(since, since + length)
    chosen = frozenset(chance.sample(busy, min(2 * size, len(busy))))
    return Freed(chosen, math.floor(since), math.ceil(since + length))


def critical_path(view: View, chance: random.Random, size: int) -> Freed:
    """Free robots that the plan's end hangs on, from a place on that path on; others with them,
    if these are few.
    """
    path = view.critical
    if not path:
        return last_robots(view, chance, size)
    first = chance.randrange(len(path))
    line = path[first:] if chance.random() < 0.5 else path[: first + 1]
    chosen = _first_of((r for n in line for r in sorted(view.owners.of.get(n, ()))), size)
    return Freed(frozenset(_filled(chosen, view.robots, chance, size)))


def waiting_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free a robot that waits for another one, that one, and those that wait for them."""
    waits = view.waits
    if not waits:
        return meeting_robots(view, chance, size)
    seed = chance.choice(waits)
    chosen = {seed.who: None, seed.whom: None}
    near = sorted(waits, key=lambda w: (abs(w.time - seed.time), w.who, w.whom))
    grown = True
    while grown and len(chosen) < size:
        grown = False
        for wait in near:
            if len({wait.who, wait.whom} & chosen.keys()) == 1:
                chosen |= {wait.who: None, wait.whom: None}
                grown = True
                break
    return Freed(frozenset(_filled(list(chosen), view.robots, chance, size)))


def meeting_robots(view: View, chance: random.Random, size: int) -> Freed:
    """Free a robot that takes long for a motion, and those that come nearest to it meanwhile."""
    if not view.motions:
        return random_robots(view, chance, size)
    motion = chance.choice(view.motions)
    chosen = [motion.object, *view.near(motion)][:size]
    return Freed(frozenset(_filled(chosen, view.robots, chance, size)))


CHOICES: tuple[Choice, ...] = (
    random_robots,
    last_robots,
    time_window,
    critical_path,
    waiting_robots,
    meeting_robots,
)


def _first_of(some: Iterable[str], size: int) -> list[str]:
    found: dict[str, None] = {}
    for one in some:
        if len(found) >= size:
            break
        found[one] = None
    return list(found)


def _filled(chosen: list[str], robots: list[str], chance: random.Random, size: int) -> list[str]:
    """Return ``size`` robots: those chosen, and others at random."""
    others = [r for r in robots if r not in chosen]
    more = max(0, min(size - len(chosen), len(others)))
    return chosen[:size] + chance.sample(others, more)


def _by_rank(ranked: list[str], chance: random.Random) -> Iterable[str]:
    """Yield all, those in front mostly sooner (as Ropke and Pisinger draw removals)."""
    left = list(ranked)
    while left:
        yield left.pop(int(len(left) * chance.random() ** 3))
