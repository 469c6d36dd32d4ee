"""What a fleet problem says, as frozen records: the one source of ``Fleet`` and of problem files.

Lengths in m, angles in rad, times in s; poses are ``(x, y, theta)`` in the map's world frame.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, MaxLen, MinLen
from pydantic import (
    BeforeValidator,
    TypeAdapter,
    WrapValidator,
)

from up_samp.fleet.fields import (
    FILE_LIMITS,
    NUMBER,
    STRICT,
    Clearance,
    Coordinate,
    Count,
    Length,
    Moment,
    Name,
    Names,
    Outline,
    Point,
    Polygon,
    Pose,
    Positive,
    Rate,
    Seconds,
    Share,
    Some,
    Visits,
    Window,
    Windows,
)
from up_samp.io.precision import PRECISION
from up_samp.model.graphs import grouped


@dataclass(frozen=True)
class Battery:
    """What robots of a type have of energy, in units of the user's own (Wh, or percent).

    A drive takes ``per_metre`` for each metre and ``per_second`` for each second of the drive
    that the robot makes when nobody is in its way; a level never falls below ``reserve``. ``level``
    is that at first (full where none is given). ``curve``: from a level on, chargers give only so
    much of what they give, as in ``[[80, 0.4], [95, 0.1]]``.
    """

    __pydantic_config__ = STRICT
    capacity: Positive
    per_metre: Rate = 0.0
    per_second: Rate = 0.0
    reserve: Rate = 0.0
    level: Positive | None = None
    curve: tuple[tuple[Positive, Share], ...] = ()
    grains: ClassVar[int] = 1000
    """A full one holds so many of the whole numbers that levels are counted in."""

    @property
    def first(self) -> float:
        """The level at first, where the robot says nothing else."""
        return self.capacity if self.level is None else self.level


@dataclass(frozen=True)
class Charger:
    """A place to charge at: ``per_second`` is what it gives, in steps of ``step`` s; or where a
    battery is swapped for a full one, which takes ``swap`` s. Each robot may come to it ``times``
    times.
    """

    __pydantic_config__ = STRICT
    per_second: Positive | None = None
    swap: Seconds | None = None
    step: Seconds = 30.0
    times: Visits = 1


@dataclass(frozen=True)
class RobotType:
    """What robots of a type have in common.

    ``model``: ``car`` drives forwards and backwards on curves no tighter than ``turning_radius``;
    ``diff`` has two driven wheels (it drives along its heading and turns on the spot); ``omni``
    drives in any direction. ``turning_radius`` is for cars, ``omega_max`` for the others.
    ``reverse``: ``free``; ``slow``: at ``reverse_v_max`` (m/s) at most; or ``never``: it drives
    ahead only, as what looks ahead only should (a ``diff`` still turns on the spot).
    ``reverse_cost``: a second backwards counts so many times in the choice of ways (none: 1.5, as
    most look ahead; 1: they do not mind).
    ``lateral_a_max`` (m/s^2) limits the speed in bends, ``alpha_max`` (rad/s^2) how fast the turn
    rate changes, of cars and diffs; none: no limit. ``pivoting``:
    a ``diff`` that never turns on the spot drives on curves no tighter than it can at top speed
    (``v_max / omega_max``). ``capacity``: how many loads of a kind fit on it at a time;
    ``unloading``: in any order, or ``lifo``: what was picked up last is delivered first.
    ``battery``: what drives take from; none: it never runs out. ``costs``: of each robot that
    leaves where it starts (``used``), of a kilometre and of an hour of driving, in money.
    ``localisation``: how far (m) from the truth they tell to be; ``latency``: by how many seconds
    what they tell, and obey, may be late (both for a day that is operated).
    """

    __pydantic_config__ = STRICT
    footprint: Outline
    model: Literal["car", "diff", "omni"] = "car"
    turning_radius: Length = 1.0
    v_max: Positive = 1.0
    a_max: Positive = 1.0
    omega_max: Positive = 1.0
    reverse: Literal["free", "slow", "never"] = "free"
    reverse_v_max: Positive | None = None
    reverse_cost: Annotated[float, Ge(1), Le(FILE_LIMITS.largest), NUMBER] | None = None
    lateral_a_max: Positive | None = None
    alpha_max: Positive | None = None
    pivoting: Literal["free", "never"] = "free"
    capacity: Mapping[Name, Count] = field(default_factory=lambda: {"item": 1})
    unloading: Literal["any", "lifo"] = "any"
    battery: Battery | None = None
    costs: Mapping[Literal["used", "per_km", "per_hour"], Rate] = field(default_factory=dict)
    localisation: Clearance | None = None
    latency: Moment | None = None

    @property
    def back_cost(self) -> float:
        """How many times a second backwards counts; 1 for what has no back, or never goes there."""
        minds = self.model != "omni" and self.reverse != "never"
        return self.reverse_cost or (1.5 if minds else 1.0)


def _start(value: Any, by_name: Callable[[Any], str]) -> Any:
    """Let a pose through: it becomes a place of its own (:mod:`up_samp.fleet.spelled_out`)."""
    if not isinstance(value, list | tuple):
        return by_name(value)
    if len(value) != 3:
        raise ValueError("name a place, or give a pose [x, y, theta]")
    return _POSE.validate_python(value)


_POSE: TypeAdapter[Any] = TypeAdapter(Pose)
Start = Annotated[Name, WrapValidator(_start)]


@dataclass(frozen=True)
class Break:
    """A robot rests for ``duration`` s wherever it then is, within ``window``."""

    __pydantic_config__ = STRICT
    duration: Seconds
    window: Window


@dataclass(frozen=True)
class Robot:
    """A robot, where it is at first (``start``: a place, or a pose of its own) and in the end
    (``end``; none: anywhere).

    ``shift``: before and after it, the robot stands where it is; ``breaks``: when it rests.
    ``level``: of its battery at first; ``localisation`` and ``latency``: its own (absent: what its
    type says).
    """

    __pydantic_config__ = STRICT
    type: Name
    start: Start
    end: Name | None = None
    skills: Names = ()
    shift: Window | None = None
    breaks: tuple[Break, ...] = ()
    level: Positive | None = None
    localisation: Clearance | None = None
    latency: Moment | None = None

    @property
    def hours(self) -> tuple[float, float]:
        """From when until when (s) it works: always, where it has no shift."""
        return self.shift or (0.0, math.inf)


GROUND = "ground"
"""The floor whose map is the problem's own."""


