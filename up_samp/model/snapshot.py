"""A SAMP problem as plain values: what moves, from where to where, and what else changes."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field

from up_samp.model.bodies import Configuration, Movable
from up_samp.model.frames import Frame, PlacedMap


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
    ``index`` is the constraint's place among those of its activity, ``map`` the number of the map
    that it drives on.
    """

    activity: str
    index: int
    object: str
    terms: tuple[Term, ...]
    static: frozenset[str] | None = None
    dynamic: frozenset[str] | None = None
    map: int = 0

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
    ``maps`` are the occupancy maps (none: the open plane), ``map_of`` tells the number of each
    configuration's map. Poses are in the world frame; where several maps were laid out side by
    side in one plane, they are in that plane, and ``to_world`` holds each map's way back.
    """

    name: str
    maps: tuple[PlacedMap, ...]
    objects: Mapping[str, Movable]
    configurations: Mapping[str, Configuration]
    initial: Mapping[str, str]
    tasks: tuple[MotionTask, ...]
    changes: tuple[ChangeTask, ...]
    seconds_per_unit: float = 1.0
    map_of: Mapping[str, int] = field(default_factory=dict)
    to_world: tuple[Frame, ...] = ()

    @property
    def map_file(self) -> str | None:
        """The ROS YAML of the first map."""
        return self.maps[0].file if self.maps else None

    def tasks_of(self, activity: str) -> tuple[MotionTask, ...]:
        """Return the motion tasks of an activity."""
        return tuple(t for t in self.tasks if t.activity == activity)

    def moved(self) -> frozenset[str]:
        """Return the objects that some activity moves or changes."""
        return frozenset(t.object for t in self.tasks) | frozenset(c.object for c in self.changes)
