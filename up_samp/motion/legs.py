"""Legs from the cache or from planners, asked one after the other, with proofs in between; legs
strung together to one motion; and the last stretch to a dock.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.kernels import first_hit, samples_free
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import WorldData, open_plane
from up_samp.geometry.shapes import shape_of
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Kinematics,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    TrafficZone,
    Trajectory,
    UnsupportedError,
)
from up_samp.model.arrays import BoolArray, FloatArray
from up_samp.motion.curves.blending import TINY, glide_through
from up_samp.motion.curves.rolling import rolled, thinned
from up_samp.motion.curves.slowing import last_stay, slowed, with_ramps
from up_samp.motion.curves.trajectories import at_rest, joined, rotations, twists
from up_samp.motion.curves.trapezoid import time_of_distance, timed_chain
from up_samp.motion.guides import MARGIN_SHARES
from up_samp.motion.proofs.certificates import Certifier
from up_samp.motion.protocol import (
    CachedLeg,
    Leg,
    LegQuery,
    MotionCache,
    MotionPlanner,
    PairKey,
    body_key,
    obstacle_key,
)
from up_samp.motion.registry import PLANNERS, make_planner, planner_names

NOISE = 1e-6
"""By how much positions (m) may be off."""


def _in_plane(body: Body) -> bool:
    """Return whether a body moves in the plane by no law of its own: obstacles count by sweeps."""
    return not (body.flies or body.mobility.own_law)


# ------------------ Legs strung together to one motion


def strung(scene: Scene, query: PathQuery, legs: Sequence[Leg]) -> tuple[Trajectory, bool]:
    """Return the motion along all ``legs`` of a query, from time 0, and whether it stops between
    them only where it has to.

    A car stops where its direction changes, and what turns on the spot where it turns; bodies that
    can turn their velocity should stop only to turn back, and with their own law of motion nobody
    knows; who is slowed by zones, backwards, or in bends might take another way. Raises
    :class:`UnsupportedError` where a planner drives back what must not.
    """
    whole, smooth = strung_at_full_speed(scene, query, legs)
    slow = slowed(whole, query.body)
    return slow, smooth and slow is whole and not query.body.kinematics.heeds_turns


def check_ways(body: Body, motion: Trajectory, planner: str) -> None:
    """Raise where a planner from outside breaks a rule of zones."""
    world = Scene(None).world(shape_of(body))
    if samples_free(world, motion.poses.copy(), 1e-4) >= 0:
        raise UnsupportedError(
            f"the motion planner '{planner}' drives against a zone's direction, or turns on the "
            "spot in a zone: it has to look at 'kinematics.ways' of the bodies that it plans for"
        )


def strung_at_full_speed(
    scene: Scene, query: PathQuery, legs: Sequence[Leg]
) -> tuple[Trajectory, bool]:
    """Return :func:`strung` without the limits of speed that hang on places and directions."""
    whole, smooth = _strung(scene, query, legs)
    if not query.body.kinematics.reverse and np.any(twists(whole.poses)[:, 0] < -NOISE):
        raise UnsupportedError(
            "a motion planner from outside drives a body backwards that may not ('reverse': False):"
            " it has to look at 'kinematics.reverse' of the bodies that it plans for"
        )
    return whole, smooth


def _strung(scene: Scene, query: PathQuery, legs: Sequence[Leg]) -> tuple[Trajectory, bool]:
    kinematics = query.body.kinematics
    parts = [leg.trajectory for leg in legs if leg.trajectory is not None]
    if len(parts) < 2:
        return (parts[0] if parts else at_rest(query.poses[0])), True
    if kinematics.mobility.steers or kinematics.mobility.rolls:
        return driven_through(parts, kinematics), True
    if kinematics.mobility.flies:
        return flown_through(parts, kinematics)
    whole = joined(parts)
    if kinematics.mobility.sideways and not is_docking(query.body, *query.poses[-2:]):
        ways = [leg.corners for leg in legs if leg.corners is not None]
        if len(ways) == len(legs):
            gliding = glide_through(scene, query.body, query.poses, ways, query.obstacles)
            if gliding is not None and gliding[0].duration <= whole.duration + TINY:
                return gliding
    return whole, False


_LAZY_ROUNDS = 3
"""Of planning around the objects in the way before all of them count."""
_QUICK_EFFORT = {
    True: {"car": 20_000, "planar": 20_000},
    False: {"car": 20_000, "pivot": 2_000},
}
"""Expansions without a motion, after which a proof over positions and headings is tried; by whether
a body may drive backwards (who may, and turns on the spot, is hardly ever trapped), and planner."""
SECOND_OPINION = 2.0
"""s: for each planner that is asked after another one found nothing."""
_MORE_TIME = 1.2
"""A search that was cut short is done again where there is so many times its time."""

Prove = Callable[[Body, Sequence[Configuration], Sequence[Placed]], PathReport | None]


class Legs:
    """Finds legs in one scene, and remembers them. ``planner`` says who plans: see the service."""

    def __init__(
        self,
        scene: Scene,
        planner: str,
        seed: int,
        cache: MotionCache,
        certifier: Certifier,
        prove: Prove,
    ) -> None:
        self.scene = scene
        self.planner, self.seed = planner, seed
        self.cache = cache
        self.certifier = certifier
        self.prove = prove
        self._planners: dict[str, MotionPlanner] = {}
        self._missed: Memory[tuple[PathReport, float]] = Memory(4_000)
        """Why there is no leg, and the seconds in which none was found (inf: that is final)."""

    def find(
        self, query: LegQuery, deadline: Deadline, *, most: int | None = None
    ) -> tuple[str, Leg] | PathReport:
        """Return a leg from the cache or from the first planner that finds one, after that one's
        name, or why there is none.

        :param most: planners that are asked, if not all.
        """
        straight = docking_leg(self.scene, query)
        if straight is not None:
            if straight.trajectory is None:
                return self._not_straight(straight, query)
            return "straight", straight
        names = planner_names(self.planner, query.body)[:most]
        for name in names:
            known = self._usable(name, self._asked(name, query), deadline)
            if known is not None:
                self.cache.hits += 1
                return self._facing(query, name, known)
        listed = tuple(sorted(query.obstacles, key=lambda p: p.name))
        key = replace(query, obstacles=listed), len(names)
        limit = deadline.remaining()
        missed = self._missed.get(key)
        if missed is not None and limit <= _MORE_TIME * missed[1]:
            return missed[0]
        found = self._sought(names, query, deadline)
        if isinstance(found, PathReport):
            over = found.outcome is Outcome.OUT_OF_TIME
            self._missed.put(key, (found, limit if over else math.inf))
            return found
        return self._facing(query, *found)

    def _not_straight(self, leg: Leg, query: LegQuery) -> PathReport:
        """Return why the straight stretch to a dock cannot be driven."""
        alone = docking_leg(self.scene, replace(query, obstacles=()))
        way = None if alone is None else alone.trajectory
        hit = [
            p.name
            for p in query.obstacles
            if way is not None and not self.clears(way, query.body, p)
        ]
        return PathReport(
            Outcome.NOT_FOUND,
            blockers=frozenset(hit),
            reason=leg.reason,
            planner="straight",
            complete=True,
        )

    def _sought(
        self, names: Sequence[str], query: LegQuery, deadline: Deadline
    ) -> tuple[str, Leg] | PathReport:
        """Ask planners one after the other."""
        reasons, complete = [], True
        for name in names:
            # the first planner ends by itself where it can, later ones are second opinions
            limit = 0.75 * deadline.remaining() if len(names) > 1 else None
            if name != names[0]:
                limit = SECOND_OPINION
            asked = self._asked(name, query)
            found = self._lazily(name, asked, deadline.within(limit), complete)
            if isinstance(found, PathReport):
                return found
            if found.trajectory is not None:
                return name, found
            complete = complete and found.complete
            reasons.append(f"{name}: {found.reason}")
            if deadline.expired():
                complete = False
                break
        return PathReport(
            Outcome.NOT_FOUND if complete else Outcome.OUT_OF_TIME,
            blockers=self._in_the_way(query),
            reason="; ".join(reasons),
            planner=names[0],
            complete=complete,
        )

    def _lazily(
        self, name: str, query: LegQuery, deadline: Deadline, complete: bool
    ) -> Leg | PathReport:
        """Plan among the obstacles that prove to matter only (so that more queries share a leg).

        ``complete``: whether those asked before have finished their searches.
        """
        body, obstacles = query.body, query.obstacles
        chosen: tuple[Placed, ...] = () if _in_plane(body) else obstacles
        for attempt in range(_LAZY_ROUNDS + 1):
            if attempt == _LAZY_ROUNDS:
                chosen = obstacles
            part = replace(query, obstacles=chosen)
            leg = self._usable(name, part, deadline)
            if leg is None:
                limit = deadline.remaining()
                answer = self._ask(name, part, deadline)
                if isinstance(answer, PathReport):
                    return answer
                leg = replace(answer, complete=answer.complete and complete)
                if leg.trajectory is None:
                    old = self._known(name, part)
                    if old is None:
                        return leg
                    leg = old.leg
                else:
                    if math.isfinite(body.kinematics.alpha_max):
                        leg = replace(leg, trajectory=self._ramped(part, leg.trajectory))
                    self.remember(name, part, leg, limit)
            assert leg.trajectory is not None
            if chosen == obstacles:
                return leg
            trajectory = leg.trajectory
            hit = [p for p in obstacles if p not in chosen and not self.clears(trajectory, body, p)]
            if not hit:
                return leg
            chosen = tuple(p for p in obstacles if p in chosen or p in hit)
            proof = self.prove(body, (query.start, query.goal), chosen)
            if proof is not None:
                return proof
        raise AssertionError("the last round heeds all obstacles")

    def _ramped(self, query: LegQuery, motion: Trajectory) -> Trajectory:
        """Return a motion with ramps of the curvature where there is room for them: ways often lead
        along corners as near as the margin lets them, and a ramp may come a little nearer.
        """
        shape = self.scene.shape(query.body, MARGIN_SHARES[1] * self.scene.margin)
        world = self.scene.world(shape, query.obstacles)
        return with_ramps(motion, query.body, partial(first_hit, world))

    def _ask(self, name: str, query: LegQuery, deadline: Deadline) -> Leg | PathReport:
        """Ask a planner; where it finds nothing soon, look for a stronger proof in between."""
        planner = self._planner(name)
        effort = _QUICK_EFFORT[query.body.kinematics.reverse].get(name)
        if effort is None or self.scene.grid is None:
            return planner.leg(query, deadline)
        leg = planner.leg(replace(query, effort=effort), deadline)
        if deadline.expired() or (leg.trajectory is not None and leg.complete):
            return leg
        if leg.trajectory is None:
            limit = deadline.within(5.0)  # s, for such a proof
            ends = query.start, query.goal
            proof = self.certifier.prove_slowly(query.body, *ends, query.obstacles, limit)
            if proof is not None or leg.complete:
                return leg if proof is None else proof
        again = planner.leg(query, deadline)
        return leg if again.trajectory is None and leg.trajectory is not None else again

    def remember(self, name: str, query: LegQuery, leg: Leg, limit: float = 0.0) -> None:
        """Put a leg that ``name`` planned into the cache; it had ``limit`` seconds."""
        limit = 0.0 if leg.complete else limit
        self.cache.put(self._key(name, query), CachedLeg(obstacle_key(query.obstacles), leg, limit))

    def _usable(self, name: str, query: LegQuery, deadline: Deadline) -> Leg | None:
        """Return a remembered leg that is not worth another search: its planner finished, or it had
        about as much time as there is now.
        """
        entry = self._known(name, query)
        if entry is None:
            return None
        enough = _MORE_TIME * entry.limit
        return entry.leg if entry.leg.complete or deadline.remaining() <= enough else None

    def _known(self, name: str, query: LegQuery) -> CachedLeg | None:
        """Return a remembered leg that was planned among a part of the obstacles and clears all."""
        body, obstacles = query.body, query.obstacles
        here = obstacle_key(obstacles)
        for entry in self.cache.get(self._key(name, query)):
            if not entry.among <= here:
                continue
            rest = [p for p in obstacles if not obstacle_key([p]) <= entry.among]
            if rest and not _in_plane(body):
                continue
            if all(self.clears(entry.trajectory, body, p) for p in rest):
                return entry
        return None

    def _key(self, name: str, query: LegQuery) -> PairKey:
        """Return the key of a leg."""
        scope = (self.scene.digest, name, self.scene.margin, self.seed)
        a, b = tuple(map(float, query.start)), tuple(map(float, query.goal))
        return (*scope, body_key(query.body), a, b)

    def _asked(self, name: str, query: LegQuery) -> LegQuery:
        """Return the query in the direction in which a planner is always asked, and its legs are
        remembered: what a motion and its reverse last must not depend on which of the two was asked
        for first.
        """
        # OMPL's planners by their own names are never reversible, and need not be loaded to tell
        return query.remembered(reversible=name in PLANNERS and self._planner(name).reversible)

    def _facing(self, query: LegQuery, name: str, leg: Leg) -> tuple[str, Leg]:
        """Return a planner and its leg in the direction of a query."""
        return name, leg if self._asked(name, query) is query else leg.turned(query.start)

    def clears(self, trajectory: Trajectory, body: Body, placed: Placed) -> bool:
        """Return whether a motion keeps the scene's margin from a resting object, all the way."""
        return parking_clears(self.scene, trajectory, body, placed, self.scene.margin)

    def _in_the_way(self, query: LegQuery) -> frozenset[str]:
        """Return the obstacles that the way on the empty map would hit (all, if that is
        unknown).
        """
        body, hit = query.body, query.obstacles
        if _in_plane(body) and hit:
            alone = replace(query, obstacles=())
            names = planner_names(self.planner, body)
            ways = (self._known(name, self._asked(name, alone)) for name in names)
            free = next((way.trajectory for way in ways if way is not None), None)
            if free is not None:
                hit = tuple(p for p in hit if not self.clears(free, body, p))
        return frozenset(p.name for p in hit)

    def _planner(self, name: str) -> MotionPlanner:
        if name not in self._planners:
            self._planners[name] = make_planner(name, self.scene, self.seed)
        return self._planners[name]