@dataclass(frozen=True)
class Storey:
    """A further floor: its map (a ROS ``map_server`` YAML file), and how much higher it is than the
    ground (``height``, m; below it: less than 0).
    """

    __pydantic_config__ = STRICT
    map: str
    height: Coordinate


def _cabin(value: Any) -> Any:
    """Take one pose for a list of one."""
    several = isinstance(value, list | tuple) and any(isinstance(v, list | tuple) for v in value)
    return value if several else [value]


Cabin = Annotated[
    tuple[Pose, ...], MinLen(1), BeforeValidator(_cabin, json_schema_input_type=Pose | list[Pose])
]
"""Where robots stand in a lift: a pose for each that it takes at a time."""


@dataclass(frozen=True)
class Lift:
    """Takes robots between the floors of ``stops``, by the pose at which a robot stands in it on
    each; of several poses, listed in one order on all floors, it takes as many robots at a time,
    which ride together or one after the other. A ride lasts ``seconds`` (doors, waiting for the
    cabin, and all), and ``per_floor`` s for each floor that it goes up or down.
    """

    __pydantic_config__ = STRICT
    stops: Annotated[Mapping[Name, Cabin], MinLen(2)]
    seconds: Seconds = 30.0
    per_floor: Moment = 0.0
    skills: Names = ()


