"""Every object's life as a row of cells: stretches of its paths, and where it rests in between.

The progress of two objects along their lives spans a plane (O'Donnell & Lozano-Perez,
"Deadlock-free and collision-free coordination of two robot manipulators", ICRA 1989); the cells
cut it into a grid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from up_samp.execution.graph import At, Event
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.floors import map_number, side_by_side
from up_samp.io.sampling import rows_trajectory
from up_samp.model import (
    Body,
    Configuration,
    Kinematics,
    MotionModel,
    ProblemError,
    TrafficZone,
    UnsupportedError,
    avoids,
)
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.model.frames import Frame
from up_samp.motion.fleet.paths import Path, path_of, resting_path
from up_samp.upio.rides import laden_body


def laden_bodies(plan: Mapping[str, Any], bodies: Mapping[str, Body]) -> dict[Any, Body]:
    """Return robot and loads as one body, by (activity, object), from a plan dictionary."""
    loads: dict[tuple[str, str], list[Any]] = {}
    for ride in plan.get("rides", ()):
        offset = tuple(float(v) for v in ride["offset"])
        loads.setdefault((ride["activity"], ride["carrier"]), []).append(
            (bodies[ride["object"]], offset)
        )
    return {key: laden_body(bodies[key[1]], found) for key, found in loads.items()}


def hold_of(drive: DriveCells) -> tuple[float, Event, float, Event]:
    """Return from when (s, plan time) on a load stands nowhere in a ride (``drive``: its carrier's
    motion), and from when on it does again; each with the event on the floor.
    """
    near = min(TOLERANCES.grip, drive.path.length / 2)
    low, high = round(near, 6), round(drive.path.length - near, 6)
    return (
        float(drive.reached(np.array([low]))[0]),
        Event(At.REACH, drive.activity, drive.object, low),
        float(drive.left(np.array([high]))[0]),
        Event(At.LEAVE, drive.activity, drive.object, high),
    )


# ------------------ Every object's life as a row of cells


@dataclass(frozen=True, eq=False)
class DriveCells:
    """A motion: ``object`` follows ``path`` in ``activity``; ``avoid`` as in the problem."""

    activity: str
    object: str
    path: Path
    begin: float
    """When the planned trajectory begins (s, plan time)."""
    avoid: frozenset[str] | None
    frame: Frame = field(default_factory=Frame)
    """Where the plan's poses on its map lie in the one plane of all paths."""
    enter: ClassVar[Event | None] = None
    leave: ClassVar[Event | None] = None

    @cached_property
    def planned(self) -> tuple[FloatArray, FloatArray]:
        """Times (s, plan time) and progress (m) as planned, progress non-decreasing."""
        return self.path.natural.times + self.begin, np.maximum.accumulate(self.path.natural_s)

    def reached(self, progress: FloatArray) -> FloatArray:
        """Return when the plan comes to these progresses (s)."""
        times, s = self.planned
        i = np.searchsorted(s, progress - TOLERANCES.arrived, side="left")
        return _between(times, s, np.clip(i, 0, len(s) - 1), progress)

    def left(self, progress: FloatArray) -> FloatArray:
        """Return when the plan goes beyond these progresses (s)."""
        times, s = self.planned
        i = np.searchsorted(s, progress + TOLERANCES.arrived, side="right")
        return _between(times, s, np.clip(i, 0, len(s) - 1), progress)

    def of_cells(self, path: Path) -> tuple[FloatArray, FloatArray]:
        """Return when the plan enters and leaves each cell of its path, however that is cut (s)."""
        if path not in self._of_cells:
            self._of_cells[path] = self.left(path.edges[:-1]), self.reached(path.edges[1:])
        return self._of_cells[path]

    @cached_property
    def _of_cells(self) -> dict[Path, tuple[FloatArray, FloatArray]]:
        return {}

    @property
    def key(self) -> tuple[str, str]:
        """Activity and object."""
        return self.activity, self.object

    @cached_property
    def finer(self) -> dict[int, Path]:
        """The path cut into cells 2 ** level times as short."""
        return {0: self.path}

    def cut(self, level: int) -> Path:
        """Return the path with every cell halved ``level`` times."""
        if level not in self.finer:
            edges = self.path.edges
            parts = 1 << level
            share = np.arange(parts) / parts
            inner = (edges[:-1, None] + share * np.diff(edges)[:, None]).ravel()
            fine = np.append(inner, edges[-1])
            halt = np.zeros(len(fine), dtype=np.bool_)
            halt[::parts] = self.path.halt
            self.finer[level] = replace(self.path, edges=fine, halt=halt, tunable=False)
        return self.finer[level]


