"""A motion that does not fit even alone, among what rests: what the rules ask about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from up_samp.model import Placed, ScheduledMotion
from up_samp.model.refinement import Strength
from up_samp.search.cases import MotionCase


@dataclass(frozen=True)
class Alone:
    """A ``motion`` among ``obstacles``, of which those in ``places`` (by configuration) may be
    moved; ``cases`` are the motions that are the same and heed what this one met.
    """

    motion: ScheduledMotion
    obstacles: tuple[Placed, ...]
    places: Mapping[str, str]
    cases: tuple[MotionCase, ...]
    why: str
    strength: Strength