@dataclass(frozen=True)
class Docking:
    """How robots come to a place: the last ``metres`` straight, along the place's heading, no
    faster than ``v_max`` (m/s); ``backwards``: in reverse.
    """

    __pydantic_config__ = STRICT
    metres: Annotated[float, Ge(0.05), Le(FILE_LIMITS.largest), NUMBER]
    v_max: Positive | None = None
    backwards: bool = False


@dataclass(frozen=True)
class Place:
    """A pose at which something is done, on a ``floor``. ``docking``: how it is come to. ``park``:
    how often each robot may come to rest here without doing anything, to be out of the way (where
    that is not said, who starts here may, once). ``charger``: robots with batteries
    charge here. ``room``: of so many orders the loads may be here at a time, from when a delivery
    begins until a pickup ends; ``holds``: so many are here at first. Where it is a machine's, what
    was brought is gone as its task begins, and what is fetched is there as that ends.
    """

    __pydantic_config__ = STRICT
    pose: Pose
    floor: Name = GROUND
    docking: Docking | None = None
    park: Annotated[int, Ge(0), Le(FILE_LIMITS.visits), NUMBER] | None = None
    charger: Charger | None = None
    room: Count | None = None
    holds: Some = 0


@dataclass(frozen=True)
class Door:
    """A leaf that stands at ``closed`` until a robot at ``opened_from`` opens it.

    It stays open, or closes by itself ``closes`` s later; such a door each robot may open ``times``
    times. ``second``: of a door with two leaves, where the other one is, closed and open; they move
    together.
    """

    __pydantic_config__ = STRICT
    leaf: Outline
    closed: Pose
    open: Pose
    opened_from: Names
    seconds: Seconds = 1.0
    skills: Names = ()
    closes: Seconds | None = None
    times: Visits = 1
    floor: Name = GROUND
    second: tuple[Pose, Pose] | None = None

    @property
    def leaves(self) -> tuple[tuple[Pose, Pose], ...]:
        """Where each of its leaves is, closed and open."""
        return tuple(filter(None, ((self.closed, self.open), self.second)))


@dataclass(frozen=True)
class AutomaticDoor:
    """A doorway (``polygon``) whose door opens by itself as robots come.

    A drive through it lasts ``opens_in`` s longer, in which the robot may have to stand before the
    door; who drives past keeps clear of it, and nobody has business in it. ``shut``: times in
    which nobody drives through. Of an ``airlock`` (a name that several doors share) one door at a
    time is open: one robot at a time drives through any of them, and each also waits ``closes_in``
    s until the other one is shut.
    """

    __pydantic_config__ = STRICT
    polygon: Polygon
    opens_in: Moment = 0.0
    closes_in: Moment = 0.0
    shut: Windows = ()
    airlock: Name | None = None
    floor: Name = GROUND


@dataclass(frozen=True)
class Zone:
    """A part of the floor: ``keep_out`` names the robot types that may not touch it; ``max_robots``
    may be in it at a time; or it has rules for robots of ``robot_types`` (none named: of all): no
    more than ``v_max`` (m/s), no turning on the spot with ``pivoting: never``, and no standing with
    ``stopping: never``, while any part of a robot, with its load, is in it; while its reference
    point is in it, it does not move against the heading ``one_way`` (rad). ``avoid``: who drives
    alone goes round it where that takes no more than so many seconds longer.
    """

    __pydantic_config__ = STRICT
    polygon: Polygon
    keep_out: Names = ()
    max_robots: Count | None = None
    v_max: Positive | None = None
    one_way: Coordinate | None = None
    pivoting: Literal["free", "never"] = "free"
    stopping: Literal["free", "never"] = "free"
    avoid: Moment = 0.0
    robot_types: Names = ()
    floor: Name = GROUND

    def heeded_by(self, kind: str) -> bool:
        """Return whether its rules are for robots of a type."""
        return not self.robot_types or kind in self.robot_types

    @property
    def has_rules(self) -> bool:
        """Whether it says how robots drive in it."""
        rules = self.v_max, self.one_way, self.pivoting, self.stopping, self.avoid
        return rules != (None, None, "free", "free", 0.0)