def _between(times: FloatArray, s: FloatArray, i: IntArray, at: FloatArray) -> FloatArray:
    """Return the times of ``at`` in the stretches that end with samples ``i``."""
    before = np.maximum(i - 1, 0)
    way = s[i] - s[before]
    share = np.where(
        way > TOLERANCES.arrived,
        (at - s[before]) / np.where(way > TOLERANCES.arrived, way, 1.0),
        1.0,
    )
    return np.asarray(times[before] + np.clip(share, 0.0, 1.0) * (times[i] - times[before]))


@dataclass(frozen=True, eq=False)
class Stay:
    """A rest at ``pose``, in no activity. ``enter`` and ``leave`` are set where a change, not a
    motion, puts the object there or takes it away; the times are those of the plan (s). ``frame``
    as in a motion.
    """

    body: Body
    pose: Configuration
    since: float
    until: float
    enter: Event | None = None
    leave: Event | None = None
    frame: Frame = field(default_factory=Frame)
    activity: ClassVar[str] = ""

    @cached_property
    def path(self) -> Path:
        """A path that goes nowhere."""
        return resting_path(self.body, self.pose)

    def cut(self, level: int) -> Path:
        """Return its path: no cell of it can be halved."""
        return self.path

    def of_cells(self, path: Path) -> tuple[FloatArray, FloatArray]:
        """Return when the plan enters and leaves its one cell (s)."""
        return np.array([self.since]), np.array([self.until])


Piece = DriveCells | Stay


@dataclass(frozen=True, eq=False)
class Life:
    """An object's rests and motions in the order of the plan: rest, motion, rest, ..."""

    object: str
    body: Body
    pieces: tuple[Piece, ...]
    rides: Mapping[str, str] = field(default_factory=dict)
    """Activities in which it is carried along, and by whom."""
    localisation: float | None = None
    """How far (m) from where it tells to be it may be (None: as all that say nothing)."""
    latency: float = 0.0
    """By how many seconds what it tells, and obeys, may be late, where it says so."""

    @cached_property
    def boxes(self) -> FloatArray:
        """Boxes (x low, y low, x high, y high; m) of the pieces, shape (n, 4)."""
        return np.array([piece.path.box for piece in self.pieces]).reshape(-1, 4)

    @property
    def drives(self) -> tuple[DriveCells, ...]:
        """The motions."""
        return tuple(p for p in self.pieces if isinstance(p, DriveCells))


def errors_of(lives: Mapping[str, Life], otherwise: float) -> dict[str, float]:
    """Return how far (m) from where they tell to be objects may be; ``otherwise``: those that have
    no error of their own.
    """
    own = {life.object: life.localisation for life in lives.values()}
    return {name: otherwise if error is None else error for name, error in own.items()}


def drives_of(lives: Mapping[str, Life]) -> dict[tuple[str, str], DriveCells]:
    """Return all motions, by activity and object."""
    return {d.key: d for life in lives.values() for d in life.drives}


_LIMITS = {
    "turning_radius": "turning_radius", "v_max": "v_max", "a_max": "a_max",
    "omega_max": "omega_max", "reverse_v_max": "v_back", "lateral_a_max": "lateral_a_max",
    "alpha_max": "alpha_max", "reverse_cost": "back_cost",
}  # fmt: skip
"""Numbers that limit motions, by what plan files call them; the first three are always there."""


