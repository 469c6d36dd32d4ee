"""Fixed paths, cut into short cells: the geometry that speed tuning and conflict checks share.

A path keeps the shape of a planner's trajectory and forgets its timing. Its parameter ``s`` (m) is
driven length for cars; for omnidirectional bodies it is the larger of the length and the turn
scaled by ``v_max / omega_max``, so that ``|ds/dt| <= v_max`` bounds speed and turn rate at once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from up_samp.geometry.shapes import Shape, shape_of
from up_samp.model import Body, Configuration, MotionModel, Trajectory
from up_samp.motion.curves.twists import partway, twists
from up_samp.motion.fleet.abilities import abilities_of
from up_samp.motion.fleet.cell_times import occupancy
from up_samp.motion.fleet.swept import Hull, Swept, sweep_table

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

Ring = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Cut:
    """How paths are cut. Steps shorter than ``tiny`` (m) carry no shape of their own; a change of
    the direction of the twist by ``kink`` ends a stretch of constant curvature; where the direction
    of an omnidirectional body changes by ``corner`` (rad) from sample to sample, it must stop;
    ``bent`` is the share of the acceleration that a bend may take on a path whose speed is tuned
    with all of it: the two are at right angles, so that together they take 0.5 % more; ``levels``:
    speed levels that the tuning aims at (see :mod:`up_samp.motion.fleet.speed`).
    """

    tiny: float = 1e-7
    kink: float = 1e-6
    corner: float = 0.1
    bent: float = 0.1
    levels: int = 20


CUT = Cut()

_numbers = itertools.count()


def hull_of(body: Body) -> Hull:
    """Return the (cached) convex parts of a planar body."""
    return _hull(shape_of(body))


@lru_cache(maxsize=1024)
def _hull(shape: Shape) -> Hull:
    most = max(len(part) for part in shape.parts)
    verts = np.zeros((len(shape.parts), most, 2))
    counts = np.zeros(len(shape.parts), dtype=np.int64)
    for i, part in enumerate(shape.parts):
        verts[i, : len(part)] = part
        verts[i, len(part) :] = part[-1]
        counts[i] = len(part)
    return Hull(verts, counts, float(shape.circumscribed), float(shape.inscribed))


@dataclass(frozen=True, eq=False)
class Path:
    """A body's path. Arrays by sample: ``poses`` (n, 3), ``s`` (n,) from 0 strictly increasing,
    ``kink`` (n,) whether the curvature changes there, ``stop`` (n,) whether it must rest there.

    Arrays by cell boundary: ``edges`` (m + 1,) values of ``s``, ``halt`` (m + 1,) whether it must
    rest there. Extended cell 0 is the rest at the start, cells 1..m are the path's, cell m + 1 is
    the rest at the end. ``tunable`` says whether speeds along it may be chosen freely.
    """

    body: Body
    poses: FloatArray
    s: FloatArray
    kink: BoolArray
    stop: BoolArray
    edges: FloatArray
    halt: BoolArray
    tunable: bool
    natural: Trajectory
    """The trajectory it came from, shifted to start at time 0."""
    natural_s: FloatArray
    """``s`` at each sample of ``natural``."""
    cleared: set[tuple[Ring, Configuration]] = field(default_factory=set)
    """Resting bodies (footprint, pose) that the path's planner has proven it keeps clear of."""
    number: int = field(default_factory=lambda: next(_numbers))

    @property
    def cells(self) -> int:
        """Number of cells without the two rests."""
        return len(self.edges) - 1

    @property
    def length(self) -> float:
        """Whole length in ``s`` (m)."""
        return float(self.s[-1])

    @property
    def fastest(self) -> float:
        """A time (s) that no timing of the path beats (a car's natural timing is the fastest)."""
        kin = self.body.kinematics
        if kin.model is MotionModel.REEDSSHEPP or not self.tunable:
            return self.natural.duration
        return self.length / kin.v_max

    @cached_property
    def rests(self) -> tuple[tuple[Ring, Configuration], tuple[Ring, Configuration]]:
        """The body (footprint, pose) where it rests at first, and in the end."""
        first, last = (tuple(float(x) for x in self.poses[i]) for i in (0, -1))
        return (self.body.footprint, first), (self.body.footprint, last)

    @cached_property
    def hull(self) -> Hull:
        """The body's convex parts."""
        return hull_of(self.body)

    @cached_property
    def swept(self) -> Swept:
        """Swept bounds of all extended cells and their halves."""
        return Swept(sweep_table(self.s, self.poses, self.edges), self.hull)

    @cached_property
    def natural_held(self) -> FloatArray:
        """When ``natural`` enters each extended cell (it rests there for ever before and after)."""
        times = self.natural.times
        return occupancy(times, self.natural_s, self.edges, -math.inf, math.inf)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Bounding box (x low, y low, x high, y high) of everything the body sweeps (m)."""
        reach = self.hull.radius + 1e-6
        low, high = self.poses[:, :2].min(axis=0) - reach, self.poses[:, :2].max(axis=0) + reach
        # between two samples an arc may leave their box by its sagitta, less than the half step
        bulge = 0.5 * float(np.max(np.diff(self.s), initial=0.0))
        return (
            float(low[0]) - bulge,
            float(low[1]) - bulge,
            float(high[0]) + bulge,
            float(high[1]) + bulge,
        )

    def poses_at(self, s: FloatArray) -> FloatArray:
        """Return the poses, shape (k, 3), at the parameters ``s`` (k,), along constant twists."""
        if len(self.s) == 1:
            return np.repeat(self.poses, len(s), axis=0)
        i = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        share = np.clip((s - self.s[i]) / (self.s[i + 1] - self.s[i]), 0.0, 1.0)
        out = partway(self.poses[i], self.poses[i + 1], share)
        out[s <= self.s[0]] = self.poses[0]
        out[s >= self.s[-1]] = self.poses[-1]
        return out


def path_of(trajectory: Trajectory, body: Body, waypoints: Sequence[Configuration] = ()) -> Path:
    """Cut a planar body's trajectory through ``waypoints`` into a :class:`Path`.

    It must rest where the trajectory pauses and where its direction jumps, and pass the waypoints
    between exactly, at any speed.
    """
    poses = np.asarray(trajectory.poses, dtype=np.float64)
    model = body.kinematics.model
    v_max, omega_max = body.kinematics.v_max, body.kinematics.omega_max
    turn_metre = hull_of(body).radius
    if abilities_of(body).pivots:
        turn_metre = v_max / omega_max
    elif model is MotionModel.REEDSSHEPP:
        turn_metre = 0.0
    moves = twists(poses)
    steps = np.hypot(moves[:, 0], moves[:, 1])
    steps = np.maximum(steps, turn_metre * np.abs(moves[:, 2]))
    natural_s = np.concatenate([[0.0], np.cumsum(steps)])
    keep = _kept_samples(natural_s)
    s, kept = natural_s[keep], poses[keep]
    kink, stop = _kinks(kept, s, model)
    tunable = not abilities_of(body).free
    if tunable:
        stop |= _pauses(trajectory, natural_s, s)
        kink |= stop | _waypoints(trajectory, natural_s, s, waypoints[1:-1])
    if model is MotionModel.SE2 and _bends_hard(kept, s, stop, body):
        # speeds are tuned along a path for speed alone: a blended corner would be taken too fast
        tunable = False
    edges, halt = _cells(s, stop, _cell_length(body))
    return Path(
        body,
        kept,
        s,
        kink,
        stop,
        edges,
        halt,
        tunable,
        trajectory.shifted(-trajectory.start),
        natural_s,
    )


def resting_path(body: Body, pose: Configuration) -> Path:
    """Return the path of a body that stays where it is."""
    trajectory = Trajectory(np.zeros(1), np.array([pose], dtype=np.float64))
    return path_of(trajectory, body)


def _kept_samples(s: FloatArray) -> IntArray:
    """Return samples that lie at least a tiny step apart, always with the first and the last."""
    if np.all(np.diff(s) >= CUT.tiny):
        return np.arange(len(s), dtype=np.int64)
    keep = [0]
    for i in range(1, len(s)):
        if s[i] - s[keep[-1]] >= CUT.tiny:
            keep.append(i)
    if keep[-1] != len(s) - 1 and len(keep) > 1:
        keep[-1] = len(s) - 1
    return np.array(keep, dtype=np.int64)


def _kinks(poses: FloatArray, s: FloatArray, model: MotionModel) -> tuple[BoolArray, BoolArray]:
    """Return where the twist's direction jumps, and where the body must therefore rest."""
    n = len(s)
    kink, stop = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    kink[0] = kink[-1] = stop[0] = stop[-1] = True
    if n > 2:
        unit = twists(poses) / np.diff(s)[:, None]
        kink[1:-1] = np.abs(np.diff(unit, axis=0)).max(axis=1) > CUT.kink
        if model is MotionModel.REEDSSHEPP:
            stop[1:-1] = unit[:-1, 0] * unit[1:, 0] < 0
        else:
            # a velocity may not jump: chords of smooth curves turn little from sample to sample
            chord = np.diff(poses, axis=0) / np.diff(s)[:, None]
            stop[1:-1] = np.abs(np.diff(chord, axis=0)).max(axis=1) > CUT.corner
    return kink, stop