@dataclass(frozen=True)
class Lane:
    """A way that robots of ``robot_types`` (none named: of all) prefer in both directions: a line
    through ``points`` (m), ``width`` m wide. Who drives alone counts a second beside such lanes
    ``prefer`` times. A wish and no rule.
    """

    __pydantic_config__ = STRICT
    points: Annotated[tuple[Point, ...], MinLen(2), MaxLen(FILE_LIMITS.corners)]
    width: Length = 1.0
    prefer: Annotated[float, Gt(1), Le(FILE_LIMITS.largest), NUMBER] = 1.5
    robot_types: Names = ()
    floor: Name = GROUND

    def heeded_by(self, kind: str) -> bool:
        """Return whether it is for robots of a type."""
        return not self.robot_types or kind in self.robot_types

    @property
    def areas(self) -> tuple[tuple[Point, ...], ...]:
        """The corners of each straight piece, half its width longer at both ends."""
        half = 0.5 * self.width
        ends = [(complex(*a), complex(*b)) for a, b in itertools.pairwise(self.points)]
        return tuple(
            tuple((z.real, z.imag) for z in (a - w - v, b + w - v, b + w + v, a - w + v))
            for a, b in ends
            for w in (half * (b - a) / abs(b - a),)
            for v in (1j * w,)
        )


@dataclass(frozen=True)
class Resource:
    """Something that ``capacity`` stops and tasks can use at a time: a lift table, an operator.

    ``setup``: what it takes (s) to set it up from one kind of jobs for another, no time where none
    is said; ``kind``: what it is set up for at first (none: for any). ``batches``: who uses it at a
    time is of one kind and begins together, and so ends together.
    """

    __pydantic_config__ = STRICT
    capacity: Count = 1
    setup: Mapping[Name, Mapping[Name, Moment]] = field(default_factory=dict)
    kind: Name | Literal[""] = ""
    batches: bool = False

    @property
    def kinds(self) -> set[str]:
        """The kinds of jobs that it can be set up for."""
        return set(self.setup).union(*self.setup.values())

    def setup_between(self, one: str, other: str) -> float:
        """Return how long it is set up (s) from one kind for another."""
        return self.setup.get(one, {}).get(other, 0.0)


@dataclass(frozen=True)
class Stop:
    """A pickup or a delivery, at one of the places ``at``; it lasts ``service`` s.

    ``window``: it begins no earlier and ends no later; where there are several, within one of them.
    ``task`` instead of ``at``: at the machine at which that task is done (see :class:`Mode`).
    ``on`` instead of it: the load is on that robot when the plan begins.
    ``action``: what robots call it (for VDA 5050).
    """

    __pydantic_config__ = STRICT
    at: Names = ()
    task: Name | None = None
    on: Name | None = None
    service: Seconds = 1.0
    window: Windows = ()
    resources: Names = ()
    action: Name | None = None


def _stop(value: Any) -> Any:
    return {"at": value} if isinstance(value, str | list | tuple) else value


AnyStop = Annotated[Stop, BeforeValidator(_stop, json_schema_input_type=Stop | Name | list[Name])]


def _place(value: Any) -> Any:
    if isinstance(value, Mapping | Place):
        return value
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError("a pose is [x, y, theta]")
    return {"pose": value}


AnyPlace = Annotated[Place, BeforeValidator(_place, json_schema_input_type=Place | Pose)]


