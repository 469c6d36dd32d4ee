"""What a SAMP problem and a plan say about motions: who is driven when, through which poses, clear
of whom, and which loads travel with what carries them (rule 18).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from unified_planning.model.motion import (
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MovableObject,
)

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import FloatArray
from up_samp.model.frames import PlacedMap
from up_samp.validation.collisions import BlockedMap, JudgedShape, ground_of, placed
from up_samp.validation.kinematics import Limits, height_of, limits_of
from up_samp.validation.se3 import Solid, load_solid
from up_samp.validation.timeline import (
    MISSING,
    Key,
    Reading,
    StateTimeline,
    present_activities,
    reader_at,
    show,
    telling,
)
from up_samp.validation.tolerances import TOLERANCES


@dataclass(frozen=True)
class Obstacle:
    """An obstacle that a motion constraint lists; ``place`` is the configuration that its fluent
    has at the activity's start (``None``: the list gives none), ``key`` that fluent.
    """

    name: str
    static: bool
    place: str | None = None
    key: Key | None = None


@dataclass(frozen=True)
class JudgedMotion:
    """A motion constraint of a present activity. Times in schedule units; ``places`` are the
    names of the configurations, the starting one first; ``obstacles`` is ``None`` for "all".
    """

    name: str
    """The activity's name, with ``#k`` for its k-th further constraint: the trajectory's key."""
    activity: str
    constraint: Any
    object: str
    places: tuple[str, ...]
    start: int
    end: int
    obstacles: tuple[Obstacle, ...] | None
    together: frozenset[str] = frozenset()
    """The object and all loads that travel with it: one body."""

    @property
    def what(self) -> str:
        """Return the activity, the object and the times, for people."""
        return f"{self.name} [{self.start}, {self.end}] moving {self.object}"


@dataclass(frozen=True)
class Jump:
    """A motion effect: ``object`` is at configuration ``place`` from ``time`` on (units)."""

    activity: str
    object: str
    place: str
    time: int


Pose = tuple[float, ...]


@dataclass(frozen=True)
class CarriedLoad:
    """``load`` travels with the carrier of the task ``task``: it stands at ``offset`` in the
    carrier's frame all the while, and at configuration ``goal`` after that.
    """

    activity: str
    task: str
    load: str
    goal: str
    offset: Pose


def offset_between(carrier: Pose, load: Pose) -> Pose:
    """Return a load's pose in its carrier's frame."""
    turn = complex(math.cos(carrier[2]), -math.sin(carrier[2]))
    way = turn * complex(load[0] - carrier[0], load[1] - carrier[1])
    return way.real, way.imag, load[2] - carrier[2]


def is_same(one: Pose, other: Pose) -> bool:
    """Return whether two offsets are the same, but for rounding."""
    turned = abs(complex(math.cos(one[2]), math.sin(one[2])) - complex(
        math.cos(other[2]), math.sin(other[2])))  # fmt: skip
    return max(math.hypot(one[0] - other[0], one[1] - other[1]), turned) <= TOLERANCES.rigid


def carried_along(poses: FloatArray, offset: Pose) -> FloatArray:
    """Return the poses (n, 3) of a load on a carrier at ``poses`` (n, 3)."""
    points = placed(np.array([offset[:2]]), poses)[:, 0]
    return np.column_stack((points, poses[:, 2] + offset[2]))


def between(carrier: JudgedShape, loads: Sequence[tuple[JudgedShape, Pose]]) -> JudgedShape | None:
    """Return what holds a carrier and its loads together, in the carrier's frame: nothing where
    they are one polygon without holes, else their convex hull.
    """
    parts = [shapely.Polygon(carrier.corners)]
    for shape, offset in loads:
        parts.append(shapely.Polygon(placed(shape.corners, np.array([offset]))[0]))
    grown = shapely.union_all([p.buffer(TOLERANCES.closed_gap, join_style="mitre") for p in parts])
    if grown.geom_type == "Polygon" and all(
        shapely.Polygon(hole).buffer(-TOLERANCES.closed_gap).is_empty for hole in grown.interiors
    ):
        return None
    hull = shapely.union_all(parts).convex_hull
    height = max(carrier.height, *(shape.height for shape, _ in loads))
    return JudgedShape(f"{carrier.name} with its load", np.array(hull.exterior.coords)[:-1], height)


@dataclass(frozen=True)
class JudgedScene:
    """A SAMP problem under a schedule. Values are read by the rules of ``docs/semantics.md``."""

    problem: Any
    timeline: StateTimeline

    @cached_property
    def movables(self) -> dict[str, Any]:
        """The problem's movable objects by name."""
        return {o.name: o for o in self.problem.all_objects if isinstance(o, MovableObject)}

    @cached_property
    def limits(self) -> dict[str, Limits]:
        """What each movable object's motion is limited to."""
        return {name: limits_of(item) for name, item in self.movables.items()}

    @cached_property
    def shapes(self) -> dict[str, JudgedShape | Solid]:
        """Footprints by object; meshes of those that move in space."""
        shapes: dict[str, JudgedShape | Solid] = {}
        for name, item in self.movables.items():
            if item.motion_model.name == "SE3":
                shapes[name] = load_solid(name, item.geometric_model)
                continue
            if item.footprint is None:
                raise UnsupportedError(f"object {name} moves in the plane but has no footprint")
            height = height_of(item)
            shapes[name] = JudgedShape(name, np.array(item.footprint, dtype=float), height)
        return shapes

    @cached_property
    def grounds(self) -> dict[str, PlacedMap]:
        """What each configuration lies on: its type's map."""
        places = [o for o in self.problem.all_objects if isinstance(o, ConfigurationObject)]
        found = {o.name: ground_of(o.type.occupancy_map) for o in places}
        solid = [n for n, o in self.movables.items() if o.motion_model.name == "SE3"]
        if solid and len({g.height for g in found.values()}) > 1:
            raise UnsupportedError(f"object {solid[0]} moves in space, and maps differ in height")
        return found

    @cached_property
    def maps(self) -> dict[PlacedMap, BlockedMap]:
        """The occupancy maps."""
        return {g: BlockedMap(g.file, g.frame) for g in dict.fromkeys(self.grounds.values())}

    def map_driven(self, task: JudgedMotion) -> BlockedMap:
        """Return the map that a motion drives on (rule 21)."""
        grounds = {self.grounds[place] for place in task.places}
        if len(grounds) > 1:
            raise UnsupportedError(f"{task.what} leads from map to map")
        return self.maps[grounds.pop()]

    def height(self, place: str) -> float:
        """Return the height (m) of a configuration's map: at different ones, nothing meets."""
        return self.grounds[place].height

    def pose(self, place: str) -> tuple[float, ...]:
        """Return the pose of a configuration object, by name."""
        item = self.problem.object(place)
        if not isinstance(item, ConfigurationObject):
            raise ProblemError(f"object {place} is used as a configuration but is none")
        return tuple(float(v) for v in item.configuration)

    @cached_property
    def initial(self) -> dict[str, str]:
        """Each movable object's initial configuration (by names), where it has one."""
        found: dict[str, str] = {}
        for movable, place in self.problem.initial_configuration:
            name = self._name(movable, 0, None, "an initial configuration")
            value = self._name(place, 0, None, f"the initial configuration of {name}")
            if found.setdefault(name, value) != value:
                raise ProblemError(f"object {name} has two initial configurations")
        return found

    @cached_property
    def tasks(self) -> list[JudgedMotion]:
        """All motion constraints of present activities."""
        found = []
        for task in self._constraints:
            loads = {r.load for r in self.rides if r.task == task.name}
            mine = None
            if task.obstacles is not None:
                mine = tuple(o for o in task.obstacles if o.name not in loads)
            found.append(replace(task, obstacles=mine, together=frozenset({task.object, *loads})))
        return found

    @cached_property
    def _constraints(self) -> list[JudgedMotion]:
        return [task for activity in self._present() for task in self._tasks_of(activity)]

    @cached_property
    def rides(self) -> list[CarriedLoad]:
        """All loads that travel with what an activity drives (rule 18)."""
        found = []
        for effect in self._settings:
            tasks = [t for t in self._constraints if t.activity == effect.activity]
            mine = [ride for ride in (self._ride(t, effect) for t in tasks) if ride is not None]
            if len(mine) > 1:
                raise UnsupportedError(
                    f"{effect.activity}: {effect.object} travels with two objects at once"
                )
            found += mine
        return found

    def _ride(self, task: JudgedMotion, effect: Jump) -> CarriedLoad | None:
        if effect.object == task.object or any(
            self.movables[name].motion_model.name == "SE3" for name in (effect.object, task.object)
        ):
            return None
        floor = self.height(task.places[0])
        if abs(self.height(effect.place) - floor) > TOLERANCES.height:
            return None
        start, goal = self.pose(task.places[0]), self.pose(task.places[-1])
        offset = offset_between(goal, self.pose(effect.place))
        stands = (offset_between(start, pose) for pose in self._stands(effect.object, floor))
        if not any(is_same(offset, other) for other in stands):
            return None
        return CarriedLoad(task.activity, task.name, effect.object, effect.place, offset)

    def _stands(self, name: str, floor: float) -> list[tuple[float, ...]]:
        """Return all poses on a floor that the problem gives an object that is carried."""
        values: list[str | None] = [self.initial[name]] if name in self.initial else []
        values += [
            place.object().name if place.is_object_exp() else None
            for activity in self.problem.activities
            for movable, place in getattr(activity, "motion_effects", {}).items()
            if movable.is_object_exp() and movable.object().name == name
        ]
        # where one is not said, it may be any
        places = self.grounds if None in values else [p for p in values if p is not None]
        poses = (self.pose(n) for n in places if abs(self.height(n) - floor) <= TOLERANCES.height)
        return [pose for pose in poses if len(pose) == 3]

    @cached_property
    def carried(self) -> dict[str, frozenset[str]]:
        """What each present activity moves by effects alone: no obstacle to what it drives."""
        found: dict[str, set[str]] = {}
        for jump in self._settings:
            found.setdefault(jump.activity, set()).add(jump.object)
        return {activity: frozenset(names) for activity, names in found.items()}

    @cached_property
    def heeds(self) -> dict[str, frozenset[str] | None]:
        """Object -> what some motion constraint on it in the problem (of a present activity or
        not) keeps clear of (``None``: of everything).
        """
        found: dict[str, frozenset[str] | None] = {}
        for activity in self.problem.activities:
            for constraint in getattr(activity, "motion_constraints", ()):
                if not constraint.movable.is_object_exp():
                    continue
                name = constraint.movable.object().name
                lists = (constraint.static_obstacles, constraint.dynamic_obstacles_at_start)
                before = found.get(name, frozenset())
                if before is None or all(items is None for items in lists):
                    found[name] = None
                else:
                    listed = {o.name for items in lists for o in items or ()}
                    found[name] = before | listed
        return found

    def counts(self, one: str, other: str) -> bool:
        """Return whether ``one``, when it drives, has ever to keep clear of ``other``."""
        heeded = self.heeds.get(one, frozenset())
        return heeded is None or other in heeded

    def avoids(self, task: JudgedMotion, name: str) -> bool:
        """Return whether a task keeps clear of object ``name``."""
        if name in task.together:
            return False
        if task.obstacles is None:
            return name not in self.carried.get(task.activity, ())
        return any(o.name == name for o in task.obstacles)

    @cached_property
    def jumps(self) -> list[Jump]:
        """All motion effects of present activities that set an object elsewhere in an instant
        (at the activity's end): those of rides do not.
        """
        rides = {(r.activity, r.load) for r in self.rides}
        return [e for e in self.effects if (e.activity, e.object) not in rides]

    @cached_property
    def _settings(self) -> list[Jump]:
        """The motion effects on objects that their activity does not drive as well."""
        driven = {(t.activity, t.object) for t in self._constraints}
        return [e for e in self.effects if (e.activity, e.object) not in driven]

    @cached_property
    def effects(self) -> list[Jump]:
        """All motion effects of present activities, with the configurations that they mean."""
        found = []
        for activity in self._present():
            _, end = self.timeline.decisions.times[activity.name]
            for movable, place in activity.motion_effects.items():
                what = f"a motion effect of {activity.name}"
                name = self._name(movable, end, activity.name, what)
                target = self._name(place, end, activity.name, what)
                found.append(Jump(activity.name, name, target, end))
        return found

    def _present(self) -> list[Any]:
        present = present_activities(self.problem, self.timeline)
        return [a for a in present if isinstance(a, MotionActivity)]

    def _tasks_of(self, activity: Any) -> Iterator[JudgedMotion]:
        start, end = self.timeline.decisions.times[activity.name]
        for k, constraint in enumerate(activity.motion_constraints):
            if not isinstance(constraint, ActivityWaypoints):
                raise UnsupportedError(
                    f"{activity.name}: motion constraint {type(constraint).__name__}"
                )
            what = f"the motion constraint of {activity.name}"
            places = tuple(
                self._name(node, start, activity.name, what)
                for node in (constraint.starting, *constraint.waypoints)
            )
            yield JudgedMotion(
                activity.name if k == 0 else f"{activity.name}#{k}",
                activity.name,
                constraint,
                self._name(constraint.movable, start, activity.name, what),
                places,
                start,
                end,
                self._obstacles(constraint, start, activity.name),
            )

    def _obstacles(self, constraint: Any, start: int, owner: str) -> tuple[Obstacle, ...] | None:
        lists = (
            (constraint.static_obstacles, True),
            (constraint.dynamic_obstacles_at_start, False),
        )
        if all(items is None for items, _ in lists):
            return None
        found = []
        for items, static in lists:
            for item in items or ():
                if not isinstance(items, dict):
                    found.append(Obstacle(item.name, static))
                    continue
                node = telling(items[item], item)
                what = f"the configuration of obstacle {item.name} of {owner}"
                place = self._name(node, start, owner, what)
                reader = reader_at(self.timeline, start, Reading.LATER, owner)
                key = reader.key(node) if node.is_fluent_exp() else None
                found.append(Obstacle(item.name, static, place, key))
        return tuple(found)

    def _name(self, node: Any, instant: int, owner: str | None, what: str) -> str:
        """Return the name of the object that an expression means at an instant (rule 14)."""
        value = reader_at(self.timeline, instant, Reading.LATER, owner).value(node)
        if value is MISSING or not isinstance(value, str):
            raise ProblemError(f"'{node}' in {what} names no object")
        return value

    def fluent_moves(self, obstacle: Obstacle, task: JudgedMotion) -> str | None:
        """Return when a static obstacle's fluent changes during a task, but for its last unit."""
        if obstacle.key is None:
            return None
        for change in self.timeline.changes:
            if change.key == obstacle.key and task.start <= change.time < task.end - 1:
                value = self.timeline.value(change.key, change.time, Reading.AT_ONCE)
                if value != obstacle.place:
                    return f"{show(change.key)} becomes {value} at {change.time}"
        return None
