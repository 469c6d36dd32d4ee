"""What is judged: motions and motion effects of the activities that a plan has, and obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from up_samp.validation.values import Key


@dataclass(frozen=True)
class Obstacle:
    """An obstacle that a motion constraint lists; ``place`` is the configuration that its fluent
    has at the activity's start (``None``: the list gives none), ``key`` that fluent.
    """

    name: str
    static: bool
    place: str | None = None
    key: Key | None = None


@dataclass(frozen=True)
class JudgedMotion:
    """A motion constraint of a present activity. Times in schedule units; ``places`` are the
    names of the configurations, the starting one first; ``obstacles`` is ``None`` for "all".
    """

    name: str
    """The activity's name, with ``#k`` for its k-th further constraint: the trajectory's key."""
    activity: str
    constraint: Any
    object: str
    places: tuple[str, ...]
    start: int
    end: int
    obstacles: tuple[Obstacle, ...] | None
    together: frozenset[str] = frozenset()
    """The object and all loads that travel with it: one body."""

    @property
    def what(self) -> str:
        """Return the activity, the object and the times, for people."""
        return f"{self.name} [{self.start}, {self.end}] moving {self.object}"


@dataclass(frozen=True)
class Jump:
    """A motion effect: ``object`` is at configuration ``place`` from ``time`` on (units)."""

    activity: str
    object: str
    place: str
    time: int