@dataclass(frozen=True)
class Attached:
    """A load that travels with its robot: its footprint, and where it is in the robot's frame
    (``offset``: x and y in m, heading in rad; on top of it where none is given). ``carriers``: more
    robots carry it, each at one of these poses in the frame of the first one, all of one type that
    moves in any direction; they keep formation.
    """

    __pydantic_config__ = STRICT
    footprint: Outline
    offset: Pose = (0.0, 0.0, 0.0)
    carriers: tuple[Pose, ...] = ()


@dataclass(frozen=True)
class Repeat:
    """Once ``every`` so many s: so many times (``times``, the first counted), or as long as it is
    released no later than ``until`` (s). One of the two is said.
    """

    __pydantic_config__ = STRICT
    every: Seconds
    times: Annotated[int, Ge(2), Le(FILE_LIMITS.repeats), NUMBER] | None = None
    until: Moment | None = None


@dataclass(frozen=True, kw_only=True)
class FleetJob:
    """What orders and tasks have in common.

    ``skills``: what the robot must have; ``robots``: who may do it (none named: all). ``release``:
    when it is known of, so that it begins no earlier (s). ``after``: orders and tasks that have
    ended before. ``repeat``: it recurs, as jobs of their own ``ID_2``, ``ID_3``, ... with release,
    windows and due times that much later each. ``priority``: a job of a higher one begins no later
    than those of lower ones. ``optional``: it may be left out, which counts as ``penalty`` more
    seconds of makespan (of cost, where the objective weighs several terms). ``due``: what it ends
    later is its tardiness (s), which counts ``weight`` times, if it counts at all (see
    :class:`Weights`). ``kind``: what the :class:`Resource` that it uses is set up for.
    """

    id: Name
    skills: Names = ()
    robots: Names = ()
    release: Moment = 0.0
    after: Names = ()
    repeat: Repeat | None = None
    priority: Annotated[int, NUMBER] = 0
    optional: bool = False
    penalty: Positive | None = None
    due: Moment | None = None
    weight: Positive = 1.0
    kind: Name | Literal[""] = ""


@dataclass(frozen=True, kw_only=True)
class Order(FleetJob):
    """One robot takes a load from ``pickup`` to ``delivery``.

    ``load``: how many of each kind it takes up of the robot's capacity. ``attached``: it has a
    footprint, stands on the floor, and is one body with the robot that carries it; or the id of
    another order, whose load is taken on from where that one puts it. ``together`` with other
    orders: each by a robot of its own, all picked up and all delivered at the same times, and
    nobody does anything else in between. Beside that see :class:`FleetJob`.
    """

    __pydantic_config__ = STRICT
    pickup: AnyStop
    delivery: AnyStop
    load: Mapping[Name, Count] = field(default_factory=lambda: {"item": 1})
    attached: Attached | Name | None = None
    together: Names = ()


@dataclass(frozen=True)
class Mode:
    """One way in which a machine may do a task: ``duration`` s on its ``resources``. Orders bring
    parts to one of the places ``input`` and fetch them at one of ``output`` (``input`` where none
    is named).
    """

    __pydantic_config__ = STRICT
    duration: Seconds
    input: Names = ()
    output: Names = ()
    resources: Names = ()


@dataclass(frozen=True, kw_only=True)
class Task(FleetJob):
    """Something that lasts ``duration`` s: done by one robot at one of the places ``at``, or, where
    none is named, by no robot (a machine that works by itself on its ``resources``).

    ``crew``: so many robots do it together, from its start to its end: one at each of the places
    ``at``. ``modes`` instead of ``duration``: it is done by one of several machines, by name.
    ``action``: what robots call it (for VDA 5050).
    Beside that see :class:`FleetJob`.
    """

    __pydantic_config__ = STRICT
    duration: Seconds | None = None
    at: Names = ()
    crew: Count = 1
    modes: Mapping[Name, Mode] = field(default_factory=dict)
    resources: Names = ()
    window: Windows = ()
    action: Name | None = None


