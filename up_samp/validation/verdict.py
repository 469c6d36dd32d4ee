"""What the validator says about a plan."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model.violation import Violation

JUDGING_GRACE = 1.5
"""Seconds after its limit that a solve may go on judging a plan that it has found."""


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