def _bends_hard(poses: FloatArray, s: FloatArray, stop: BoolArray, body: Body) -> bool:
    """Return whether going on at full speed where the way bends, or where it begins to turn more or
    less on its way, takes more acceleration than what speeding up or braking leaves over.
    """
    steps = np.diff(s)
    way = np.diff(poses[:, :2], axis=0) / steps[:, None]
    change = np.hypot(*np.diff(way, axis=0).T)
    mean = 0.5 * (steps[1:] + steps[:-1])
    moving = (steps[1:] > CUT.tiny) & (steps[:-1] > CUT.tiny) & ~stop[1:-1]
    kin = body.kinematics
    most = CUT.bent * kin.a_max / kin.v_max**2
    # tuned motions follow constant twists: who turns on a straight way would sway from side to side
    turn = np.where(np.hypot(*way.T) > 1e-6, np.abs(np.diff(poses[:, 2])) / steps, 0.0)
    return bool(np.any(change[moving] > most * mean[moving]) or np.any(turn > most))


def _waypoints(
    trajectory: Trajectory, natural_s: FloatArray, s: FloatArray, inner: Sequence[Configuration]
) -> BoolArray:
    """Return which samples of the path stand for the ``inner`` waypoints."""
    found: list[float] = []
    after = 0
    for pose in inner:
        gap = np.abs(trajectory.poses[after:, :2] - np.array(pose[:2])).max(axis=1)
        turn = trajectory.poses[after:, 2] - pose[2]
        gap = np.maximum(gap, np.abs(turn - 2 * np.pi * np.round(turn / (2 * np.pi))))
        hits = np.flatnonzero(gap < 1e-6)
        after += int(hits[0]) if len(hits) else int(np.argmin(gap))
        found.append(natural_s[after])
    return _marks(s, found)