def body_of(entry: Mapping[str, Any]) -> Body:
    """Return the body of an object of a plan dictionary.

    :raises ProblemError: where it lacks a limit.
    """
    for key in [*_LIMITS][:3]:
        if key not in entry:
            raise ProblemError(f"object '{entry['name']}' lacks '{key}'")
    told: dict[str, Any] = {f: float(entry[key]) for key, f in _LIMITS.items() if key in entry}
    limits = Kinematics(
        MotionModel(entry["model"]),
        reverse=bool(entry.get("reverse", True)),
        zones=tuple(_zone(zone) for zone in entry.get("zones", ())),
        drives_along=bool(entry.get("drives_along", False)),
        **told,
    )
    corners = tuple((float(x), float(y)) for x, y in entry["footprint"])
    return Body(corners, limits, entry.get("mesh"), float(entry.get("height", math.inf)))


def _zone(entry: Mapping[str, Any]) -> TrafficZone:
    corners = tuple((float(x), float(y)) for x, y in entry["polygon"])
    return TrafficZone(
        corners,
        float(entry.get("v_max", math.inf)),
        float(entry.get("height", 0.0)),
        entry.get("one_way"),
        bool(entry.get("pivots", True)),
        bool(entry.get("stops", True)),
        float(entry.get("cost", 0.0)),
        float(entry.get("prefer", 1.0)),
        None if "dock" not in entry else Frame().of(entry["dock"]),
    )


def lives_of(plan: Mapping[str, Any]) -> dict[str, Life]:
    """Return the life of every object that is somewhere, from a plan dictionary.

    Raises :class:`UnsupportedError` for free flyers: their motions have no planar footprint.
    """
    plan, frames = side_by_side(plan)
    bodies = {entry["name"]: body_of(entry) for entry in plan["objects"]}
    laden = laden_bodies(plan, bodies)
    for entry in plan["objects"]:
        body = bodies[entry["name"]]
        if body.flies and plan["motions"]:
            raise UnsupportedError(
                f"object '{entry['name']}' is a free flyer (SE3): dependency graphs are for bodies "
                "that move in the plane"
            )
    drives = {}
    for motion in plan["motions"]:
        key = motion["activity"], motion["object"]
        body = laden.get(key, bodies[motion["object"]])
        drives[key] = _drive(motion, body, frames[map_number(motion)])
    lives = {}
    told = {o["name"]: (o.get("localisation"), o.get("latency", 0.0)) for o in plan["objects"]}
    for name, body in bodies.items():
        rides = {r["activity"]: r["carrier"] for r in plan.get("rides", ()) if r["object"] == name}
        pieces = _pieces(plan, frames, name, body, drives, rides)
        if pieces:
            lives[name] = Life(name, body, tuple(pieces), rides, *told[name])
    return lives


def _pieces(
    plan: Mapping[str, Any],
    frames: Sequence[Frame],
    name: str,
    body: Body,
    drives: Mapping[tuple[str, str], DriveCells],
    rides: Mapping[str, str],
) -> list[Piece]:
    unit = float(plan["seconds_per_unit"])
    ends = {a["name"]: a["end"] * unit for a in plan["activities"]}
    item = next(o for o in plan["objects"] if o["name"] == name)
    pose = None if item["initial"] is None else tuple(item["initial"])
    since, enter, frame = -np.inf, None, frames[map_number(item)]
    pieces: list[Piece] = []
    for item in in_turn(plan, name, rides):
        activity = item["activity"]
        if "samples" not in item:
            until, back = item["time"], ends[activity]
            leave = entered = Event(At.END, activity)
            if activity in rides:
                ride = drives[activity, rides[activity]]
                if ride.path.cells == 0:
                    continue  # its carrier stays where it is
                until, leave, back, entered = hold_of(ride)
            if pose is not None:
                pieces.append(Stay(body, pose, since, until, enter, leave, frame))
            pose, since, enter = tuple(item["configuration"]), back, entered
            frame = frames[map_number(item)]
            continue
        drive = drives[activity, name]
        if drive.path.cells == 0:
            continue  # it stays where it is
        if pose is not None:
            until = item["samples"][0][0]
            pieces.append(Stay(body, pose, since, until, enter, None, frame))
        pieces.append(drive)
        last = item["samples"][-1]
        pose, since, enter, frame = tuple(last[1:]), last[0], None, drive.frame
    if pose is not None:
        pieces.append(Stay(body, pose, since, np.inf, enter, None, frame))
    return pieces


