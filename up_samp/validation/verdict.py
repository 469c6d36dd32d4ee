"""What the validator says about a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

JUDGING_GRACE = 1.5
"""Seconds after its limit that a solve may go on judging a plan that it has found."""


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


@dataclass(frozen=True)
class Verdict:
    """All violations found. ``definition3`` tells whether the plan also holds (everything else
    being in order) when an effect at ``t`` is seen at ``t``, as in the SAMP paper's Definition 3.
    """

    violations: tuple[Violation, ...]
    definition3: bool

    @property
    def valid(self) -> bool:
        """Whether no rule is broken (under the PDDL 2.1 reading of effects and conditions)."""
        return not self.violations
