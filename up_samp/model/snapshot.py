"""A SAMP problem as plain values: what moves, from where to where, and what else changes."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from up_samp.model.bodies import Body, Configuration, Movable
from up_samp.model.frames import Frame, PlacedMap
from up_samp.model.graphs import grouped


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
class Ride:
    """``load`` travels on what ``activity`` drives: it is at ``origin`` before and at ``goal``
    after, and ``offset`` (x, y, theta) is its pose in its carrier's frame.
    """

    activity: str
    load: str
    origin: Term
    goal: Term
    offset: Configuration


@dataclass(frozen=True)
class MotionTask:
    """One motion constraint: ``activity`` drives ``object`` through ``terms`` (start first).

    ``static`` and ``dynamic`` name the obstacles that the constraint lists (``None``: not given).
    ``index`` is the constraint's place among those of its activity, ``map`` the number of the map
    that it drives on. ``rides`` are the loads that travel with the object: all of them are one
    body (:meth:`Snapshot.body`).
    """

    activity: str
    index: int
    object: str
    terms: tuple[Term, ...]
    static: frozenset[str] | None = None
    dynamic: frozenset[str] | None = None
    map: int = 0
    rides: tuple[Ride, ...] = ()

    @property
    def avoid(self) -> frozenset[str] | None:
        """Objects to keep clear of; ``None`` means all others."""
        if self.static is None and self.dynamic is None:
            return None
        return (self.static or frozenset()) | (self.dynamic or frozenset())

    @property
    def moved(self) -> frozenset[str]:
        """The object and its loads."""
        return frozenset((self.object, *(ride.load for ride in self.rides)))


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
    ``laden`` are the bodies of motion tasks with loads, by activity and index. ``alike`` has the
    names of all configurations of one pose, by each of them, where it has several: an object that
    the problem leads there by several has one name for it here (``renamed``), or, where names are
    decided, whichever is chosen.
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
    laden: Mapping[tuple[str, int], Body] = field(default_factory=dict)
    alike: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    renamed: frozenset[str] = frozenset()

    @property
    def map_file(self) -> str | None:
        """The ROS YAML of the first map."""
        return self.maps[0].file if self.maps else None

    def body(self, activity: str, index: int, name: str) -> Body:
        """Return what a motion task drives: the object ``name``, with its loads if it has any."""
        return self.laden.get((activity, index)) or self.objects[name].body

    @cached_property
    def rides(self) -> tuple[Ride, ...]:
        """All rides of all tasks."""
        return tuple(ride for task in self.tasks for ride in task.rides)

    @cached_property
    def movers(self) -> Mapping[str, frozenset[str]]:
        """Object -> activities that drive it, carry it or change it."""
        found: dict[str, set[str]] = {name: set() for name in self.objects}
        for task in self.tasks:
            found[task.object].add(task.activity)
        for ride in self.rides:
            found[ride.load].add(ride.activity)
        for change in self.changes:
            found[change.object].add(change.activity)
        return {name: frozenset(v) for name, v in found.items()}

    @cached_property
    def moved_otherwise(self) -> frozenset[str]:
        """Objects that something else moves than drives of their own."""
        return frozenset((*(c.object for c in self.changes), *(r.load for r in self.rides)))

    @cached_property
    def heeded(self) -> Mapping[str, frozenset[str]]:
        """What every motion of an object that drives or rides keeps clear of."""
        found: dict[str, frozenset[str]] = {}
        everything = frozenset(self.objects)
        for task in self.tasks:
            told = everything if task.avoid is None else task.avoid
            found.update({name: told & found.get(name, everything) for name in task.moved})
        return found

    @cached_property
    def by_activity(self) -> Mapping[str, Sequence[MotionTask]]:
        """The motion tasks of each activity that has some."""
        return grouped(self.tasks, lambda task: task.activity)

    @cached_property
    def by_object(self) -> Mapping[str, Sequence[MotionTask]]:
        """The motion tasks of each object that drives."""
        return grouped(self.tasks, lambda task: task.object)

    def moved(self) -> frozenset[str]:
        """Return the objects that some activity moves or changes."""
        return frozenset(name for name, movers in self.movers.items() if movers)
