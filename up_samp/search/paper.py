"""The cuts of the paper (``small_cuts`` off): every rival, every other object's place, RCOND,
CHCONF and CHTIME as Tosello et al. (AAAI 2026) write them.
"""

from __future__ import annotations

from collections.abc import Mapping

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import Layer, Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.context import Context
from up_samp.search.failure import Failure


def no_path(
    context: Context,
    motion: ScheduledMotion,
    blockers: Mapping[str, str],
    why: str,
    strength: Strength,
) -> Refinement:
    """Return that a motion has no path while ``blockers`` (object -> configuration) rest."""
    return rules.paper_geometric(
        (motion,), _rivals(context), blockers, why, layer=Layer.GEOMETRIC, strength=strength
    )


def takes_longer(
    context: Context, motion: ScheduledMotion, units: int, places: Mapping[str, str], why: str
) -> Refinement:
    """Return that a motion lasts ``units`` while others rest at ``places``."""
    return rules.paper_temporal(
        (motion,),
        _rivals(context),
        {motion.activity: units},
        places,
        why,
        layer=Layer.TEMPORAL,
    )


def group_cut(failure: Failure) -> Refinement:
    """Return the group refinement: geometric if no trajectories were found, else temporal."""
    context, group = failure.context, failure.group
    start = min(m.start for m in group)
    moving = {m.object for m in group}
    places = {
        name: failure.itinerary.place_at(context.snapshot, name, start)
        for name in sorted(context.snapshot.moved())
        if name not in moving
    }
    if not failure.found:
        return rules.paper_geometric(
            group,
            _rivals(context),
            places,
            failure.report.reason or "no trajectories for the group",
            layer=Layer.GROUP,
            strength=Strength.HEURISTIC,
        )
    return rules.paper_temporal(
        group,
        _rivals(context),
        failure.arrivals(group),
        places,
        "the group needs more time",
        layer=Layer.GROUP,
        strength=failure.strength,
    )


def _rivals(context: Context) -> list[str]:
    return sorted({t.activity for t in context.snapshot.tasks})