def parking_clears(
    scene: Scene, trajectory: Trajectory, body: Body, placed: Placed, clearance: float
) -> bool:
    """Return whether a motion keeps ``clearance`` (m) from a resting object, all the way."""
    shape = shape_of(body, clearance).data
    world = WorldData(open_plane(), scene.polys((placed,)), shape)
    poses = trajectory.poses.copy()  # numba compiles anew for arrays that cannot be written
    return bool(samples_free(world, poses, 1e-4) < 0)


# ------------------ Motions that pass from one leg into the next without a stop where they can
# A waypoint asks for a pose, not for a rest. What drives along its heading drives on where its
# direction does not change, and it need not turn on the spot; a free flyer does where the next
# piece goes on straight, at the same share of turn.


def driven_through(parts: Sequence[Trajectory], kinematics: Kinematics) -> Trajectory:
    """Return the legs of a body that drives along its heading as one motion from time 0 that rests
    where it turns on the spot, or changes its direction, only.
    """
    whole = joined(parts)
    if len(whole.times) < 3:
        return whole
    kept = np.concatenate([[True], _joints(parts), [True]])
    return rolled(thinned(whole.poses, kinematics, kept), kinematics)


def flown_through(parts: Sequence[Trajectory], kinematics: Kinematics) -> tuple[Trajectory, bool]:
    """Return a flyer's legs (straight pieces, at rest at each corner) as one motion from time 0,
    and whether it passes all joints without a stop.
    """
    whole = joined(parts)
    inner = _joints(parts)
    if len(whole.times) < 3:
        return whole, True
    ways = np.linalg.norm(np.diff(whole.poses[:, :3], axis=0), axis=1)
    if not np.all(ways > 1e-12):  # turns on the spot have no share of a way
        return whole, not inner.any()
    rates = rotations(whole.poses) / ways[:, None]
    units = np.diff(whole.poses[:, :3], axis=0) / ways[:, None]
    change = np.abs(np.diff(np.hstack([units, rates]), axis=0)).max(axis=1)
    corners = np.flatnonzero(change > 1e-7) + 1
    top = np.linalg.norm(rates, axis=1)

    marks = [0, *corners.tolist(), len(ways)]
    times = np.zeros(len(ways) + 1)
    for low, high in itertools.pairwise(marks):  # one trapezoid from each rest to the next
        s, turning = np.cumsum(ways[low:high]), float(top[low])
        fastest = kinematics.omega_max / turning if turning > 1e-12 else np.inf
        v = min(kinematics.v_max, fastest)
        times[low + 1 : high + 1] = times[low] + time_of_distance(
            s, float(s[-1]), v, kinematics.a_max
        )
    # where it rested before, samples now are far closer than they need be; ways may be nothing
    stay = [0]
    for i in range(1, len(times) - 1):
        asked = inner[i - 1] or i in marks or times[i + 1] - times[stay[-1]] > Trajectory.MAX_STEP
        if asked and times[stay[-1]] < times[i] < times[-1]:
            stay.append(i)
    stay.append(len(times) - 1)
    motion = Trajectory(times[stay], whole.poses[stay].copy())
    return motion, not inner[corners - 1].any()


