"""The refinements of the paper, as it states them: RCOND, CHCONF and CHTIME.

They speak of a whole group in the order in which it failed; :mod:`up_samp.refinement.rules` has the
smaller relatives that the search learns by default.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import (
    Apart,
    Clause,
    Elsewhere,
    Literal,
    Overlap,
    end_of,
    start_of,
)
from up_samp.refinement.rules import other_motions


def paper_condition(motions: Sequence[ScheduledMotion], rivals: Iterable[str]) -> list[Literal]:
    """Return the negation of RCOND(G): the ways in which the paper's cut does not apply.

    Some activity of the group absent or between other configurations, the first motion of an
    object not first, or a rival that overlaps the group.
    """
    literals = other_motions(motions)
    for name in sorted({m.object for m in motions}):
        own = sorted((m for m in motions if m.object == name), key=lambda m: m.start)
        literals += [Apart(start_of(m.activity), end_of(own[0].activity), 1) for m in own[1:]]
    names = tuple(m.activity for m in motions)
    literals += [Overlap(r, names) for r in sorted(rivals) if r not in names]
    return literals


def _elsewhere(motions: Sequence[ScheduledMotion], places: Mapping[str, str]) -> list[Literal]:
    """State that some other object is not at its place while one of the motions happens."""
    return [
        Elsewhere(m.activity, o, c)
        for m in motions
        for o, c in sorted(places.items())
        if o != m.object
    ]


def paper_geometric(
    motions: Sequence[ScheduledMotion],
    rivals: Iterable[str],
    blockers: Mapping[str, str],
) -> Clause:
    """Return the paper's geometric refinement: RCOND(G) -> some blocker changes (CHCONF)."""
    literals = paper_condition(motions, rivals)
    literals += _elsewhere(motions, blockers)
    return Clause(tuple(literals))


def paper_temporal(
    motions: Sequence[ScheduledMotion],
    rivals: Iterable[str],
    arrivals: Mapping[str, int],
    places: Mapping[str, str],
) -> Clause:
    """Return the paper's temporal refinement: RCOND(G) -> CHTIME.

    ``arrivals``: needed ends of the late motions after the group's first start; ``places``:
    where every other object that may move is.
    """
    reference = min(motions, key=lambda m: (m.start, m.activity))
    literals = paper_condition(motions, rivals)
    literals += _elsewhere(motions, places)
    for motion in motions:
        if motion is not reference:
            offset = motion.start - reference.start
            literals.append(
                Apart(start_of(motion.activity), start_of(reference.activity), 1 - offset)
            )
    for name, units in sorted(arrivals.items()):
        literals.append(Apart(start_of(reference.activity), end_of(name), units))
    return Clause(tuple(literals))
