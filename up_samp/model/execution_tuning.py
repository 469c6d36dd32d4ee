"""The tunables of execution (:mod:`up_samp.execution`); they stand here because everything else may
know them, and nothing below may know execution.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, tunable


@dataclass(frozen=True)
class ReorderTuning(Tunables):
    """When orders are decided again, and how far ahead (``execution/reorder.py``)."""

    horizon: float = tunable(60.0, "s", "ahead, within which decisions come up", least=0)
    threshold: float = tunable(
        1.5, "s", "by which the predicted makespan has to grow before orders are looked at", least=0
    )


@dataclass(frozen=True)
class FloorTuning(Tunables):
    """How a floor is simulated (``execution/simulate.py``)."""

    tick: float = tunable(0.1, "s", "between two looks at the floor", least=0.001)


@dataclass(frozen=True)
class ExecutionTuning(Tunables):
    """The tunables of execution."""

    reorder: ReorderTuning = field(default_factory=ReorderTuning)
    floor: FloorTuning = field(default_factory=FloorTuning)
