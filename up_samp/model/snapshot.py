"""A SAMP problem as plain values: what moves, from where to where, and what else changes."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from up_samp.model.bodies import Configuration, Movable


class TermKind(enum.Enum):
    """How a configuration is given."""

    CONSTANT = "configuration object"
    PARAMETER = "activity parameter or variable"
    FLUENT = "fluent"


@dataclass(frozen=True)
class Term:
    """A configuration as the problem states it.

    ``name`` is a configuration's name, ``activity.parameter``, or the text of a ground fluent.
    """

    kind: TermKind
    name: str


@dataclass(frozen=True)
class MotionTask:
    """One motion constraint: ``activity`` drives ``object`` through ``terms`` (start first).

    ``static`` and ``dynamic`` name the obstacles that the constraint lists (``None``: not given).
    ``index`` is the constraint's place among those of its activity.
    """

    activity: str
    index: int
    object: str
    terms: tuple[Term, ...]
    static: frozenset[str] | None = None
    dynamic: frozenset[str] | None = None

    @property
    def avoid(self) -> frozenset[str] | None:
        """Objects to keep clear of; ``None`` means all others."""
        if self.static is None and self.dynamic is None:
            return None
        return (self.static or frozenset()) | (self.dynamic or frozenset())


@dataclass(frozen=True)
class ChangeTask:
    """An instantaneous change of ``object``'s configuration at the end of ``activity``."""

    activity: str
    object: str
    term: Term


@dataclass(frozen=True)
class Snapshot:
    """All that motions need to know of a problem.

    ``configurations`` maps names to poses, ``initial`` objects to names of configurations.
    ``map_file`` is the ROS YAML of the occupancy map (``None``: the problem has no map).
    """

    name: str
    map_file: str | None
    objects: Mapping[str, Movable]
    configurations: Mapping[str, Configuration]
    initial: Mapping[str, str]
    tasks: tuple[MotionTask, ...]
    changes: tuple[ChangeTask, ...]
    seconds_per_unit: float = 1.0

    def tasks_of(self, activity: str) -> tuple[MotionTask, ...]:
        """Return the motion tasks of an activity."""
        return tuple(t for t in self.tasks if t.activity == activity)

    def moved(self) -> frozenset[str]:
        """Return the objects that some activity moves or changes."""
        return frozenset(t.object for t in self.tasks) | frozenset(c.object for c in self.changes)
