"""Copies of one activity: which of them is used is no decision."""

from __future__ import annotations

from up_samp.model.refinement import FirstUsed, Layer, Refinement, Strength
from up_samp.search.knowledge import Knowledge
from up_samp.upio.interchangeable import interchangeable


def used_in_order(knowledge: Knowledge) -> list[Refinement]:
    """State that of interchangeable activities the first ones are used first; nothing, where
    something was learned of single activities before.
    """
    if knowledge.active:
        return []
    why = "they are the same but for their names"
    return [
        Refinement(FirstUsed(some), Layer.BOUND, Strength.PROVEN, why)
        for some in interchangeable(knowledge.relaxation)
    ]