@dataclass(frozen=True)
class Weights:
    """An objective of several terms: what each counts, 0 where nothing is said.

    ``makespan``: a second until all is over. ``tardiness``: a second that a job ends after it is
    ``due``, times its ``weight``. ``completion``: a second until a job ends, times its ``weight``.
    ``driving``: a second that a robot drives. ``distance``: a metre of the ways that robots take
    when nobody is in them. ``energy``: what drives take from batteries, in the user's units.
    ``robots``: a robot that leaves where it starts. ``cost``: what robots cost by the ``costs`` of
    their types. ``busiest``: a second that the robot which is busy longest drives and works.
    """

    __pydantic_config__ = STRICT
    makespan: Rate = 0.0
    tardiness: Rate = 0.0
    completion: Rate = 0.0
    driving: Rate = 0.0
    distance: Rate = 0.0
    energy: Rate = 0.0
    robots: Rate = 0.0
    cost: Rate = 0.0
    busiest: Rate = 0.0


def _objective(value: Any) -> Any:
    """Let only one of the forms through, so that errors are about that one; a term alone in a list
    has the weight 1.
    """
    if isinstance(value, list | tuple) and value:
        return tuple({one: 1.0} if isinstance(one, str) else one for one in value)
    if isinstance(value, Mapping | Weights) or value in ("makespan", "none"):
        return value
    raise ValueError(
        "give makespan, none, or weights such as {tardiness: 10, driving: 0.1}, or a list of such, "
        "the most important first"
    )


_Term: Any = Literal.__getitem__(tuple(Weights.__dataclass_fields__))
AnyObjective = Annotated[
    Literal["makespan", "none"] | Weights | tuple[Weights, ...],
    BeforeValidator(
        _objective,
        json_schema_input_type=Literal["makespan", "none"] | Weights | list[_Term | Weights],
    ),
]
"""What is best: of a list, the first is minimised, then the next among plans as good in that."""


def _orders(value: Any) -> Any:
    """Tables are read with their problem file (:mod:`up_samp.fleet.files`), before this."""
    if isinstance(value, str):
        raise ValueError("list the orders here; only problem files name a table of them")
    return value


Orders = Annotated[
    tuple[Order, ...],
    BeforeValidator(_orders, json_schema_input_type=tuple[Order, ...] | str),
]


