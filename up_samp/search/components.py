"""What a search is made of: a preset is a list of these."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from up_samp.model import CandidateSchedule
from up_samp.model.refinement import Refinement
from up_samp.search.check import Check, CheckAlone
from up_samp.search.cuts.protocol import Cuts
from up_samp.search.pace import Pace
from up_samp.upio import Itinerary

if TYPE_CHECKING:
    from up_samp.search.bounds import Incumbent
    from up_samp.search.search import Search


@dataclass(frozen=True)
class Statement:
    """Something that is told to the scheduler; ``find`` returns it as refinements."""

    name: str
    find: Callable[[Search], Sequence[Refinement]]


Shaper = Callable[["Search", CandidateSchedule], CandidateSchedule]
"""Makes a candidate schedule easier to drive before its motions are checked."""
Builder = Callable[["Search", Itinerary], "Incumbent | None"]
"""Makes a plan of a candidate without asking whether its motions fit as scheduled, if it can."""
Repair = Callable[["Search", CandidateSchedule, Check], "Incumbent | None"]
"""Makes a plan of a candidate whose motions do not fit, if it can."""
Improver = Callable[["Search", bool], "Iterator[Incumbent]"]
"""Yields plans made of the best one, each better than all before it, for a share of the time. It is
asked in every round, and told whether the scheduler found nothing better in its time.
"""
Finisher = Callable[["Search", "Incumbent"], "Incumbent | None"]
"""Makes the best plan better in what no metric tells, in the end; None leaves it as it is."""


@dataclass(frozen=True)
class Components:
    """The parts of a search, in the order in which they act.

    ``statements`` come before the first schedule; ``after_failure`` when a candidate failed;
    ``improvers`` in every round, once there is a plan;
    ``for_proofs`` are told to our own scheduler alone, when it judges another one's word. Without
    ``learns`` a search ends with its first candidate.
    """

    statements: tuple[Statement, ...]
    layers: tuple[CheckAlone, ...]
    cuts: Cuts
    pace: Pace
    shapers: tuple[Shaper, ...] = ()
    builders: tuple[Builder, ...] = ()
    repairs: tuple[Repair, ...] = ()
    after_failure: tuple[Statement, ...] = ()
    for_proofs: tuple[Statement, ...] = ()
    improvers: tuple[Improver, ...] = ()
    finishers: tuple[Finisher, ...] = ()
    learns: bool = True
