"""Random problems as plain values.

A robot has jobs, one after the other: to be at one of some places. How a job is said is the style.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, replace

from tests.fuzz.floors import FLOORS, Floor


@dataclass(frozen=True)
class Robot:
    """``goals``: for each job, the places of which it has to reach one. ``service``: units that it
    then stays there. ``body``: how it moves (see :data:`BODIES`), "" as ``car`` says.
    """

    name: str
    car: bool
    shape: str
    start: str
    goals: tuple[tuple[str, ...], ...]
    service: int
    body: str = ""

    @property
    def moves(self) -> str:
        """How it moves."""
        return self.body or ("car" if self.car else "omni")


@dataclass(frozen=True)
class Load:
    """A box that robots carry, one after the other.

    ``carried``: by which robot, on which of its jobs. ``side``: where it stands to them: "ahead",
    "left" or "on". ``shape``: the footprint of its first carrier, which says how far away that is.
    ``turned``: the last carrier does not bring it along but has it put down by other means.
    """

    name: str
    carried: tuple[tuple[str, int], ...]
    shape: str
    side: str = "ahead"
    turned: bool = False


@dataclass(frozen=True)
class Style:
    """How the problem is said. ``obstacles``: "all", "list", "dict"; ``state``: "fluents" or
    "order"; ``offset``: effects come so many units before the end; ``choice``: "optional",
    "parameter" or "variable"; ``one_at_a_time``: "pairs", "uses" or "all" (and all robots take
    turns); ``limit``: "deadline" or "constraint"; ``order``: "or" or "implies"; ``durations``:
    "wide" or "close" to the straight line's.
    """

    obstacles: str
    state: str
    offset: int
    choice: str
    one_at_a_time: str
    limit: str = "deadline"
    order: str = "or"
    durations: str = "wide"


@dataclass(frozen=True)
class Case:
    """A problem. ``door``: None, "open", or how it is opened: "once" (at or after ``opens``),
    "shut", "twice" or "closing" (open at first). ``limit``: nothing may end later (units).
    ``loads``: boxes that robots take along. ``idle``: robots that may drive
    out and back at any time.
    """

    seed: int
    floor: Floor
    robots: tuple[Robot, ...]
    style: Style
    door: str | None = None
    opens: int = 0
    limit: int | None = None
    loads: tuple[Load, ...] = ()
    idle: tuple[str, ...] = ()


def random_case(seed: int) -> Case:
    rng = random.Random(seed)
    floor = rng.choice(FLOORS)(rng)
    places = list(floor.places)
    count = min(rng.choice((1, 1, 2, 2, 3, 4)), len(places) - 1)
    starts = rng.sample(places[:-1] if floor.kind == "closed" else places, count)
    ends = rng.sample(places, count) if rng.random() < 0.8 else [None] * count
    robots = tuple(
        _robot(rng, k, start, end, places)
        for k, (start, end) in enumerate(zip(starts, ends, strict=True))
    )
    style = random_style(rng)
    door = rng.choice((None, "open", "once", "once", "once", "shut")) if floor.doorway else None
    limit = rng.choice((None, None, None, None, None, 6, 12, 25))
    return Case(seed, floor, robots, style, door, rng.choice((0, 3)), limit)


def _robot(rng: random.Random, k: int, start: str, end: str | None, places: list[str]) -> Robot:
    """Return a robot that ends at a place of its own, or (``end`` None) just anywhere."""
    goals: list[tuple[str, ...]] = []
    here = {start}
    for _ in range(rng.choice((0, 0, 0, 1))):
        free = [p for p in places if p not in here and p != end]
        goals.append(tuple(sorted(rng.sample(free, rng.choice((1, 1, 2))))))
        here = set(goals[-1])
    if end is None or end in here:
        end = rng.choice([p for p in places if p not in here])
    more = [p for p in places if p not in here and p != end]
    also = rng.sample(more, 1) if rng.random() < 0.25 else []
    goals.append(tuple(sorted((end, *also))))
    shape = rng.choice(("box", "long", "square"))
    return Robot(f"r{k}", rng.random() < 0.5, shape, start, tuple(goals), rng.choice((0, 0, 2)))


def random_style(rng: random.Random) -> Style:
    return Style(
        rng.choice(("all", "list", "dict")),
        rng.choice(("fluents", "order")),
        rng.choice((0, 0, 1)),
        rng.choice(("optional", "optional", "parameter")),
        rng.choice(("pairs", "uses")),
    )


def limited(case: Case, limit: int) -> Case:
    """Return the same problem in which nothing may end after ``limit``."""
    return replace(case, limit=limit if case.limit is None else min(limit, case.limit))