def _joints(parts: Sequence[Trajectory]) -> BoolArray:
    """Return which inner samples of the joined motion are ends of a leg, shape (n - 2,)."""
    counts = [len(part.times) - 1 for part in parts]
    ends = np.cumsum(counts)[:-1]
    marks = np.zeros(sum(counts) + 1, dtype=np.bool_)
    marks[ends] = True
    return marks[1:-1]


# ------------------ The last stretch to a dock
# Straight, along the dock's heading, as a zone with a dock asks.


def dock_of(body: Body, goal: Configuration) -> TrafficZone | None:
    """Return the zone that tells how a body comes to a pose, if there is one."""
    if body.flies:
        return None
    return next((z for z in body.kinematics.zones if z.dock and z.binds(goal)), None)


def is_docking(body: Body, start: Configuration, goal: Configuration) -> bool:
    """Return whether a leg is the straight stretch to a dock, or a part of it."""
    zone = dock_of(body, goal)
    return zone is not None and zone.leads_in(start)


def before_docking(body: Body, poses: tuple[Configuration, ...]) -> tuple[Configuration, ...]:
    """Return the poses that a body may go between as it likes: all but a dock that it comes to
    straight, from the last one before.
    """
    return poses[:-1] if is_docking(body, *poses[-2:]) else poses


