"""A workspace that remembers paths, and what they have to do with each other."""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np

from up_samp.geometry.kernels import first_hit
from up_samp.geometry.memory import Memory
from up_samp.geometry.meshes import met_by
from up_samp.geometry.scene import Scene
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    Rest,
    check_time,
    same_pose,
)
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.fleet.conflicts import (
    ROOM,
    conflicting_cells,
    eased,
    kept,
    passing_gaps,
    separation,
    wished,
)
from up_samp.motion.fleet.flyers import gaps_at_ends, meeting_cells
from up_samp.motion.fleet.lanes import shifted_lane
from up_samp.motion.fleet.paths import (
    Path,
    first_meeting,
    forbidden,
    path_of,
    resting_path,
    solid_of,
    stay_far,
    through_zones,
)
from up_samp.motion.fleet.timed_path import TimedPath, Timing, pair_flags
from up_samp.motion.guides import widest_shape
from up_samp.motion.legs import comes_straight, docking_leg, strung
from up_samp.motion.models import MODELS, made_by
from up_samp.motion.protocol import Leg, LegQuery, MotionPlanner, obstacle_key
from up_samp.motion.registry import PLANNERS
from up_samp.tuning import Tuning


def is_cleared(path: Path, rest: Path) -> bool:
    """Return whether a path's planner has proven that it keeps clear of a body that rests."""
    return rest.cells == 0 and rest.rests[0] in path.cleared


def but_cleared(rows: IntArray, a: Path, b: Path) -> IntArray:
    """Return conflicting cells without rests of one path that the other one's planner has proven it
    keeps clear of: cells are coarser than that.
    """
    if len(rows) == 0 or not (a.cleared or b.cleared):
        return rows
    for rest, cell in zip(a.rests, (0, a.cells + 1), strict=True):
        if rest in b.cleared:
            rows = rows[rows[:, 0] != cell]
    for number, rest in enumerate(b.rests):
        if rest not in a.cleared or len(rows) == 0:
            continue
        rows = rows.copy()
        if number == 0:
            rows[:, 1] = np.maximum(rows[:, 1], 1)
        else:
            rows[:, 2] = np.minimum(rows[:, 2], b.cells)
        rows = rows[rows[:, 1] <= rows[:, 2]]
    return rows


PATHS, DIAGRAMS = 4_000, 400_000
"""Paths of each kind (a fleet of 50 with 150 orders drives 300), and pairs of paths whose conflicts
are known, that are remembered.
"""

NOTHING = np.empty((0, 3), dtype=np.int64)
"""No conflicting cells."""
NO_GAPS = np.empty((0, 2, 2, 2))
"""Nothing that two bodies have to pass one before the other."""


class PathPlanner(Protocol):
    """What this package needs of a motion service: single paths among resting obstacles."""

    def plan(self, query: PathQuery, deadline: Deadline) -> PathReport:
        """Return the best path of one body among the query's obstacles."""
        ...


@dataclass
class KnownPaths:
    """Paths from pose to pose that were of use, by number, how often others were looked for, and
    whether ways past the places where others may stand were.
    """

    paths: dict[int, Path] = field(default_factory=dict)
    looks: int = 0
    past: bool = False

    def quickest_first(self) -> list[Path]:
        """Return the paths, those that may be the quickest first."""
        return sorted(self.paths.values(), key=lambda path: (path.fastest, path.number))