@dataclass(frozen=True)
class FleetRecords:
    """All that a fleet problem says. ``map``: a ROS ``map_server`` YAML file, of the ground floor;
    ``margin``: clearance in m that motions keep from walls and from each other.
    """

    __pydantic_config__ = STRICT
    map: str
    name: Name = "fleet"
    seconds_per_unit: Seconds = 1.0
    margin: Clearance = PRECISION.margin
    robot_types: Mapping[Name, RobotType] = field(default_factory=dict)
    robots: Mapping[Name, Robot] = field(default_factory=dict)
    places: Mapping[Name, AnyPlace] = field(default_factory=dict)
    floors: Mapping[Name, Storey] = field(default_factory=dict)
    lifts: Mapping[Name, Lift] = field(default_factory=dict)
    doors: Mapping[Name, Door] = field(default_factory=dict)
    automatic_doors: Mapping[Name, AutomaticDoor] = field(default_factory=dict)
    zones: Mapping[Name, Zone] = field(default_factory=dict)
    lanes: Mapping[Name, Lane] = field(default_factory=dict)
    resources: Mapping[Name, Resource] = field(default_factory=dict)
    orders: Orders = ()
    tasks: tuple[Task, ...] = ()
    objective: AnyObjective = "makespan"
    format: Literal["up-samp-problem"] = "up-samp-problem"
    version: Literal[1] = 1

    @property
    def settings(self) -> dict[str, float]:
        """What an engine that solves the problem has to be given: its parameters, by name."""
        return {"seconds_per_unit": self.seconds_per_unit, "margin": self.margin}

    @property
    def weighed(self) -> tuple[Weights, ...]:
        """The weights of an objective of several terms, the most important first; none: where it is
        the makespan alone, or any plan will do.
        """
        told = self.objective
        return told if isinstance(told, tuple) else (told,) if isinstance(told, Weights) else ()

    def kind_of(self, robot: str) -> RobotType:
        """Return the type of a robot."""
        return self.robot_types[self.robots[robot].type]

    def senses(self, robot: str) -> dict[str, float]:
        """Return how wrong (``localisation``, m) and how late (``latency``, s) a robot may be, as
        far as it, or its type, says so.
        """
        own = self.robots.get(robot)
        both = own and self.robot_types[own.type], own
        words = itertools.product(both, ("localisation", "latency"))
        return {k: v for one, k in words if (v := getattr(one, k, None)) is not None}

    @property
    def jobs(self) -> tuple[Order | Task, ...]:
        """All orders and tasks."""
        return (*self.orders, *self.tasks)

    @cached_property
    def order_of(self) -> Mapping[str, Order]:
        """Orders by their ids."""
        return {order.id: order for order in self.orders}

    @cached_property
    def task_of(self) -> Mapping[str, Task]:
        """Tasks by their ids."""
        return {task.id: task for task in self.tasks}

    @cached_property
    def job_of(self) -> Mapping[str, Order | Task]:
        """Orders and tasks by their ids."""
        return {**self.order_of, **self.task_of}

    def on_board(self, robot: str) -> tuple[Order, ...]:
        """Return the orders whose loads are on a robot at first."""
        return tuple(order for order in self.orders if order.pickup.on == robot)

    @cached_property
    def bringers(self) -> Mapping[str | None, Sequence[Order]]:
        """By task, the orders that bring parts to its machine (None: those that bring none)."""
        return grouped(self.orders, lambda order: order.delivery.task)

    @cached_property
    def crews(self) -> frozenset[str]:
        """The orders that are carried together with others."""
        return frozenset(n for o in self.orders if o.together for n in (o.id, *o.together))

    @cached_property
    def takers(self) -> Mapping[Any, Sequence[Order]]:
        """By order, those that take its load on."""
        taking = (order for order in self.orders if isinstance(order.attached, str))
        return grouped(taking, lambda order: order.attached)


# ------------------ Which robots can do which jobs


def carries(kind: RobotType, load: Mapping[str, int]) -> bool:
    """Return whether a robot of this type can carry so many of each kind."""
    return all(kind.capacity.get(k, 0) >= n for k, n in load.items())


def needs_robot(job: Order | Task) -> bool:
    """Return whether a robot does it."""
    return not isinstance(job, Task) or bool(job.at)


def visited(job: Order | Task) -> tuple[Stop | Task, ...]:
    """Return what a robot goes to one of the places ``at`` for: an order's stops, or the task."""
    return (job.pickup, job.delivery) if isinstance(job, Order) else (job,)


def seats_of(task: Task) -> dict[str, tuple[str, ...]]:
    """Return the places at which a robot does a task, one of them each: of a crew by seat, else
    there is one ("").
    """
    return {place: (place,) for place in task.at} if task.crew > 1 else {"": task.at}


def able(records: FleetRecords, job: Order | Task) -> list[str]:
    """Return the robots that have the skills and are among those named."""
    return [name for name in records.robots if _may_do(records, name, job)]


def can_do(records: FleetRecords, robot: str, job: Order | Task) -> bool:
    """Return whether a robot may do a job, and can carry what it is about."""
    kind = records.kind_of(robot)
    return _may_do(records, robot, job) and (isinstance(job, Task) or carries(kind, job.load))


def _may_do(records: FleetRecords, robot: str, job: Order | Task) -> bool:
    on_board = job.pickup.on if isinstance(job, Order) else None
    named = (not job.robots or robot in job.robots) and on_board in (None, robot)
    return named and set(job.skills) <= set(records.robots[robot].skills)
