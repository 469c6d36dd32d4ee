"""The tunables of motion planning: how long is tried, and how much is remembered."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, tunable


@dataclass(frozen=True)
class LadderTuning(Tunables):
    """Who goes first, with more and more effort (``motion/fleet/priority_search.py``)."""

    first: int = tunable(
        20, "motions", "planned for each one of a group, with who is in the way ejected", least=0
    )
    again: int = tunable(
        15,
        "motions",
        "planned again for each one where somebody is late, or all much later than alone",
        least=0,
    )
    enough: float = tunable(
        1.15, "factor", "of the arrivals alone with which a group on time is content", least=1
    )
    polish: int = tunable(
        4, "rounds", "in which each of those moved together is planned again", least=0
    )
    polish_worth: float = tunable(0.1, "s", "that a round has to gain for another one", least=0)
    detours: int = tunable(
        4, "rounds", "of paths around, and lanes beside, what the last path met", least=0
    )
    gain: float = tunable(0.02, "s", "for which another timing is worth having", least=0)


@dataclass(frozen=True)
class DetoursTuning(Tunables):
    """Other paths, for one robot or for two that pass (``motion/fleet/detours.py``)."""

    copies: float = tunable(
        0.8, "radii of the mover", "between the copies of it that a detour keeps clear of", least=0
    )
    lane: float = tunable(25.0, "m", "of a stretch beside which a lane is tried, at most", least=0)
    quick: float = tunable(
        0.5, "s", "for a detour where no planner stops after fixed work", least=0
    )
    beside: tuple[float, ...] = tunable(
        (1.0, 1.4), "shares", "of the room that it takes at least, for two lanes in turn", least=1
    )
    stretch: tuple[float, ...] = tunable(
        (2.0, 6.0),
        "radii of both",
        "long two lanes are in turn, a quarter of it before both meet",
        least=0.1,
    )


@dataclass(frozen=True)
class RoadmapTuning(Tunables):
    """Places and moves of one body (``motion/fleet/roadmap.py``)."""

    nodes: int = tunable(30_000, "places", "at most", least=2)
    links: int = tunable(
        6, "places", "of the lattice that a place off it is joined to, at most", least=1
    )
    local: float = tunable(
        3.0, "cells", "that a link may be longer than the straight line, at most", least=1
    )
    each: float = tunable(0.05, "s", "that a move costs besides its length: fewer are better",
                          least=0)  # fmt: skip
    roomy: float = tunable(
        2.1, "radii of the body", "between places of the coarsest lattice", least=0.1
    )
    headings: int = tunable(8, "headings", "of a car's lattice, evenly spread", least=4)
    offsets: int = tunable(
        5, "cells", "away, up to which a car's lattice looks for its moves", least=1
    )
    straighter: float = tunable(
        1.25, "times", "the straight line that a car's move may be long", least=1
    )
    pivots: int = tunable(
        8, "headings", "of the lattice of a body that turns on the spot, at most", least=4
    )


@dataclass(frozen=True)
class KnotsTuning(Tunables):
    """Knots undone by joint moves on roadmaps (``motion/fleet/deadlocks.py``)."""

    efforts: tuple[int, ...] = tunable(
        (40_000, 150_000),
        "moves",
        "looked at in one search, of all roadmaps in turn: most knots come undone soon",
        least=1,
    )
    many: int = tunable(
        3_000, "places", "from which on a finer roadmap is not worth its making", least=0
    )
    together: int = tunable(
        150_000, "moves", "looked at where some have to go at the same time", least=1
    )
    begins: int = tunable(
        40, "begins", "tried for drives that have to be at the same time", least=1
    )
    stop: float = tunable(1.0, "s", "that a stop is worth", least=0)
    passes: int = tunable(8, "passes", "over a sequence in which stops are left out", least=0)
    air: float = tunable(
        0.02, "m", "kept from what rests beside a drive, for rounding", least=0.001
    )
    pushes: int = tunable(
        2_000, "moves", "tried for one joint move before the next constraint is added", least=1
    )


@dataclass(frozen=True)
class MemoryTuning(Tunables):
    """What a fleet's workspace remembers (``motion/fleet/workspace.py``)."""

    paths: int = tunable(
        4_000, "paths", "of each kind: a fleet of 50 with 150 orders drives 300", least=1
    )
    diagrams: int = tunable(400_000, "pairs of paths", "whose conflicts are known", least=1)
    shadows: int = tunable(
        1_000, "sets of obstacles", "whose shadows on the floor are known", least=1
    )


@dataclass(frozen=True)
class FleetTuning(Tunables):
    """Several robots together."""

    ladder: LadderTuning = field(default_factory=LadderTuning)
    detours: DetoursTuning = field(default_factory=DetoursTuning)
    roadmap: RoadmapTuning = field(default_factory=RoadmapTuning)
    knots: KnotsTuning = field(default_factory=KnotsTuning)
    memory: MemoryTuning = field(default_factory=MemoryTuning)


@dataclass(frozen=True)
class MotionTuning(Tunables):
    """All of motion planning."""

    fleet: FleetTuning = field(default_factory=FleetTuning)
