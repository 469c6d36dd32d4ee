"""The one face of motion planning that the rest of the package uses."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

from up_samp.extensions import parts
from up_samp.geometry import OccupancyGrid, Scene
from up_samp.geometry.memory import Memory
from up_samp.geometry.meshes import bodies_meet, meets_walls, met_by, surely_met
from up_samp.geometry.shapes import core_of
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    GroupQuery,
    GroupReport,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    TrafficZone,
    Trajectory,
    same_pose,
    stays,
)
from up_samp.motion.compile import warm_up
from up_samp.motion.curves.slowing import (
    as_obstacle,
    reverses_at_a_cost,
    seconds_of,
    slowed,
    slowing_zones,
)
from up_samp.motion.guides import along_lanes
from up_samp.motion.legs import (
    Legs,
    before_docking,
    check_ways,
    strung,
    strung_at_full_speed,
)
from up_samp.motion.proofs.bounds import DurationBounds
from up_samp.motion.proofs.certificates import Apart, Certifier
from up_samp.motion.protocol import Leg, LegQuery, MotionCache, obstacle_key
from up_samp.tuning import Tuning


class MotionService:
    """Plans, bounds and refutes motions on one map (None: the open plane).

    ``planner``: a name of :data:`up_samp.motion.registry.PLANNERS`, or ``"default"``: chosen by
    what each body needs. ``margin`` (m): clearance that plans keep from walls and objects; less
    where a start or a goal is closer than that. Same seed, same answers. ``cache`` may be shared.
    ``tuning``: how long is tried. Without ``proofs`` nothing is impossible before it is sought.

    Nothing here is guarded by locks: one service belongs to one thread (OMPL's random numbers even
    to one process). Several services may share a folder on disk, not a ``cache`` object.
    """

    def __init__(
        self,
        grid: OccupancyGrid | None,
        *,
        planner: str = "default",
        margin: float = 0.01,
        seed: int = 0,
        cache: MotionCache | None = None,
        tuning: Tuning = Tuning(),
        proofs: bool = True,
    ) -> None:
        self.tuning, self.proofs = tuning, proofs
        self.grid = grid
        self.scene = Scene(grid, margin)
        self.planner = planner
        self.seed = seed
        self.cache = MotionCache() if cache is None else cache
        self._final: Memory[PathReport] = Memory(4_000)
        """Motions that no more time would change."""
        self.certifier = Certifier(self.scene)
        self.bounds = DurationBounds(self.scene, self.certifier)
        self.legs = Legs(self.scene, planner, seed, self.cache, self.certifier, self.certificate)

    def plan(self, query: PathQuery, deadline: Deadline) -> PathReport:
        """Answer a query: found, proven impossible, not found, or out of time."""
        warm_up(query.body.kinematics.model)
        asked, query = query, replace(query, obstacles=met_by(query.body, query.obstacles))
        key = (query.body, query.poses, obstacle_key(query.obstacles))
        report = self._final.get(key)
        if report is None:
            report, final = self._planned(query, deadline)
            if final:
                self._final.put(key, report)
        told = report.outcome is Outcome.IMPOSSIBLE
        if told and surely_met(asked.body, asked.obstacles) != query.obstacles:
            proof = self.certificate(asked.body, asked.poses, asked.obstacles)
            return proof or replace(report, outcome=Outcome.NOT_FOUND)
        return report

    def _planned(self, query: PathQuery, deadline: Deadline) -> tuple[PathReport, bool]:
        """Answer a query, and return whether a motion was found that no more time would change."""
        proof = self.certificate(query.body, query.poses, query.obstacles)
        if proof is not None:
            return proof, False
        found = self._find(query, deadline)
        if isinstance(found, PathReport):
            return found, False
        used, legs = found
        whole, smooth = strung_at_full_speed(self.scene, query, legs)
        if query.body.kinematics.ways and used in parts("planners"):
            check_ways(query.body, whole, used)
        motion = slowed(whole, query.body)
        usual = query.body.but_docks  # what a dock asks for is the same on every way
        best = slowed(whole, usual) is whole and seconds_of(whole, usual) == whole.duration
        best = best and not query.body.kinematics.heeds_turns
        final = all(leg.complete for leg in legs)
        complete = smooth and best and final and not any(leg.drawn for leg in legs)
        report = PathReport(Outcome.FOUND, motion, planner=used, complete=complete)
        if best:
            return report, final
        report, all_sought = self._quicker(query, whole, report, deadline)
        return report, final and all_sought

    def _find(
        self, query: PathQuery, deadline: Deadline, most: int | None = None
    ) -> tuple[str, list[Leg]] | PathReport:
        """Return the legs of a query, and who planned the last one, or why there are none. At
        ``most`` so many planners are asked for each.
        """
        legs, used = [], ""
        for start, goal in itertools.pairwise(query.poses):
            if same_pose(start, goal):
                continue
            asked = LegQuery(query.body, start, goal, query.obstacles)
            found = self.legs.find(asked, deadline, most=most)
            if isinstance(found, PathReport):
                return found
            used, leg = found
            legs.append(leg)
        return used, legs

    def _quicker(
        self, query: PathQuery, whole: Trajectory, slow: PathReport, deadline: Deadline
    ) -> tuple[PathReport, bool]:
        """Return the quickest of a way that zones, or a limit backwards, slow (``whole`` would be
        its motion without them), one without a stretch backwards, one along the lanes that it
        prefers, and these around some of the zones, and whether all of them were sought to the end;
        what zones cost, and what is driven beside such lanes, is counted.

        It may not be the fastest that there is: what comes of it is never called complete.
        """
        others = []
        if reverses_at_a_cost(whole, query.body):
            ahead = replace(query.body, kinematics=replace(query.body.kinematics, reverse=False))
            others.append(replace(query, body=ahead))
        if query.body.kinematics.lanes:
            head = before_docking(query.body, query.poses)
            along = along_lanes(query.body, head, self.bounds.length)
            others.append(replace(query, poses=(*along, *query.poses[len(head) :])))
        best, final = self._around_zones(query, query, (slow, whole), deadline)
        for other in others:
            found, sought = self._slowed_way(query, other, deadline)
            final &= sought
            if found is not None:
                quick, sought = self._around_zones(query, other, found, deadline)
                best, final = min(best, quick, key=lambda r: _seconds(r, query)), final and sought
        return best, final

    def _around_zones(
        self,
        query: PathQuery,
        other: PathQuery,
        found: tuple[PathReport, Trajectory],
        deadline: Deadline,
    ) -> tuple[PathReport, bool]:
        """Return the quickest answer to ``query`` by the way of another one (``found``: as it is,
        with its motion if there were no zones) that goes round zones which slow it, all of them or
        one after the other as long as it gets quicker, and whether all were sought to the end.
        """
        (best, whole), final = found, True
        zones = slowing_zones(whole, query.body)
        tried: set[tuple[TrafficZone, ...]] = {()}
        while rest := [some for some in (zones, *((z,) for z in zones)) if some not in tried]:
            tried.add(rest[0])
            around = replace(other, obstacles=(*other.obstacles, *map(as_obstacle, rest[0])))
            way, sought = self._slowed_way(query, around, deadline)
            final &= sought
            if way is not None and _seconds(way[0], query) < _seconds(best, query):
                (best, whole), other = way, around
                zones = slowing_zones(whole, query.body)
        return best, final

    def _slowed_way(
        self, query: PathQuery, other: PathQuery, deadline: Deadline
    ) -> tuple[tuple[PathReport, Trajectory] | None, bool]:
        """Return the answer to ``query`` by the way of another one, with its motion without limits
        that hang on places (None: there is none), and whether it was sought to the end. There is a
        way already: a second opinion on another one is not asked for.
        """
        found = self._find(other, deadline, most=1)
        if isinstance(found, PathReport):
            return None, found.outcome is not Outcome.OUT_OF_TIME
        used, legs = found
        told = replace(query, poses=other.poses)
        whole, _ = strung_at_full_speed(self.scene, told, legs)
        report = PathReport(Outcome.FOUND, strung(self.scene, told, legs)[0], planner=used)
        return (report, whole), all(leg.complete for leg in legs)

    def lower_bound(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed] = ()
    ) -> float:
        """Return seconds that no motion through ``poses`` can beat, stopping there or not."""
        return self.bounds.through(body, poses, surely_met(body, obstacles))

    def least_after(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> float:
        """Return seconds that no motion through ``poses`` beats from when the obstacles, which it
        cannot pass, go away.
        """
        if body.flies or not self.proofs:
            return 0.0
        return self.bounds.after(body, poses, surely_met(body, obstacles))

    def certificate(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> PathReport | None:
        """Return a proof that the motion is impossible, with blockers, or None."""
        if body.flies or not self.proofs:
            return None
        there = () if stays(poses) else surely_met(body, obstacles)
        return self.certifier.prove(body, poses, there)

    def in_order(self, placed: Sequence[Placed], obstacles: Sequence[Placed]) -> Apart | None:
        """Return what tells where two that drive surely never are together (None: nothing does)."""
        if not self.proofs or any(one.body.flies for one in placed):
            return None
        lowest = min((one.body for one in placed), key=lambda body: body.height)
        return self.certifier.in_order(placed, met_by(lowest, obstacles))

    def pose_blockers(
        self, body: Body, pose: Configuration, obstacles: Sequence[Placed]
    ) -> tuple[bool, frozenset[str]]:
        """Return whether a body at a pose overlaps the map, and the obstacles that it overlaps."""
        hit = {p.name for p in obstacles if self.overlap(body, pose, p.body, p.pose)}
        if body.flies:
            return self.grid is not None and meets_walls(self.grid, body, pose), frozenset(hit)
        return self.certifier.hits_map(body, pose), frozenset(hit)

    def overlap(
        self, body_a: Body, pose_a: Configuration, body_b: Body, pose_b: Configuration
    ) -> bool:
        """Return whether two placed bodies share area, or in space, volume (two flyers: or
        touch).
        """
        if body_a.flies and body_b.flies:
            return bodies_meet(body_a, pose_a, body_b, pose_b)
        if body_a.flies:
            return self.overlap(body_b, pose_b, body_a, pose_a)
        if body_b.flies:
            parts = met_by(body_a, (Placed("", body_b, pose_b),))
            return any(self.overlap(body_a, pose_a, p.body, p.pose) for p in parts)
        # either may be the one that moves, and has to be clear by its core
        return self.scene.overlap(core_of(body_a), pose_a, body_b, pose_b) and self.scene.overlap(
            body_a, pose_a, core_of(body_b), pose_b
        )

    def coordinate(
        self,
        query: GroupQuery,
        deadline: Deadline,
        *,
        seed: int | None = None,
        anytime: bool = False,
    ) -> GroupReport:
        """Find motions for a group that may meet (``seed``: the service's own by default);
        ``anytime``: better ones as long as there is time.
        """
        from up_samp.motion.fleet import coordinate

        seed = self.seed if seed is None else seed
        return coordinate(self, query, deadline, seed=seed, anytime=anytime)


def _seconds(found: PathReport, query: PathQuery) -> float:
    """Return what a motion takes, with what zones cost."""
    assert found.trajectory is not None
    return seconds_of(found.trajectory, query.body)
