"""What turns failed motion checks into refinements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import Refinement
from up_samp.search.cases import MotionCase
from up_samp.search.cuts.alone import Alone
from up_samp.search.cuts.failure import Failure
from up_samp.search.facts import Facts
from up_samp.search.knowledge import Knowledge
from up_samp.search.motions import Motions

Alike = Callable[[Facts, ScheduledMotion], list[MotionCase]]
"""Returns the case that a motion is, and all that a cut for it holds for as well."""


class Cuts(Protocol):
    """The rules of one preset."""

    @property
    def alike(self) -> Alike:
        """For which motions a cut is stated."""
        ...

    @property
    def first_only(self) -> bool:
        """Whether a check ends with the first refinement, as in the paper."""
        ...

    def unobstructed(
        self, motions: Motions, knowledge: Knowledge, motion: ScheduledMotion
    ) -> list[Refinement]:
        """Return what the motion's duration among fixed obstacles tells."""
        ...

    def no_path(self, motions: Motions, alone: Alone) -> list[Refinement]:
        """Return what it tells that a motion found no path, without a proof."""
        ...

    def too_slow(self, motions: Motions, alone: Alone, units: int) -> list[Refinement]:
        """Return what it tells that a motion takes ``units`` alone."""
        ...

    def group(self, failure: Failure) -> list[Refinement]:
        """Return refinements that reject a group which failed together."""
        ...