class Workspace:
    """Paths and their conflicts, remembered across queries of one motion service."""

    def __init__(self, service: PathPlanner) -> None:
        self.tuning: Tuning = getattr(service, "tuning", Tuning())
        self._service = weakref.ref(service)  # the service owns its workspace, not the other way
        self.truncated = 0
        """How often a path's search was cut short; what came of it is not remembered."""
        self._paths: Memory[Path | PathReport] = Memory(PATHS)
        self._quick: dict[MotionModel, MotionPlanner | None] = {}
        self._legs: Memory[Leg] = Memory(PATHS)
        self._drives: Memory[Path] = Memory(PATHS)
        self._lanes: Memory[Path | None] = Memory(PATHS)
        self._rests: Memory[Path] = Memory(PATHS)
        self._ways: Memory[KnownPaths] = Memory(PATHS)
        self._conflicts: Memory[IntArray] = Memory(DIAGRAMS)
        self._passing: Memory[FloatArray] = Memory(DIAGRAMS)

    @property
    def service(self) -> PathPlanner:
        """The motion service that paths are asked from."""
        service = self._service()
        if service is None:
            raise ReferenceError("the motion service of this workspace is gone")
        return service

    def path(
        self,
        body: Body,
        poses: tuple[Configuration, ...],
        obstacles: Iterable[Placed],
        deadline: Deadline,
    ) -> Path | PathReport:
        """Return the service's best path as a :class:`Path`, or its report if it has none."""
        obstacles = tuple(obstacles)
        around = frozenset((solid_of(p.body), p.pose) for p in obstacles)
        key = (body, poses, around)
        known = self._paths.get(key)
        if known is not None:
            return known
        report = self.service.plan(PathQuery(body, poses, obstacles), deadline)
        if report.trajectory is None:
            self.truncated += report.outcome is Outcome.OUT_OF_TIME
            return report
        # the same path is often the answer to several questions: conflicts are known by path
        drive = (body, poses, report.trajectory.poses.tobytes())
        motion = report.trajectory
        path = self._drives.get_or(drive, lambda: path_of(motion, body, poses))
        path.cleared.update(around)
        if report.complete:
            return self._paths.put(key, path)
        self.truncated += 1
        return path

    def ways(self, body: Body, poses: tuple[Configuration, ...]) -> KnownPaths:
        """Return the ways of a body from pose to pose that were of use."""
        return self._ways.get_or((body, poses), KnownPaths)

    def detour(
        self,
        body: Body,
        poses: tuple[Configuration, ...],
        static: Sequence[Placed],
        others: Iterable[Placed],
        deadline: Deadline,
    ) -> Path | None:
        """Return a path that is cheap to find, if there is one, around what is ``static`` and
        ``others``, who stand there for a while.

        Unlike :meth:`path` it gives up early, since a detour is only one way of several. From walls
        and what is static it keeps the margin, whoever else stands near its ends.
        """
        path = self._detour(body, poses, (*static, *others), deadline)
        known = path is not None and self._keeps(path, poses, met_by(body, static))
        return path if known else None

    def _keeps(
        self, path: Path, poses: Sequence[Configuration], static: tuple[Placed, ...]
    ) -> bool:
        """Return whether a path keeps as much of the margin from walls and what is static as its
        ends do. (Planners keep as much from everything as the ends keep from anything.)
        """
        if self.scene is None or path.body.flies:
            return True
        shape = widest_shape(self.scene, path.body, poses, static)
        return shape is not None and first_hit(self.scene.world(shape, static), path.poses) < 0

    def _detour(
        self,
        body: Body,
        poses: tuple[Configuration, ...],
        obstacles: tuple[Placed, ...],
        deadline: Deadline,
    ) -> Path | None:
        quick = self._quick_planner(body)
        if quick is None or self.scene is None:
            if not body.flies:  # who plans for flyers counts its work, others get half a second
                deadline = deadline.within(0.5)
            path = self.path(body, poses, obstacles, deadline)
            return path if isinstance(path, Path) else None
        around = frozenset((solid_of(p.body), p.pose) for p in obstacles)
        key = (body, poses, around, "detour")
        known = self._paths.get(key)
        if known is None:
            seen = met_by(body, obstacles)
            legs: list[Leg] = []
            for start, goal in itertools.pairwise(poses):
                if same_pose(start, goal):
                    continue
                asked = LegQuery(body, start, goal, seen)
                leg = docking_leg(self.scene, asked) or self._quick_leg(quick, asked, deadline)
                legs.append(leg)
                if leg.trajectory is None:
                    outcome = Outcome.NOT_FOUND if leg.complete else Outcome.OUT_OF_TIME
                    known = PathReport(outcome, reason=leg.reason)
                    break
            else:
                motion, _ = strung(self.scene, PathQuery(body, poses, seen), legs)
                known = path_of(motion, body, poses)
                known.cleared.update(around)
            if all(leg.complete for leg in legs):
                self._paths.put(key, known)
        return known if isinstance(known, Path) else None

    def _quick_leg(self, quick: MotionPlanner, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a quick planner's leg, where that may be driven either way one for both ways."""
        asked = query.remembered(reversible=quick.reversible)
        key = (asked.body, asked.start, asked.goal, obstacle_key(asked.obstacles))
        leg = self._legs.get(key)
        if leg is None:
            leg = quick.leg(asked, deadline)
            if leg.complete:
                self._legs.put(key, leg)
        return leg if asked is query else leg.turned(query.start)

    def _quick_planner(self, body: Body) -> MotionPlanner | None:
        """Return the planner of a body's motion model that gives up after little work, if any."""
        model = body.kinematics.model
        if model not in self._quick and self.scene is not None:
            made = getattr(made_by(PLANNERS[MODELS[model].planners[0]]), "quick", None)
            self._quick[model] = None if made is None else made(self.scene, 0)
        return self._quick.get(model)

    @cached_property
    def scene(self) -> Scene | None:
        """The map that the service plans in, if it tells."""
        return getattr(self.service, "scene", None)

    @property
    def margin(self) -> float:
        """The clearance (m) to keep between two bodies."""
        return wished(self.scene)

    def lane(self, path: Path, first: float, last: float, offset: float) -> Path | None:
        """Return ``path`` moved sideways by ``offset`` m on [first, last] m, if the map allows; not
        on more than 25 m.
        """
        scene = self.scene
        if scene is None or path.body.flies or last - first > 25.0:
            return None
        key = (path.number, first, last, offset)
        lane = self._lanes.get_or(key, lambda: shifted_lane(scene, path, first, last, offset))
        return lane if lane is None or comes_straight(lane.poses, lane.body) else None

    def resting(self, body: Body, pose: Configuration) -> Path:
        """Return the path of a body that stays at ``pose``."""
        key = (solid_of(body), pose)
        return self._rests.get_or(key, lambda: resting_path(body, pose))

    def crowds(self, path: Path, body: Body, pose: Configuration) -> bool:
        """Return whether a body at a pose is near an end of a path."""
        rest, enough = self.resting(body, pose), self.margin + ROOM
        if path.body.flies or body.flies:
            return min(gaps_at_ends(path.solid, rest.solid)) < enough
        return any(
            separation(end, path.hull, rest.poses[0], rest.hull) <= enough
            for end in path.poses[[0, -1]]
        )

    def conflicts(self, a: Path, b: Path) -> IntArray:
        """Return the conflicting cells of two paths as rows (i, j first, j last)."""
        key = (a.number, b.number)
        known = self._conflicts.get(key)
        if known is not None:
            return but_cleared(known, a, b)
        if is_cleared(a, b) or is_cleared(b, a):
            return NOTHING
        p, q = a.box, b.box
        if p[0] > q[2] or q[0] > p[2] or p[1] > q[3] or q[1] > p[3]:
            return self._conflicts.put(key, NOTHING)
        check_time()
        return but_cleared(self._conflicts.put(key, self._meeting_cells(a, b)), a, b)

    def _meeting_cells(self, a: Path, b: Path) -> IntArray:
        margin = self.margin
        if a.body.flies or b.body.flies:
            for gap in gaps_at_ends(a.solid, b.solid):
                margin = eased(margin, gap) if gap > 0.0 else margin
            return meeting_cells(a.solid, b.solid, margin)
        margin = kept(margin, a.poses[[0, -1]], a.hull, b.poses[[0, -1]], b.hull)
        rows = conflicting_cells(a.swept, b.swept, margin)
        return through_zones(rows, a.entries, b.entries)

    def passing(self, a: Path, b: Path, flags: int) -> FloatArray:
        """Return what it takes that one of two bodies passes before the other where their paths
        meet (see :func:`~up_samp.motion.fleet.conflicts.passing_gaps`), if none stops on its way.
        """
        rows = self.conflicts(a, b)
        if len(rows) == 0:
            return NO_GAPS

        def gaps() -> FloatArray:
            ordered = np.ascontiguousarray(rows[np.lexsort((rows[:, 1], rows[:, 0]))])
            return passing_gaps(ordered, a.natural_held, b.natural_held, flags)

        # paths that are found to clear rests later have fewer conflicts: what is known stays enough
        return self._passing.get_or((a.number, b.number, flags), gaps)

    def forbidden(
        self, path: Path, name: str, avoid: frozenset[str] | None, others: Iterable[TimedPath]
    ) -> FloatArray:
        """Return rows (cell, from, until) in which ``others`` keep the object ``name`` from
        cells of ``path``.
        """
        parts: list[FloatArray] = []
        for other in others:
            flags = pair_flags(name, avoid, other.object, other.avoid)
            if other.object == name or flags == 0:
                continue
            runs = self.conflicts(path, other.path)
            if len(runs):
                out = np.empty((len(runs), 3))
                used = forbidden(runs, path.cells, other.held, flags, out, 0)
                parts.append(out[:used])
        return np.concatenate(parts) if parts else np.empty((0, 3))

    def meeting(self, a: TimedPath, b: TimedPath) -> tuple[float, int, int]:
        """Return (time, cell of a, cell of b) of the first conflict of two runs (inf: none)."""
        flags = 0 if a.object == b.object else pair_flags(a.object, a.avoid, b.object, b.avoid)
        if flags == 0 or (not self.knows(a.path, b.path) and self.far_apart(a, b)):
            return math.inf, -1, -1
        runs = self.conflicts(a.path, b.path)
        return first_meeting(runs, a.held, b.held, flags)

    def knows(self, a: Path, b: Path) -> bool:
        """Return whether the conflicts of two paths are known."""
        return (a.number, b.number) in self._conflicts

    def far_apart(self, a: TimedPath, b: TimedPath) -> bool:
        """Return whether two runs cannot meet: one is of no concern to the other, or by their
        distance over time alone.
        """
        if a.object == b.object or not pair_flags(a.object, a.avoid, b.object, b.avoid):
            return True
        if a.path.heeds_stops or b.path.heeds_stops:
            return False
        if a.held[-1] <= b.held[0] or b.held[-1] <= a.held[0]:
            return True
        return _stay_far(a, b, self.margin)


def _stay_far(a: TimedPath, b: TimedPath, margin: float) -> bool:
    """Return whether two runs cannot meet, by their distance over time alone."""
    p, q = a.timing.trajectory, b.timing.trajectory
    low = max(a.held[0], b.held[0], -1e9)
    high = min(a.held[-1], b.held[-1], 1e9)
    # 0.1 m for positions read along chords: a slack millisecond step moves less than that
    reach = a.path.radius + b.path.radius + 2 * margin + 0.1
    speed = max(1e-6, a.speed + b.speed)
    return bool(stay_far(p.times, p.poses, q.times, q.poses, low, high, reach, speed))


_workspaces: WeakKeyDictionary[PathPlanner, Workspace] = WeakKeyDictionary()


def workspace_of(service: PathPlanner) -> Workspace:
    """Return the workspace that belongs to a motion service."""
    if service not in _workspaces:
        _workspaces[service] = Workspace(service)
    return _workspaces[service]


def rest_run(workspace: Workspace, rest: Rest) -> TimedPath:
    """Return a resting object as a run."""
    path = workspace.resting(rest.body, rest.pose)
    timing, nobody = Timing(path.natural, path.natural_s), frozenset[str]()  # it does not move
    return TimedPath(rest.name, rest.name, path, timing, rest.since, rest.until, nobody)
