"""What a problem in a published form is made of: robots, doors, and what activities need."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from unified_planning.model import Fluent, FNode
from unified_planning.model.motion import ConfigurationObject, MotionActivity, MovableObject
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, And, Implies, Or


@dataclass(frozen=True)
class Need:
    """What an activity needs, and who gives and takes it (for the form without fluents).

    ``helpers`` make it true, ``rivals`` may undo it; ``initially``: it holds from the beginning.
    """

    activity: Activity
    helpers: Sequence[Activity]
    rivals: Sequence[Activity]
    initially: bool = False

    def formula(self) -> FNode:
        """Return the constraint over starts, ends and presences that says it."""
        a = self.activity
        rivals = [(r, r.present, GE(r.start, a.end)) for r in self.rivals if r is not a]
        ways = []
        for h in self.helpers:
            if h is a:
                continue
            begin = h.start
            kept = [
                Implies(present, Or(LE(r.end, begin), after))
                for r, present, after in rivals
                if r is not h
            ]
            ways.append(And([h.present, LE(h.end, a.start), *kept]))
        if self.initially:
            ways.append(And([Implies(present, after) for _, present, after in rivals]))
        return Or(ways)


@dataclass
class Robot:
    """A robot of the problem and all that it may do."""

    body: MovableObject
    start: ConfigurationObject
    at: Fluent | None
    token: Fluent | None
    moves: list[tuple[MotionActivity, ConfigurationObject, ConfigurationObject]] = field(
        default_factory=list
    )
    busy: list[Activity] = field(default_factory=list)
    stands: list[tuple[Activity, Sequence[ConfigurationObject]]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The object's name."""
        return str(self.body.name)

    def moves_to(self, places: Iterable[ConfigurationObject]) -> list[MotionActivity]:
        """Return its moves that end at one of ``places``."""
        names = {p.name for p in places}
        return [a for a, _, to in self.moves if to.name in names]

    def moves_from(self, place: ConfigurationObject) -> list[MotionActivity]:
        """Return its moves that leave ``place``."""
        return [a for a, origin, _ in self.moves if origin.name == place.name]

    def preconditions(self) -> Iterator[Need]:
        """Yield what each thing needs that it does at a place: that it has come there."""
        moves = [a for a, _, _ in self.moves]
        for a, places in self.stands:
            helpers = self.moves_to(places)
            same = {id(h) for h in helpers}
            rivals = [m for m in moves if id(m) not in same]
            initially = any(p.name == self.start.name for p in places)
            yield Need(a, helpers, rivals, initially)


@dataclass
class Leaf:
    """A door of the problem, and the activities that open it."""

    body: MovableObject
    opened: ConfigurationObject
    button: ConfigurationObject
    at: Fluent | None
    token: Fluent | None
    openings: list[Activity] = field(default_factory=list)
