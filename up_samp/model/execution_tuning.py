"""The tunables of execution (:mod:`up_samp.execution`); they stand here because everything else may
know them, and nothing below may know execution.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.model.tunable import Tunables, effort_of, tunable


@dataclass(frozen=True)
class ReorderTuning(Tunables):
    """When orders are decided again, and how far ahead (``execution/reorder.py``)."""

    horizon: float = tunable(60.0, "s", "ahead, within which decisions come up", least=0)
    most: int = tunable(60, "decisions", "at most, the earliest ones", least=0)
    effort: float = effort_of(0.3, "for one look at them")
    worth: float = tunable(0.5, "s", "by which all has to be over sooner", least=0)
    threshold: float = tunable(
        1.5, "s", "by which the predicted makespan has to grow before orders are looked at", least=0
    )
    pause: float = tunable(4.0, "s", "between two looks", least=0)


@dataclass(frozen=True)
class RobotPaceTuning(Tunables):
    """How robots' paces are learnt from what they tell (``execution/state.py``)."""

    memory: float = tunable(
        20.0, "s", "of free driving over which a robot's pace is averaged", least=0.1
    )
    least: float = tunable(
        0.05, "share", "of its speed; no robot is taken for slower", least=0.001, most=1.0
    )


@dataclass(frozen=True)
class FloorTuning(Tunables):
    """How a floor is simulated (``execution/simulate.py``)."""

    tick: float = tunable(0.1, "s", "between two looks at the floor", least=0.001)
    patience: float = tunable(
        30.0, "times", "as long as planned, and 60 s more, may a run take", least=1.0
    )
    still: float = tunable(
        5.0, "s", "in which nothing happens, though nothing is disturbed: a deadlock", least=0.1
    )


@dataclass(frozen=True)
class ExecutionTuning(Tunables):
    """The tunables of execution."""

    reorder: ReorderTuning = field(default_factory=ReorderTuning)
    pace: RobotPaceTuning = field(default_factory=RobotPaceTuning)
    floor: FloorTuning = field(default_factory=FloorTuning)