def in_turn(plan: Mapping[str, Any], name: str, rides: Container[str]) -> list[dict[str, Any]]:
    """Return an object's motions and changes in the order of their activities: what is set
    somewhere (by a lift, say) may drive on from there at that instant. In ``rides`` it is carried.
    """
    spans = {a["name"]: (a["start"], a["end"]) for a in plan["activities"]}
    found = [m for m in plan["motions"] if m["object"] == name]
    driven = {m["activity"] for m in found}
    found += [c for c in plan["changes"] if c["object"] == name and c["activity"] not in driven]

    def place(item: Mapping[str, Any]) -> tuple[float, float, bool]:
        start, end = spans[item["activity"]]
        sets = "samples" not in item and item["activity"] not in rides
        return end if sets else start, end, not sets

    return sorted(found, key=place)


def _drive(item: Mapping[str, Any], body: Body, frame: Frame) -> DriveCells:
    trajectory = rows_trajectory(item["samples"])
    listed = item.get("avoid")
    avoid = None if listed is None else frozenset(listed)
    path = path_of(trajectory, body, decided=True)
    return DriveCells(item["activity"], item["object"], path, trajectory.start, avoid, frame)


def concerned(one: Life, k: int, other: Life, m: int) -> bool:
    """Return whether piece ``k`` of one life and piece ``m`` of another must not meet.

    A rest counts as part of the motions before and after it: a robot that waits for its motion to
    begin is already in its activity.
    """
    a, b = one.pieces[k], other.pieces[m]
    if isinstance(a, Stay) and isinstance(b, Stay):
        return False
    if _aboard(one, a, b) or _aboard(other, b, a):
        return False
    return kept_apart(one, _near(one, k), other, _near(other, m))


def kept_apart(
    one: Life, drives: Iterable[DriveCells], other: Life, others: Iterable[DriveCells]
) -> bool:
    """Return whether some drives of one of two lives have to avoid the other one's object."""
    sides = ((drives, other.object), (others, one.object))
    return any(avoids(drive.avoid, name) for some, name in sides for drive in some)


def _aboard(load: Life, piece: Piece, drive: Piece) -> bool:
    """Return whether a motion carries a load, or is one of its carriers' motions all through a rest
    of the load: it may come to touch it, and keeps clear of it at whatever time.
    """
    if not isinstance(drive, DriveCells) or drive.object not in load.rides.values():
        return False
    if load.rides.get(drive.activity) == drive.object:
        return True
    return (
        isinstance(piece, Stay)
        and piece.since <= drive.begin
        and float(drive.planned[0][-1]) <= piece.until
    )


def _near(life: Life, k: int) -> list[DriveCells]:
    piece = life.pieces[k]
    if isinstance(piece, DriveCells):
        return [piece]
    around = life.pieces[max(0, k - 1) : k + 2]
    return [p for p in around if isinstance(p, DriveCells)]


def pairs_of(lives: Mapping[str, Life]) -> list[tuple[Life, Life]]:
    """Return all pairs of lives of which one drives."""
    return [(a, b) for a, b in itertools.combinations(lives.values(), 2) if a.drives or b.drives]
