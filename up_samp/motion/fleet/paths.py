"""Fixed paths, cut into short cells: the geometry that speed tuning and conflict checks share.

A path keeps the shape of a planner's trajectory and forgets its timing. Its parameter ``s`` (m) is
driven length for cars, and for bodies that turn on the spot where they drive; for omnidirectional
bodies, and on the spot, it is the larger of the length and the turn scaled by ``v_max /
omega_max``, so that ``|ds/dt| <= v_max`` bounds speed and turn rate at once.
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
from up_samp.motion.curves.twists import partway
from up_samp.motion.fleet.abilities import abilities_of
from up_samp.motion.fleet.bends import (
    CUT,
    bends_hard,
    kept_samples,
    kinks_and_stops,
    path_steps,
    top_speeds,
)
from up_samp.motion.fleet.cell_times import occupancy
from up_samp.motion.fleet.swept import Hull, Swept, sweep_table

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

Ring = tuple[tuple[float, float], ...]


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
    tops: FloatArray
    """Top speeds (m/s) between samples, shape (n - 1,): tight arcs have lower ones."""
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
    def caps(self) -> FloatArray:
        """Top speeds (m/s) at the cell boundaries: none that a cell beside it may not have."""
        return self.tops_within(
            np.concatenate([self.edges[:1], self.edges[:-1]]),
            np.concatenate([self.edges[1:], self.edges[-1:]]),
        )

    def tops_within(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the top speeds (m/s) on stretches from ``low`` (k,) to ``high`` (k,) m."""
        caps = np.full(len(low), self.body.kinematics.v_max)
        for k in np.flatnonzero(self.tops < self.body.kinematics.v_max):
            inside = (low < self.s[k + 1]) & (high > self.s[k])
            caps[inside] = np.minimum(caps[inside], self.tops[k])
        return caps

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
    natural_s = np.concatenate([[0.0], np.cumsum(path_steps(poses, body, hull_of(body).radius))])
    keep = kept_samples(natural_s)
    s, kept = natural_s[keep], poses[keep]
    kink, stop = kinks_and_stops(kept, s, body)
    tunable = not abilities_of(body).free
    if tunable:
        stop |= _pauses(trajectory, natural_s, s)
        kink |= stop | _waypoints(trajectory, natural_s, s, waypoints[1:-1])
    if model is MotionModel.SE2 and bends_hard(kept, s, stop, body):
        # speeds are tuned along a path for speed alone: a blended corner would be taken too fast
        tunable = False
    tops = top_speeds(kept, body)
    edges, halt = _cells(s, stop, tops, body)
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
        tops,
    )


def resting_path(body: Body, pose: Configuration) -> Path:
    """Return the path of a body that stays where it is."""
    trajectory = Trajectory(np.zeros(1), np.array([pose], dtype=np.float64))
    return path_of(trajectory, body)


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


def _cells(
    s: FloatArray, stop: BoolArray, tops: FloatArray, body: Body
) -> tuple[FloatArray, BoolArray]:
    """Cut every stretch between two stops into an even number of equally long cells."""
    if len(s) == 1:
        return np.zeros(1), np.ones(1, dtype=np.bool_)
    kin, wish = body.kinematics, _cell_length(body)
    edges: list[FloatArray] = []
    halt: list[bool] = []
    for low, high in itertools.pairwise(np.flatnonzero(stop)):
        top, length = float(tops[low:high].min()), float(s[high] - s[low])
        size = wish
        if top < kin.v_max:  # cells so short that there are speeds below the slowest arc's
            size = min(wish, top**2 / (2 * kin.a_max * CUT.least))
        count = 2 * max(1, math.ceil(length / size / 2))
        edges.append(np.linspace(s[low], s[high], count + 1)[:-1])
        halt += [True] + [False] * (count - 1)
    edges.append(s[-1:])
    return np.concatenate(edges), np.array([*halt, True], dtype=np.bool_)
