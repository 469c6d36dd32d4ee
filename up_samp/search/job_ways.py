"""Ways to do jobs, by kinds of robots.

Robots of equal bodies are of one *kind*. A way is told with the drives that it is made of, so that
drives can be measured better later.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from up_samp.model import Body
from up_samp.model.snapshot import Snapshot
from up_samp.search.jobs import Jobs

Leg = tuple[Body, str, str]
"""What is driven, from one configuration to another (names)."""
Units = Callable[[Leg], int]


@dataclass(frozen=True)
class Way:
    """One way in which robots of a ``kind`` (a number) do a ``job``: they come to ``goal`` from one
    of the ``origins`` (None: nothing is known of how they come), drive ``legs`` and are busy for
    some units beside that. Then they have come to the places ``ends``; to those ``after`` only
    after they had come to the goal. Beside an origin they have left the places ``leaves`` (None:
    it is not known which).
    """

    job: int
    kind: int
    busy: int
    legs: tuple[Leg, ...]
    body: Body
    goal: str | None
    ends: tuple[str, ...]
    after: frozenset[str]
    origins: frozenset[str] = frozenset()
    leaves: tuple[str, ...] | None = ()

    def drives(self, origin: str | None) -> tuple[Leg, ...]:
        """Return all drives if it comes from an origin."""
        if origin is None or self.goal is None:
            return self.legs
        return (*self.legs, (self.body, origin, self.goal))

    def units(self, origin: str | None, units: Units) -> int:
        """Return what it takes from an origin."""
        return self.busy + sum(units(leg) for leg in self.drives(origin))

    def from_places(self, origins: Collection[str]) -> Way:
        """Return the same from some places."""
        return replace(self, origins=frozenset(origins))

    def least(self, units: Units) -> int:
        """Return what it takes from wherever it takes least."""
        origins: list[str | None] = [None] if self.goal is None else [*sorted(self.origins)]
        return min(self.units(origin, units) for origin in origins)


class Fleet:
    """The robots that do jobs, by kind: ``sizes``, and how many begin where (``starts``)."""

    def __init__(self, snapshot: Snapshot, jobs: Jobs) -> None:
        self.robots = sorted({o.robot for options in jobs.options for o in options})
        bodies = list(dict.fromkeys(snapshot.objects[r].body for r in self.robots))
        self.kind_of = {r: bodies.index(snapshot.objects[r].body) for r in self.robots}
        self.sizes = Counter(self.kind_of.values())
        self.starts = Counter((self.kind_of[r], snapshot.initial[r]) for r in self.robots)
