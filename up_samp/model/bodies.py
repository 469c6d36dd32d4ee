"""What moves: shapes, kinematics and named objects. Lengths in m, angles in rad, times in s."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from up_samp.model.frames import Frame

Configuration = tuple[float, ...]
"""``(x, y, theta)`` for SE2, ``(x, y, z, qx, qy, qz, qw)`` for SE3, in the world frame."""


def same_pose(p: Configuration, q: Configuration, within: float = 1e-7) -> bool:
    """Return whether two poses are one but for so much (m, rad), whatever whole turns lie between
    their headings: nothing is driven from one to the other.
    """
    if len(p) != 3:
        return tuple(p) == tuple(q)
    apart = p[0] - q[0], p[1] - q[1], math.remainder(p[2] - q[2], 2 * math.pi)
    return max(map(abs, apart)) <= within


def stays(poses: Sequence[Configuration]) -> bool:
    """Return whether a motion through these poses leads nowhere: who makes it may rest meanwhile,
    whatever lies there.
    """
    return all(same_pose(poses[0], pose) for pose in poses)


@dataclass(frozen=True)
class Mobility:
    """What bodies of a motion model can do.

    ``flies``: through space, else it moves in the plane. ``sideways``: in any direction at any
    heading (omnidirectional). ``pivots``: it turns on the spot. ``steers``: it turns only as it
    drives, no tighter than its turning radius (a car). ``own_law``: none of this is known, it has
    its own equations of motion.
    """

    flies: bool = False
    sideways: bool = False
    pivots: bool = False
    steers: bool = False
    own_law: bool = False

    @property
    def rolls(self) -> bool:
        """Whether it drives along its heading between turns on the spot (two driven wheels)."""
        return self.pivots and not self.sideways

    @property
    def size(self) -> int:
        """How many numbers a configuration has."""
        return 7 if self.flies else 3


class MotionModel(enum.Enum):
    """How a body moves. ``PIVOT`` drives along its heading and turns on the spot (two driven
    wheels); a problem states it as REEDSSHEPP with ``turning_radius`` 0.

    What is planned for each of them and how stands in :mod:`up_samp.motion.models`; elsewhere it
    counts what a body can do, not what its model is called.
    """

    REEDSSHEPP = "REEDSSHEPP"
    PIVOT = "PIVOT"
    SE2 = "SE2"
    SE3 = "SE3"
    CONTROL = "CONTROL"

    @property
    def mobility(self) -> Mobility:
        """What bodies of this model can do."""
        return _MOBILITY[self]


_MOBILITY = {
    MotionModel.REEDSSHEPP: Mobility(steers=True),
    MotionModel.PIVOT: Mobility(pivots=True),
    MotionModel.SE2: Mobility(sideways=True, pivots=True),
    MotionModel.SE3: Mobility(flies=True),
    MotionModel.CONTROL: Mobility(own_law=True),
}


@dataclass(frozen=True)
class ControlLaw:
    """A body's own equations of motion ``qdot = f(q, u)`` (``f`` fills ``qdot`` in place).

    ``bounds`` are ``(name, low, high)`` for each component of ``u``, in order. ``owner`` names an
    object that moves so, for messages.
    """

    function: Callable[[Any, Any, Any], None]
    bounds: tuple[tuple[str, float, float], ...]
    owner: str = field(default="", compare=False)


@dataclass(frozen=True)
class TrafficZone:
    """Rules of a part of the floor, for the robots that it is given to: corners of its ``polygon``
    (m, world frame) on maps ``height`` m up.

    While any part of a robot's body is in it, its speed is at most ``v_max`` (m/s), and it does not
    turn on the spot, or stand, unless it may (``pivots``, ``stops``). While its reference point is
    in it, it does not move against the heading ``one_way`` (rad; None: any way). With ``dock`` all
    this binds only motions that end at that pose (m, m, rad, world frame), and these come to it
    straight, along its heading, ahead or backwards, from where their reference point last comes
    into the zone. Rules 22 and on of ``docs/semantics.md``. Wishes, and no rules: so many seconds
    does a planner count for driving through it (``cost``), or for each second beside what is
    preferred (``prefer``, 1 or more: how much it is; it is driven along the middle of its length).
    """

    polygon: tuple[tuple[float, float], ...]
    v_max: float = math.inf
    height: float = 0.0
    one_way: float | None = None
    pivots: bool = True
    stops: bool = True
    cost: float = 0.0
    prefer: float = 1.0
    dock: tuple[float, float, float] | None = None

    def binds(self, goal: Sequence[float]) -> bool:
        """Return whether it binds a motion that ends at a planar pose."""
        return self.dock is None or same_pose(self.dock, tuple(goal), 1e-3)

    def off_dock(self, pose: Sequence[float]) -> tuple[float, float]:
        """Return how far (m) ahead of its dock a pose is, and how far (m, rad) off the line through
        the dock along its heading.
        """
        assert self.dock is not None
        ahead, aside, turned = Frame(*self.dock).seen(pose)
        return ahead, max(abs(aside), abs(turned))

    @property
    def long(self) -> float:
        """How long (m) the straight way through it to its dock is."""
        return max(abs(self.off_dock((*corner, 0.0))[0]) for corner in self.polygon)

    def leads_in(self, start: Sequence[float]) -> bool:
        """Return whether a pose is on the straight way to its dock: in the zone, or 5 cm before
        that at most, where it begins.
        """
        ahead, off = self.off_dock(start)
        along = [self.off_dock((*corner, 0.0))[0] for corner in self.polygon]
        most = 0.05 if abs(ahead) >= self.long else 0.0
        return off <= 1e-4 and min(along) - most <= ahead <= max(along) + most

    @property
    def turned(self) -> TrafficZone:
        """The zone for motions that are told backwards in time."""
        return self if self.one_way is None else replace(self, one_way=self.one_way + math.pi)


@dataclass(frozen=True)
class Kinematics:
    """Limits of motion. ``turning_radius`` in m, ``v_max`` in m/s, ``a_max`` in m/s^2,
    ``omega_max`` in rad/s; ``omega_max`` binds all but cars: a car's turn rate follows from its
    speed and turning radius. ``reverse``: whether it may be driven against its heading, and
    ``v_back`` the top speed (m/s) then; a body that moves in any direction, or by equations of its
    own, has nothing to forbid; nor has it a limit of the lateral acceleration in bends
    (``lateral_a_max``, m/s^2), or of changes of the turn rate (``alpha_max``, rad/s^2), which both
    are infinite where nothing is said. ``back_cost``, a wish and no limit: a planner counts a
    second backwards so many times. ``zones``: rules of places, for bodies in the plane that
    have no equations of their own. ``drives_along``: when another body takes it along, it drives,
    too, on its own wheels, and keeps these limits where it is; it moves in any direction, and so
    does whoever takes it along. ``reach`` (m) of a body that moves in any direction: as far from
    its reference point speed and acceleration are within the limits, also as it turns. ``parts`` of
    bodies that drive together: where each is in the frame of the first one, with its own limits;
    planners keep all of them within less than that.
    """

    model: MotionModel
    turning_radius: float = 1.0
    v_max: float = 1.0
    a_max: float = 1.0
    omega_max: float = 1.0
    control: ControlLaw | None = None
    reverse: bool = True
    v_back: float = math.inf
    lateral_a_max: float = math.inf
    alpha_max: float = math.inf
    zones: tuple[TrafficZone, ...] = ()
    back_cost: float = 1.0
    drives_along: bool = False
    reach: float = 0.0
    parts: tuple[tuple[Configuration, Kinematics], ...] = ()

    def __post_init__(self) -> None:
        for name in ("turning_radius", "v_max", "a_max", "omega_max"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a positive finite number, not {value!r}")
        for name in ("v_back", "lateral_a_max", "alpha_max"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")
        able = self.mobility
        along = able.steers or able.rolls
        usual = self.reverse and math.isinf(self.v_back) and self.back_cost == 1.0
        for told, right in (
            (f"back_cost is 1 or more, not {self.back_cost!r}", 1.0 <= self.back_cost < math.inf),
            ("only who drives along its heading reverses", along or usual),
            (
                "only who drives along its heading has a lateral_a_max or an alpha_max: "
                "leave them out, or state less v_max, a_max or omega_max",
                along or not self.heeds_turns,
            ),
            (
                "only who moves in any direction drives along with others",
                able.sideways or not self.drives_along,
            ),
            (
                "zones are for bodies in the plane without equations of their own",
                not self.zones or not (able.flies or able.own_law),
            ),
        ):
            if not right:
                raise ValueError(told)

    @property
    def mobility(self) -> Mobility:
        """What a body with these limits can do."""
        return self.model.mobility

    @property
    def own(self) -> Kinematics:
        """What the reference point keeps to by itself: of bodies that drive together, the limits of
        the first one.
        """
        return self.parts[0][1] if self.parts else self

    @property
    def heeds_turns(self) -> bool:
        """Whether its lateral acceleration, or that of its turns, is limited."""
        return math.isfinite(self.lateral_a_max) or math.isfinite(self.alpha_max)

    @cached_property
    def ways(self) -> tuple[TrafficZone, ...]:
        """The zones that say which ways may be driven, whatever their speed."""
        zones = [z for z in self.zones if z.one_way is not None or not z.pivots]
        return tuple(replace(zone, v_max=math.inf) for zone in zones)

    @cached_property
    def no_stops(self) -> tuple[TrafficZone, ...]:
        """The zones in which it does not stand."""
        return tuple(zone for zone in self.zones if not zone.stops)

    @cached_property
    def lanes(self) -> tuple[TrafficZone, ...]:
        """The zones that it prefers to what is beside them."""
        return tuple(zone for zone in self.zones if zone.prefer > 1.0)

    @property
    def both_ways(self) -> bool:
        """Whether every way may be driven from its end to its start, too."""
        return self.reverse and all(zone.one_way is None for zone in self.zones)

    @property
    def bend_radius(self) -> float:
        """The tightest turn while driving (m); 0 for what turns on the spot."""
        return 0.0 if self.mobility.pivots else self.turning_radius


@dataclass(frozen=True)
class Body:
    """A shape and how it moves. Two objects with equal bodies are *equivalent*.

    ``footprint`` is a simple polygon, counter-clockwise or clockwise, in the body frame
    (reference point at the origin, heading along +x). ``mesh`` is a file for SE3 bodies.
    ``height`` (m above the floor): what is higher is above a body that moves in the plane. ``low``:
    how high the lowest part of what is driven as one body is.
    """

    footprint: tuple[tuple[float, float], ...]
    kinematics: Kinematics
    mesh: str | None = None
    height: float = math.inf
    low: float = math.inf

    def __hash__(self) -> int:
        # what is known of drives is looked up by bodies all the time, and few share a footprint
        return hash(self.footprint)

    @property
    def mobility(self) -> Mobility:
        """What it can do."""
        return self.kinematics.mobility

    @property
    def flies(self) -> bool:
        """Whether it moves in space."""
        return self.mobility.flies

    @property
    def but_docks(self) -> Body:
        """The same without what its docks ask for."""
        zones = tuple(zone for zone in self.kinematics.zones if zone.dock is None)
        return replace(self, kinematics=replace(self.kinematics, zones=zones))


@dataclass(frozen=True)
class Movable:
    """A named movable object of the problem."""

    name: str
    type_name: str
    body: Body


@dataclass(frozen=True)
class Placed:
    """A named body that rests at a configuration."""

    name: str
    body: Body
    pose: Configuration
