"""Questions to motion planners, their answers, and timed trajectories."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from up_samp.model.arrays import FloatArray
from up_samp.model.bodies import Body, Configuration, Placed


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A timed motion: ``times`` of shape (n,), strictly increasing, in s; ``poses`` of shape (n, 3)
    (x, y, theta; theta continuous, not wrapped) or (n, 7).

    Between two samples an SE2 body moves with a constant twist (along an arc of constant
    curvature), samples are at most ``MAX_STEP`` s apart while it moves. Cusps are samples.
    Before the first sample it rests at the first pose, after the last one at the last.
    """

    times: FloatArray
    poses: FloatArray

    MAX_STEP = 0.05

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or self.poses.ndim != 2 or len(self.times) != len(self.poses):
            raise ValueError("a trajectory needs times of shape (n,) and poses of shape (n, d)")
        if len(self.times) == 0 or not np.all(np.diff(self.times) > 0):
            raise ValueError("a trajectory's times must be strictly increasing and not empty")
        self.times.setflags(write=False)
        self.poses.setflags(write=False)

    @property
    def start(self) -> float:
        """Time of the first sample."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Time of the last sample."""
        return float(self.times[-1])

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return self.end - self.start

    def shifted(self, seconds: float) -> Trajectory:
        """Return the same motion ``seconds`` later."""
        return Trajectory(self.times + seconds, self.poses.copy())

    def at(self, t: float) -> Configuration:
        """Return the configuration at time ``t`` (rest before the start and after the end)."""
        if t <= self.times[0]:
            return tuple(float(v) for v in self.poses[0])
        if t >= self.times[-1]:
            return tuple(float(v) for v in self.poses[-1])
        i = int(np.searchsorted(self.times, t, side="right")) - 1
        share = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        return interpolate(self.poses[i], self.poses[i + 1], float(share))


def interpolate(a: FloatArray, b: FloatArray, share: float) -> Configuration:
    """Return the pose ``share`` of the way from ``a`` to ``b`` under a constant twist.

    SE2 poses follow the arc of constant curvature through both (Lynch & Park, *Modern
    Robotics*, ch. 3); SE3 poses move straight with spherical interpolation of the quaternion.
    """
    if len(a) == 3:
        turn = float(b[2] - a[2])
        dx, dy = float(b[0] - a[0]), float(b[1] - a[1])
        if abs(turn) < 1e-12:
            return (float(a[0]) + share * dx, float(a[1]) + share * dy, float(a[2]) + share * turn)
        # rotate about the twist's fixed point
        half = 0.5 * turn
        cot = math.cos(half) / math.sin(half)
        cx = float(a[0]) + 0.5 * (dx - dy * cot)
        cy = float(a[1]) + 0.5 * (dy + dx * cot)
        c, s = math.cos(share * turn), math.sin(share * turn)
        rx, ry = float(a[0]) - cx, float(a[1]) - cy
        return (cx + c * rx - s * ry, cy + s * rx + c * ry, float(a[2]) + share * turn)
    position = a[:3] + share * (b[:3] - a[:3])
    qa, qb = a[3:], b[3:]
    dot = float(np.dot(qa, qb))
    if dot < 0:
        qb, dot = -qb, -dot
    angle = math.acos(min(1.0, dot))
    if angle < 1e-9:
        q = qa + share * (qb - qa)
    else:
        q = (math.sin((1 - share) * angle) * qa + math.sin(share * angle) * qb) / math.sin(angle)
    q = q / np.linalg.norm(q)
    return tuple(float(v) for v in (*position, *q))


class Outcome(enum.Enum):
    """What a motion check came to. Only ``IMPOSSIBLE`` is a proof.

    ``NOT_FOUND``: the search ended by itself, at the end of its discretisation or of its counted
    work; more time finds nothing. ``OUT_OF_TIME``: the deadline ended it.
    """

    FOUND = "found"
    IMPOSSIBLE = "impossible"
    NOT_FOUND = "not found"
    OUT_OF_TIME = "out of time"


@dataclass(frozen=True)
class PathQuery:
    """Drive ``body`` from rest at ``poses[0]`` through all further ``poses`` to rest at the last
    one, while the ``obstacles`` rest where they are. It passes the poses between without a stop
    where the way goes on smoothly. The shortest duration is wanted.
    """

    body: Body
    poses: tuple[Configuration, ...]
    obstacles: tuple[Placed, ...] = ()


@dataclass(frozen=True)
class PathReport:
    """Answer to a :class:`PathQuery`. ``trajectory`` starts at time 0 when found.

    ``blockers`` are names of obstacles that stood in the way: for ``IMPOSSIBLE`` a set such that
    the motion stays impossible while all of them rest where they are (empty: the map alone
    forbids it). ``reason`` is for people; ``where`` is the number of the pose that it speaks of
    (``None``: of the ways between them).

    ``complete``: the planner finished its search, so the trajectory is the one that it takes for
    the fastest, on any machine. A search that its deadline cut short, or a motion that rests at a
    pose which it might have passed, is not complete.
    """

    outcome: Outcome
    trajectory: Trajectory | None = None
    blockers: frozenset[str] = frozenset()
    reason: str = ""
    planner: str = ""
    complete: bool = False
    where: int | None = None


def avoids(avoid: frozenset[str] | None, *names: str) -> bool:
    """Return whether a motion with this ``avoid`` set (None: it keeps clear of everything) has to
    keep clear of each of the objects ``names``.
    """
    return avoid is None or avoid.issuperset(names)


@dataclass(frozen=True)
class Rest:
    """A named body that rests at a configuration during ``[since, until]`` (s, plan time)."""

    name: str
    body: Body
    pose: Configuration
    since: float = -math.inf
    until: float = math.inf


@dataclass(frozen=True)
class TimedMotion:
    """One motion of a group: ``name`` (the activity) drives ``object`` from ``poses[0]`` through
    all ``poses``, not before ``release`` and, if it can, done by ``due`` (s, plan time).

    It rests at ``poses[0]`` from ``present_from`` on until it leaves and at ``poses[-1]`` after it
    arrived until ``present_until``: as an obstacle to others it is there that long.
    ``avoid`` names the objects it must keep clear of (``None``: all).
    """

    name: str
    object: str
    body: Body
    poses: tuple[Configuration, ...]
    release: float
    due: float
    present_from: float = -math.inf
    present_until: float = math.inf
    avoid: frozenset[str] | None = None


@dataclass(frozen=True)
class GroupQuery:
    """Motions that may meet: find trajectories for all ``motions`` that keep clear of each other
    and of the resting ``rests``.
    """

    motions: tuple[TimedMotion, ...]
    rests: tuple[Rest, ...] = ()


@dataclass(frozen=True)
class GroupReport:
    """Answer to a :class:`GroupQuery`.

    ``FOUND``: ``trajectories`` (by motion name, plan time) keep clear of everything; those in
    ``late`` end after their due (``late[name]`` is the arrival, s): the group fits its windows iff
    ``late`` is empty. ``conflict`` is a small set of motion names that really conflict (for late
    or failed groups). ``blockers`` are objects that rest in the way.
    ``complete``: no search for it was cut short by a deadline.
    """

    outcome: Outcome
    trajectories: Mapping[str, Trajectory] = field(default_factory=dict)
    late: Mapping[str, float] = field(default_factory=dict)
    conflict: frozenset[str] = frozenset()
    blockers: frozenset[str] = frozenset()
    reason: str = ""
    complete: bool = False
