"""How authors write a site of robots, places, doors and tasks as a scheduling problem.

A :class:`~tests.scheduling.cpsat.sites.Site` is what is meant; a :class:`Style` is how an author
writes it. Sites say nothing of the unit that may pass between one thing and the next
(``Style.units``); styles that agree on that have the same optimum.
:func:`~tests.scheduling.cpsat.writer.write` does the writing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

S = TypeVar("S", bound="Style")
_STRICT = ("strictly", "busy", "held")


@dataclass(frozen=True)
class Style:
    """How a site is written."""

    arrive: str = "end - 1"  # end | end - 1 | start + d
    origin: str = "start"  # start | whole | until end
    lasts: str = "fixed"  # fixed | bounds
    alone: str = "after"  # after | strictly | implies | not both | uses | level | busy | held
    machine: str = "after"
    one_of: str = "pairs"  # pairs | nested | inside | variables
    order: str = "scope"  # scope | implies | inside
    fluents: str = "own"  # own | parameter | precedences
    rivals: str = "all"  # all | leaving: with precedences, who is named as undoing something
    moves: str = "each"  # each | leave | go: one a road, or goals (and origins) are parameters
    way: str = ""  # "" | road: while it drives, a robot is on the road
    shuffled: int = 0  # the seed of a listing with names of its own; 0: as the writer lists it
    spoiled: int = 0
    """A seed: by it some of what a pattern consists of is left out, so that it is none."""

    @property
    def units(self) -> tuple[int, ...]:
        """The units of time that pass after a move's end until its effect is seen, between what
        one robot does, between what one machine does, and until a door's opening is seen
        (and what spoils the style; and whether every move keeps every door still, because it asks
        for those that it does not go through under a condition).
        """
        late = self.fluents != "precedences" and self.arrive == "end"
        alone, machine = (int(how in _STRICT) for how in (self.alone, self.machine))
        last = (int(self.arrive == "end"), self.spoiled, int(self.moves != "each"))
        return max(int(late), alone), alone, machine, *last

    def __str__(self) -> str:
        base = Style()
        changed = [f.name for f in fields(self) if getattr(self, f.name) != getattr(base, f.name)]
        return ", ".join(f"{name} {getattr(self, name)}" for name in changed) or "published"


def numbered(styles: list[S]) -> list[S]:
    """Return styles, each but the first in a listing of its own."""
    return [replace(style, shuffled=k) for k, style in enumerate(styles)]


TIGHT = numbered(
    [
        Style(),
        Style(origin="until end"),
        Style(arrive="start + d"),
        Style(lasts="bounds"),
        Style(alone="implies", order="implies"),
        Style(alone="not both", one_of="nested"),
        Style(alone="uses", machine="uses"),
        Style(alone="level", lasts="bounds"),
        Style(one_of="inside", order="inside"),
        Style(one_of="variables", machine="uses"),
        Style(fluents="parameter", alone="uses", one_of="nested", order="inside"),
        Style(fluents="precedences"),
        Style(fluents="precedences", alone="uses", one_of="nested", order="inside", machine="uses"),
        Style(),
        Style(fluents="precedences", lasts="bounds"),
        Style(fluents="precedences", rivals="leaving"),
        Style(fluents="precedences", rivals="leaving", alone="uses", one_of="nested"),
        Style(moves="leave"),
        Style(moves="go", alone="uses", one_of="nested"),
        Style(moves="leave", fluents="parameter", lasts="bounds", way="road"),
        Style(way="road", alone="implies", origin="until end"),
    ]
)
LOOSE = numbered(
    [
        Style(arrive="end", alone="strictly", machine="strictly", origin="whole"),
        Style(arrive="end", alone="strictly", machine="busy"),
        Style(arrive="end", alone="strictly", machine="held", fluents="parameter"),
        Style(arrive="end", alone="busy", machine="strictly"),
        Style(alone="busy", machine="busy", order="inside", one_of="nested"),
        Style(alone="held", machine="busy", fluents="parameter"),
        Style(alone="held", machine="held", one_of="variables"),
        Style(alone="busy", machine="held", fluents="precedences"),
        Style(moves="leave", alone="busy", machine="busy"),
        Style(way="road", alone="held", machine="held"),
    ]
)
SPOILED = numbered(
    [
        Style(fluents="precedences", spoiled=1),
        Style(fluents="precedences", one_of="nested", spoiled=2),
        Style(fluents="precedences", spoiled=3),
        Style(fluents="precedences", rivals="leaving", spoiled=8),
        Style(fluents="precedences", rivals="leaving", alone="implies", spoiled=9),
        Style(alone="busy", machine="held", spoiled=4),
        Style(alone="held", machine="busy", one_of="variables", spoiled=5),
        Style(alone="uses", machine="level", one_of="inside", spoiled=6),
        Style(spoiled=7),
    ]
)
