"""The normal form of a problem: the list of steps from what is written to what is recognised.

Each step says the same in one way, so a model may be built from any of them; what recognition finds
in the form only adds what follows anyway, or replaces what is equivalent.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from up_samp.scheduling.cpsat.normal.clauses import split
from up_samp.scheduling.cpsat.normal.precedences import FollowUp, Precondition, Reader
from up_samp.scheduling.cpsat.normal.presences import Presences, find_presences
from up_samp.scheduling.cpsat.normal.timings import anchor
from up_samp.scheduling.cpsat.problem import Additions


@dataclass(frozen=True)
class NormalForm:
    """A problem's parts in one style, who is there together, and what is said with precedences.

    ``preconditions`` are not among the constraints of ``parts`` any more, follow-ups are.
    """

    parts: Additions
    presences: Presences
    preconditions: list[Precondition] = field(default_factory=list)
    follow_ups: list[FollowUp] = field(default_factory=list)


def normal_form(parts: Additions) -> NormalForm:
    """Return the normal form of all parts of a problem (not of what is appended later)."""
    preconditions, follow_ups, others = Reader().read(parts.constraints)
    parts = replace(parts, constraints=split(others))
    parts = replace(parts, effects=anchor(parts.effects))
    presences = find_presences(
        parts.constraints,
        [a.name for a in parts.activities if a.optional],
        [v.name for v in parts.variables if v.type.is_bool_type()],
    )
    return NormalForm(parts, presences, preconditions, follow_ups)
