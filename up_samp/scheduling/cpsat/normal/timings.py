"""Effects of activities of a fixed length, told from the end that they are near to."""

from __future__ import annotations

from collections.abc import Iterable

from unified_planning.model import Effect, Timing
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimepointKind

from up_samp.scheduling.cpsat.encode.durations import constant_bounds

TimedEffect = tuple[Timing, Effect, "Activity | None"]


def anchor(effects: Iterable[TimedEffect]) -> list[TimedEffect]:
    """Return ``effects`` with ``start + k`` told as ``end - (length - k)`` where that is nearer."""
    return [(_anchored(timing, owner), effect, owner) for timing, effect, owner in effects]


def _anchored(timing: Timing, owner: Activity | None) -> Timing:
    point = timing.timepoint
    if owner is None or point.container != owner.name or point.kind is not TimepointKind.START:
        return timing
    lower, upper = constant_bounds(owner.duration)
    if lower is None or lower != upper or 2 * timing.delay <= lower:
        return timing
    return Timing(timing.delay - lower, owner.end)
