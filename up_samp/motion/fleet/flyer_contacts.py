"""Free flyers (SE3) and bodies that drive below them over time, and when two come too close.

Checked by conservative advancement over time (Mirtich 1996), so that nothing slips through between
two checks.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from up_samp.geometry.meshes import Mesh, mesh_of, nested, surface_distance, transform
from up_samp.model import Body, Configuration, Trajectory
from up_samp.motion.fleet.margins import CLEARANCES, eased

FloatArray = npt.NDArray[np.float64]

TOUCH = 5e-5
"""Clearance (m) that counts as none; path planners keep more."""
SKY = 1e4
"""How far (m) bodies that move in the plane reach down and, where they have no height, up."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A body that is there during [``since``, ``until``] (s) and follows ``trajectory``, resting
    before and after; during ``busy`` (s) it keeps clear of the objects in ``avoid`` (None: all).
    """

    name: str
    object: str
    body: Body
    trajectory: Trajectory
    since: float
    until: float
    busy: tuple[float, float] | None = None
    avoid: frozenset[str] | None = None

    @cached_property
    def mesh(self) -> Mesh:
        """The body's surface, in its own frame."""
        pose = self.ends[0] if self.body.flies else (0.0, 0.0, 0.0)
        return mesh_of(self.body, pose, -SKY, SKY)[0]

    @cached_property
    def reach(self) -> float:
        """Greatest distance (m) of the surface from its axis of turning."""
        if self.body.flies:
            return self.mesh.radius
        return max(math.hypot(x, y) for x, y in self.body.footprint)

    @cached_property
    def ends(self) -> tuple[Configuration, Configuration]:
        """The first and the last pose."""
        first, last = self.trajectory.poses[0], self.trajectory.poses[-1]
        return tuple(map(float, first)), tuple(map(float, last))

    @cached_property
    def travel(self) -> FloatArray:
        """How far (m) any point of the body has moved at most, up to each sample."""
        poses = self.trajectory.poses.copy()
        if len(poses) == 1:
            return np.zeros(1)
        if not self.body.flies:
            return np.concatenate([[0.0], np.cumsum(_arcs(poses, self.reach))])
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
        # half the angle between two quaternions, by the chords to q and -q
        chords = [np.linalg.norm(poses[1:, 3:] + k * poses[:-1, 3:], axis=1) for k in (-1, 1)]
        turns = 4 * np.arctan2(np.minimum(*chords), np.maximum(*chords))
        ways = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
        ways = ways + self.mesh.radius * turns
        return np.concatenate([[0.0], np.cumsum(ways)])

    def pose(self, t: float) -> Configuration:
        """Return the pose (7 numbers) of the mesh at time ``t``."""
        return in_space(self.trajectory.at(t))

    def heeds(self, other: Flight) -> bool:
        """Return whether it has to keep clear of ``other`` while it is busy."""
        return self.busy is not None and (self.avoid is None or other.object in self.avoid)


def in_space(pose: Configuration) -> Configuration:
    """Return a pose as 7 numbers: upright on the floor, where it is one in the plane."""
    if len(pose) == 7:
        return pose
    x, y, heading = pose
    return (x, y, 0.0, 0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))


def _arcs(poses: FloatArray, reach: float) -> FloatArray:
    """Return how far any point of a planar body moves at most between samples: along arcs."""
    chords = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turns = np.abs(np.diff(poses[:, 2]))
    half = 0.5 * turns
    # at most pi: more of a turn than that between two samples is a path of unknown length
    bend = np.where(half > 1e-9, half / np.maximum(np.sin(np.minimum(half, 1.5)), 1e-9), 1.0)
    return np.asarray(chords * np.maximum(bend, 1.0) + reach * turns)


def gap(a: Flight, pose_a: Configuration, b: Flight, pose_b: Configuration, enough: float) -> float:
    """Return the distance (m) of two bodies' surfaces; more than ``enough`` (m) may be told as
    less, where that is cheaper, but as more than that.
    """
    # what drives is a column: there only the distance along the floor tells how far away it is
    size = 3 if a.body.flies and b.body.flies else 2
    reaches = a.reach + b.reach
    apart = math.dist(pose_a[:size], pose_b[:size]) - reaches
    if apart > 0.5 * reaches + enough:
        return apart
    return surface_distance(a.mesh, transform(pose_a), b.mesh, transform(pose_b))


def margin_of(a: Flight, b: Flight, wish: float) -> float:
    """Return the clearance (m) that two moving bodies keep: less than ``wish`` where they rest
    closer to each other than that.
    """
    if len(a.trajectory.times) == 1 or len(b.trajectory.times) == 1:
        return 0.0  # the path planner kept its margin from what rests
    ends = itertools.product(a.ends, b.ends)
    enough = wish + CLEARANCES.room
    least = min(gap(a, in_space(p), b, in_space(q), enough) for p, q in ends)
    return eased(wish, least)


def first_contact(a: Flight, b: Flight, wish: float) -> float:
    """Return when (s) two bodies first come closer than they may (inf: never): ``wish`` m, or less
    where they rest closer than that.
    """
    if a.object == b.object:
        return math.inf
    spans = [x.busy for x, y in ((a, b), (b, a)) if x.busy is not None and x.heeds(y)]
    margin = -1.0
    for low, high in sorted(spans):
        low, high = max(low, a.since, b.since), min(high, a.until, b.until)
        if low >= high:
            continue
        margin = margin_of(a, b, wish) if margin < 0.0 else margin
        at = _contact_within(a, b, low, high, margin)
        if at < math.inf:
            return at
    return math.inf


def _contact_within(a: Flight, b: Flight, low: float, high: float, margin: float) -> float:
    """Advance through [low, high] by as much as the clearance allows."""
    marks = np.unique(np.concatenate([a.trajectory.times, b.trajectory.times, [low, high]]))
    marks = marks[(marks >= low) & (marks <= high)]
    way = sum(np.interp(marks, x.trajectory.times, x.travel) for x in (a, b))
    if nested(a.mesh, a.pose(low), b.mesh, b.pose(low)):
        return low
    t, last = low, float(way[-1])
    while True:
        clear = gap(a, a.pose(t), b, b.pose(t), margin) - margin
        if clear <= TOUCH:
            return t
        reach = float(np.interp(t, marks, way)) + clear
        if reach >= last:
            return math.inf
        t = max(t, float(np.interp(reach, way, marks)))
