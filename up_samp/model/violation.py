"""What the independent validator has against a plan: for people, and for the search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Violation:
    """One broken rule. ``kind`` is a short stable word, ``what`` names the activities, objects or
    constraints and the times, for people. ``activities`` and ``objects`` are those it is about,
    by name, as far as it is about any; ``time`` (s) is when it is first broken, if at a time.
    """

    kind: str
    what: str
    activities: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    time: float | None = None
    about: tuple[str, ...] = ()
    """Of a schedule's rules: the fluents (or, of a duration, the activity) that it is about."""
    node: Any = None
    """The constraint that is broken, as the problem has it."""

    def __str__(self) -> str:
        return f"{self.kind}: {self.what}"