def docking_leg(scene: Scene, query: LegQuery) -> Leg | None:
    """Return the straight stretch to a dock (None: the leg of ``query`` is none), as fast as the
    body is elsewhere, or why it cannot be driven.
    """
    zone = dock_of(query.body, query.goal)
    if zone is None or not zone.leads_in(query.start):
        return None
    if not query.body.kinematics.reverse and zone.off_dock(query.start)[0] > 0.0:
        return Leg(None, "it comes to its dock backwards, which it may not", complete=True)
    end = query.start[2] + math.remainder(query.goal[2] - query.start[2], math.tau)
    rows = np.array([query.start, (*query.goal[:2], end)], dtype=np.float64)
    motion = timed_chain(rows, query.body.kinematics)
    for share in MARGIN_SHARES:  # there is no other way: as wide as this one allows
        world = scene.world(scene.shape(query.body, scene.margin * share), query.obstacles)
        if first_hit(world, motion.poses.copy()) < 0:
            return Leg(motion, complete=True, corners=rows)
    return Leg(None, "something stands where it comes straight to its dock", complete=True)


def comes_straight(poses: FloatArray, body: Body) -> bool:
    """Return whether a way (n, 3) comes straight to where it ends, if that is a dock: from where
    its reference point last comes into the dock's zone.
    """
    zone = dock_of(body, tuple(poses[-1].tolist()))
    if zone is None:
        return True
    since = last_stay(zone, poses)
    if since:  # where it comes in, as far as samples tell
        step = math.dist(poses[since - 1, :2], poses[since, :2])
        if zone.long - abs(zone.off_dock(poses[since])[0]) > step:
            return False
    return all(zone.leads_in(pose) for pose in poses[since:])