def _pauses(trajectory: Trajectory, natural_s: FloatArray, s: FloatArray) -> BoolArray:
    """Return at which samples of the path the trajectory stands still for a while."""
    still = np.diff(natural_s) < CUT.tiny
    paused = np.flatnonzero(still & (np.diff(trajectory.times) > 0.5 * Trajectory.MAX_STEP))
    return _marks(s, natural_s[paused])


def _marks(s: FloatArray, values: Iterable[float]) -> BoolArray:
    """Return which samples are nearest to the ``values`` of ``s``."""
    marks = np.zeros(len(s), dtype=np.bool_)
    for value in values:
        marks[int(np.argmin(np.abs(s - value)))] = True
    return marks


def _cell_length(body: Body) -> float:
    """Return the wished length (m) of a cell: short beside the body, about so many speeds."""
    k, radius = body.kinematics, hull_of(body).radius
    return float(np.clip(k.v_max**2 / (2 * k.a_max * CUT.levels), 0.1 * radius, 0.2 * radius))


def _cells(s: FloatArray, stop: BoolArray, wish: float) -> tuple[FloatArray, BoolArray]:
    """Cut every stretch between two stops into an even number of equally long cells."""
    if len(s) == 1:
        return np.zeros(1), np.ones(1, dtype=np.bool_)
    marks = s[stop]
    edges: list[FloatArray] = []
    halt: list[bool] = []
    for low, high in itertools.pairwise(marks):
        count = 2 * max(1, math.ceil((high - low) / wish / 2))
        edges.append(np.linspace(low, high, count + 1)[:-1])
        halt += [True] + [False] * (count - 1)
    edges.append(marks[-1:])
    return np.concatenate(edges), np.array([*halt, True], dtype=np.bool_)
