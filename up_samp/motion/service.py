"""The one face of motion planning that the rest of the package uses."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

from up_samp.geometry import OccupancyGrid, Scene, sweeps
from up_samp.geometry import kernels as k
from up_samp.geometry.shapes import shape_of
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    GroupQuery,
    GroupReport,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    Trajectory,
)
from up_samp.motion.cache import Entry, MotionCache, obstacle_key
from up_samp.motion.curves.trajectories import at_rest, joined, reversed_trajectory
from up_samp.motion.proofs.bounds import Bounds
from up_samp.motion.proofs.certificates import TOUCH, Certifier
from up_samp.motion.protocol import Leg, LegQuery, MotionPlanner
from up_samp.motion.registry import SECOND_OPINION_SECONDS, make_planner, planner_names
from up_samp.motion.warm import warm_up

log = logging.getLogger(__name__)

PLANAR = (MotionModel.REEDSSHEPP, MotionModel.SE2)
LAZY_ROUNDS = 3
QUICK_SECONDS = 1.0
"""After so long without a motion, a proof over positions and headings is tried."""
PROOF_SECONDS = 5.0
FIRST_SHARE = 0.75
"""Share of a query's time for the first planner, where others give their opinion after it."""


class MotionService:
    """Plans, bounds and refutes motions on one map (None: the open plane).

    ``planner``: a name of :data:`up_samp.motion.registry.PLANNERS`, or ``"default"``: chosen by
    what each body needs. ``margin`` (m): clearance that plans keep from walls and objects; less
    where a start or a goal is closer than that. Same seed, same answers. ``cache`` may be shared.
    """

    def __init__(
        self,
        grid: OccupancyGrid | None,
        *,
        planner: str = "default",
        margin: float = 0.01,
        seed: int = 0,
        cache: MotionCache | None = None,
    ) -> None:
        self.grid = grid
        self.scene = Scene(grid, margin)
        self.planner = planner
        self.seed = seed
        self.cache = MotionCache() if cache is None else cache
        self.certifier = Certifier(self.scene)
        self.bounds = Bounds(self.scene, self.certifier)
        self._planners: dict[str, MotionPlanner] = {}

    def plan(self, query: PathQuery, deadline: Deadline) -> PathReport:
        """Answer a query: found, proven impossible, or out of time."""
        warm_up(query.body.kinematics.model)
        began = time.monotonic()
        proof = self.certificate(query.body, query.poses, query.obstacles)
        if proof is not None:
            return _timed(proof, began)
        names = planner_names(self.planner, query.body)
        parts, used = [at_rest(query.poses[0])], ""
        for start, goal in zip(query.poses, query.poses[1:], strict=False):
            if tuple(start) == tuple(goal):
                continue
            leg = LegQuery(query.body, start, goal, query.obstacles)
            report = self._leg(names, leg, deadline)
            if report.trajectory is None:
                return _timed(report, began)
            parts.append(report.trajectory)
            used = report.planner
        found = PathReport(Outcome.FOUND, joined(parts), planner=used)
        return _timed(found, began)

    def _leg(self, names: Sequence[str], query: LegQuery, deadline: Deadline) -> PathReport:
        """Return a leg from the cache or from the first planner that finds one."""
        reasons = []
        for name in names:
            planner = self._planner(name)
            known = self._known(planner, name, query)
            if known is not None:
                self.cache.hits += 1
                return PathReport(Outcome.FOUND, known, planner=name)
        self.cache.misses += 1
        for name in names:
            # the first planner ends by itself where it can, later ones are second opinions
            limit = FIRST_SHARE * deadline.remaining() if len(names) > 1 else None
            if name != names[0]:
                limit = SECOND_OPINION_SECONDS
            report = self._lazily(name, query, deadline.within(limit))
            if report.outcome is not Outcome.OUT_OF_TIME:
                return report
            reasons.append(f"{name}: {report.reason}")
            if deadline.expired():
                break
        return PathReport(
            Outcome.OUT_OF_TIME,
            blockers=self._in_the_way(query),
            reason="; ".join(reasons),
            planner=names[0],
        )

    def _lazily(self, name: str, query: LegQuery, deadline: Deadline) -> PathReport:
        """Plan among the obstacles that prove to matter only (so that more queries share a leg)."""
        planner = self._planner(name)
        body, obstacles = query.body, query.obstacles
        chosen: tuple[Placed, ...] = () if body.kinematics.model in PLANAR else obstacles
        for attempt in range(LAZY_ROUNDS + 1):
            if attempt == LAZY_ROUNDS:
                chosen = obstacles
            part = replace(query, obstacles=chosen)
            trajectory = self._known(planner, name, part)
            if trajectory is None:
                leg = self._ask(name, part, deadline)
                if isinstance(leg, PathReport):
                    return leg
                if leg.trajectory is None:
                    return PathReport(Outcome.OUT_OF_TIME, reason=leg.reason, planner=name)
                trajectory = leg.trajectory
                self.remember(name, part, trajectory)
            if chosen == obstacles:
                break
            hit = [
                p for p in obstacles if p not in chosen and not self._clears(trajectory, body, p)
            ]
            if not hit:
                break
            chosen = tuple(p for p in obstacles if p in chosen or p in hit)
            proof = self.certificate(body, (query.start, query.goal), chosen)
            if proof is not None:
                return proof
        return PathReport(Outcome.FOUND, trajectory, planner=name)

    def _ask(self, name: str, query: LegQuery, deadline: Deadline) -> Leg | PathReport:
        """Ask a planner; where it finds nothing at once, look for a stronger proof in between."""
        planner = self._planner(name)
        if name not in ("car", "planar") or self.grid is None:
            return planner.leg(query, deadline)
        leg = planner.leg(query, deadline.within(QUICK_SECONDS))
        if leg.trajectory is not None or deadline.expired():
            return leg
        limit = deadline.within(PROOF_SECONDS)
        ends = query.start, query.goal
        proof = self.certifier.prove_by_slices(query.body, *ends, query.obstacles, limit)
        if proof is not None:
            return proof
        return planner.leg(query, deadline)

    def _scope(self, name: str) -> tuple[object, ...]:
        return (self.scene.digest, name, self.scene.margin, self.seed)

    def remember(self, name: str, query: LegQuery, trajectory: Trajectory) -> None:
        """Put a leg that ``name`` planned into the cache."""
        planner = self._planner(name)
        what = query.body, query.start, query.goal
        key, swap = MotionCache.key(self._scope(name), *what, planner.reversible)
        stored = reversed_trajectory(trajectory) if swap else trajectory
        self.cache.put(key, Entry(obstacle_key(query.obstacles), stored, name))

    def _known(self, planner: MotionPlanner, name: str, query: LegQuery) -> Trajectory | None:
        """Return a remembered leg that was planned among a part of the obstacles and clears all."""
        body, obstacles = query.body, query.obstacles
        what = body, query.start, query.goal
        key, swap = MotionCache.key(self._scope(name), *what, planner.reversible)
        here = obstacle_key(obstacles)
        for entry in self.cache.get(key):
            if not entry.among <= here:
                continue
            rest = [p for p in obstacles if not obstacle_key([p]) <= entry.among]
            if rest and body.kinematics.model not in PLANAR:
                continue
            if all(self._clears(entry.trajectory, body, p) for p in rest):
                return reversed_trajectory(entry.trajectory) if swap else entry.trajectory
        return None

    def _clears(self, trajectory: Trajectory, body: Body, placed: Placed) -> bool:
        return self.parking_clears(trajectory, body, placed, self.scene.margin)

    def _in_the_way(self, query: LegQuery) -> frozenset[str]:
        """Return the obstacles that the way on the empty map would hit (all, if that is
        unknown).
        """
        body, obstacles = query.body, query.obstacles
        if body.kinematics.model not in PLANAR or not obstacles:
            return frozenset(p.name for p in obstacles)
        alone = replace(query, obstacles=())
        for name in planner_names(self.planner, body):
            free = self._known(self._planner(name), name, alone)
            if free is not None:
                hit = [p.name for p in obstacles if not self._clears(free, body, p)]
                return frozenset(hit)
        return frozenset(p.name for p in obstacles)

    def _planner(self, name: str) -> MotionPlanner:
        if name not in self._planners:
            self._planners[name] = make_planner(name, self.scene, self.seed)
        return self._planners[name]

    def lower_bound(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed] = (),
    ) -> float:
        """Return seconds that no motion between the two poses can beat."""
        return self.bounds.duration(body, start, goal, tuple(obstacles))

    def lower_bound_through(self, body: Body, poses: Sequence[Configuration]) -> float:
        """Return seconds that no motion through ``poses`` can beat, stopping there or not."""
        return self.bounds.through(body, poses)

    def certificate(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> PathReport | None:
        """Return a proof that the motion is impossible, with blockers and alternatives, or None."""
        if body.kinematics.model is MotionModel.SE3:
            return None
        began = time.monotonic()
        proof = self.certifier.prove(body, poses, tuple(obstacles))
        return None if proof is None else _timed(proof, began)

    def unreachable(
        self,
        body: Body,
        start: Configuration,
        targets: Mapping[str, Configuration],
        obstacles: Sequence[Placed],
    ) -> frozenset[str]:
        """Return the names of the targets that provably cannot be reached from ``start``."""
        if body.kinematics.model is MotionModel.SE3:
            return frozenset()
        return self.certifier.unreachable(body, start, targets, tuple(obstacles))

    def pose_blockers(
        self, body: Body, pose: Configuration, obstacles: Sequence[Placed]
    ) -> tuple[bool, frozenset[str]]:
        """Return whether a body at a pose overlaps the map, and the obstacles that it overlaps."""
        hit = {p.name for p in obstacles if self.overlap(body, pose, p.body, p.pose)}
        if body.kinematics.model is MotionModel.SE3:
            from up_samp.geometry.meshes import meets_walls

            return self.grid is not None and meets_walls(self.grid, body, pose), frozenset(hit)
        return self.certifier.hits_map(body, pose), frozenset(hit)

    def overlap(
        self, body_a: Body, pose_a: Configuration, body_b: Body, pose_b: Configuration
    ) -> bool:
        """Return whether two placed bodies share area, or in space, volume (SE3: or touch)."""
        if MotionModel.SE3 in (body_a.kinematics.model, body_b.kinematics.model):
            from up_samp.geometry.meshes import bodies_meet

            return bodies_meet(body_a, pose_a, body_b, pose_b)
        return self.scene.distance(body_a, pose_a, body_b, pose_b) < -TOUCH

    def parking_clears(
        self, trajectory: Trajectory, body: Body, placed: Placed, clearance: float = 0.0
    ) -> bool:
        """Return whether a motion keeps ``clearance`` (m) from a resting object, all the way."""
        shape = shape_of(body, clearance).data
        polys = self.scene.polys((placed,))
        nothing = k.open_plane()
        poses = trajectory.poses.copy()  # numba compiles anew for arrays that cannot be written
        return bool(sweeps.samples_free(nothing, polys, shape, poses, 1e-4) < 0)

    def parking_clearance(self, trajectory: Trajectory, body: Body, placed: Placed) -> float:
        """Return the smallest distance (m) of a motion to a resting object, at most 1 mm too small;
        <= 0 if they overlap.
        """
        shape = shape_of(body).data
        polys = self.scene.polys((placed,))
        return float(sweeps.samples_distance(polys, shape, trajectory.poses.copy(), 1e-3))

    def coordinate(
        self,
        query: GroupQuery,
        deadline: Deadline,
        *,
        method: str = "ladder",
        seed: int | None = None,
    ) -> GroupReport:
        """Find motions for a group that may meet, by one of the ``METHODS`` of
        :mod:`up_samp.motion.fleet` (``seed``: the service's own by default).
        """
        from up_samp.motion.fleet import coordinate

        seed = self.seed if seed is None else seed
        return coordinate(self, query, deadline, seed=seed, method=method)


def _timed(report: PathReport, began: float) -> PathReport:
    return PathReport(
        report.outcome,
        report.trajectory,
        report.blockers,
        report.alternatives,
        report.reason,
        report.planner,
        time.monotonic() - began,
    )
