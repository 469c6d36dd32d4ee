"""Free flyers (SE3), one after the other, among bodies that fly or drive below them."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import shapely

from up_samp.geometry.meshes import (
    Mesh,
    load_mesh,
    mesh_of,
    nested,
    rotation,
    surface_distance,
    transform,
)
from up_samp.geometry.shadows import on_the_floor
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    FixedMotion,
    GroupQuery,
    GroupReport,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    Rest,
    TimedMotion,
    Trajectory,
    avoids,
)
from up_samp.motion.fleet.conflicts import CLEARANCES, eased, wished
from up_samp.motion.fleet.paths import TIMES
from up_samp.motion.fleet.workspace import PathPlanner, fleet_tuning
from up_samp.motion.tuning import FlightsTuning

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

    def avoids(self, other: Flight) -> bool:
        """Return whether it has to keep clear of ``other`` while it is busy."""
        return self.busy is not None and avoids(self.avoid, other.object)


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
    spans = [x.busy for x, y in ((a, b), (b, a)) if x.busy is not None and x.avoids(y)]
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


# ------------------ Flyers as bodies that drive below them meet them
# Flyers as bodies that drive below them meet them: moving shadows on the floor. While all of a
# flyer is above the drivers it is no obstacle to them. While some of it is not, it counts as the
# hull of all of it, in every orientation that it has in that while: more than it is, which proves
# nothing and is never told as a proof.


SLACK = 0.02
"""How much (m) a flyer may be lower, or reach further, between two samples than at both."""


def among_shadows(query: GroupQuery) -> GroupQuery:
    """Return a query of drivers in which flyers that rest, or are decided, are shadows."""
    bodies = [*(r.body for r in query.rests), *(m.body for m in query.fixed)]
    if not any(body.flies for body in bodies):
        return query
    height = max(motion.body.height for motion in query.motions)
    rests, fixed = flat(query.rests, query.fixed, height)
    return GroupQuery(query.motions, rests, fixed)


def flat(
    rests: Sequence[Rest], fixed: Sequence[FixedMotion], height: float
) -> tuple[tuple[Rest, ...], tuple[FixedMotion, ...]]:
    """Return what rests and what is decided as drivers of a ``height`` (m) meet it."""
    still = [r for rest in rests for r in _resting(rest, height)]
    moving: list[FixedMotion] = []
    for motion in fixed:
        if not motion.body.flies:
            moving.append(motion)
            continue
        first, last = (tuple(map(float, motion.trajectory.poses[i])) for i in (0, -1))
        begin, end = motion.trajectory.start, motion.trajectory.end
        before = Rest(motion.object, motion.body, first, motion.present_from, begin)
        after = Rest(motion.object, motion.body, last, end, motion.present_until)
        still += [r for rest in (before, after) for r in _resting(rest, height)]
        moving += _low(motion, height)
    return tuple(still), tuple(moving)


def _resting(rest: Rest, height: float) -> Iterator[Rest]:
    if rest.since >= rest.until:
        return
    for part in on_the_floor([Placed(rest.name, rest.body, rest.pose)], height):
        yield Rest(rest.name, part.body, part.pose, rest.since, rest.until)


def _low(motion: FixedMotion, height: float) -> Iterator[FixedMotion]:
    """Yield the stretches in which a flight is not above ``height``, as motions of discs."""
    assert motion.body.mesh is not None
    vertices = load_mesh(motion.body.mesh).vertices
    times, poses = motion.trajectory.times, motion.trajectory.poses
    turned = [vertices @ rotation(pose[3:]).T for pose in poses]
    lowest = np.array([t[:, 2].min() for t in turned]) + poses[:, 2] - SLACK
    low = np.minimum(lowest[:-1], lowest[1:]) < height  # by piece between two samples
    edges = np.flatnonzero(np.diff(np.concatenate(([False], low, [False])).astype(np.int8)))
    for i, j in edges.reshape(-1, 2):
        kept = slice(int(i), int(j) + 1)
        body = _hull([t[:, :2] for t in turned[kept]], motion.body.kinematics)
        flat_poses = np.column_stack((poses[kept, :2], np.zeros(j + 1 - i)))
        path = Trajectory(times[kept].copy(), flat_poses)
        yield FixedMotion(
            motion.name, motion.object, body, path, float(times[i]), float(times[int(j)])
        )


def _hull(points: Sequence[FloatArray], limits: Kinematics) -> Body:
    """Return a planar body that holds all ``points`` about its own middle, and a little more."""
    around = shapely.convex_hull(shapely.MultiPoint(np.concatenate(points)))
    ring = shapely.get_coordinates(around.buffer(SLACK, quad_segs=2).exterior)[:-1]
    kinematics = Kinematics(
        MotionModel.SE2, v_max=limits.v_max, a_max=limits.a_max, omega_max=limits.omega_max
    )
    return Body(tuple(map(tuple, ring.tolist())), kinematics)


# ------------------ One flyer among flights that are decided
# One flyer among flights that are decided: its best path when it meets nobody there, a detour.


@dataclass
class PrioritisedFlyers:
    """A group of flyers, what rests and what is decided."""

    service: PathPlanner
    tuning: FlightsTuning
    motions: dict[str, TimedMotion]
    rests: Sequence[Rest]
    world: list[Flight]
    deadline: Deadline
    met: dict[str, set[str]] = field(default_factory=dict)
    """By motion: whom it would have met, had it left at once."""
    virtual: dict[str, list[Placed]] = field(default_factory=dict)
    """By motion: copies of others where it would have met them."""
    report: PathReport | None = None
    """Why a motion has no path, the last time that happened."""
    complete: bool = True
    """Whether no path's search was cut short."""

    @property
    def margin(self) -> float:
        """The clearance (m) to keep between two bodies."""
        return wished(getattr(self.service, "scene", None))

    def plan(self, query: PathQuery) -> PathReport:
        """Ask the service for a path."""
        report = self.service.plan(query, self.deadline)
        cut = not report.complete and report.outcome in (Outcome.FOUND, Outcome.OUT_OF_TIME)
        self.complete = self.complete and not cut
        return report

    def paths(self, motion: TimedMotion, wide: bool, release: float) -> Iterator[Trajectory]:
        """Yield paths of a motion: among what rests all the time, then among all that ever rests
        in its window; ``wide``: also among the places where other flyers start and end.
        """
        due, ever = max(motion.due, release), self._rests(motion, release)
        always = [r for r in ever if r.since <= motion.release and r.until >= due]
        ends = []
        if wide:
            for other in self.motions.values():
                if other.object != motion.object and avoids(motion.avoid, other.object):
                    ends += [Placed(other.object, other.body, p) for p in _ends(other)]
        tried = []
        for chosen in (always, ever):
            obstacles = tuple([Placed(r.name, r.body, r.pose) for r in chosen] + ends)
            if obstacles in tried:
                continue
            tried.append(obstacles)
            query = PathQuery(motion.body, motion.poses, obstacles)
            report = self.plan(query)
            if report.trajectory is None:
                self.report = report
            else:
                yield report.trajectory

    def _rests(self, motion: TimedMotion, release: float) -> list[Rest]:
        """Return what rests at some time of a motion's window."""
        due = max(motion.due, release)
        rests = [r for r in self.rests if avoids(motion.avoid, r.name)]
        return [r for r in rests if r.since < due and r.until > motion.release]

    def fly(
        self, name: str, flights: Mapping[str, Flight], wide: bool, waiting: Iterable[str]
    ) -> Flight | None:
        """Return a motion's flight with the earliest arrival that is found among ``flights``, while
        those ``waiting`` are at their starts until they may leave.
        """
        motion = self.motions[name]
        before = [f.trajectory.end for f in flights.values() if f.object == motion.object]
        release = max([motion.release, *before])
        since = max([motion.present_from, *before]) if before else motion.present_from
        others = [*self.world, *flights.values()]
        for other in waiting:
            later = self.motions[other]
            if later.object != motion.object and later.present_from < later.release:
                others.append(
                    resting(Rest(later.object, later.body, later.poses[0], later.present_from,
                                 later.release))
                )  # fmt: skip
        window = (min(since, release), release)
        best: Flight | None = None
        for path in self.paths(motion, wide, release):
            best = self._better(best, self._earliest(motion, path, window, others))
            for _ in range(self.tuning.detours):
                if self._good(best):
                    return best
                detour = self._detour(motion, path, window, others)
                if detour is None:
                    break
                path = detour
                best = self._better(best, self._earliest(motion, path, window, others))
        return best

    def _good(self, flight: Flight | None) -> bool:
        if flight is None:
            return False
        return flight.trajectory.end <= self.motions[flight.name].due + TIMES.on_time

    @staticmethod
    def _better(best: Flight | None, other: Flight | None) -> Flight | None:
        if best is None or (other is not None and other.trajectory.end < best.trajectory.end):
            return other
        return best

    def _detour(
        self,
        motion: TimedMotion,
        path: Trajectory,
        window: tuple[float, float],
        others: Sequence[Flight],
    ) -> Trajectory | None:
        """Return a path around the places at which the last ``path`` would meet somebody."""
        flight = flight_of(motion, path, *window)
        virtual = self.virtual.setdefault(motion.name, [])
        before = len(virtual)
        for other in others:
            at = first_contact(flight, other, self.margin)
            if at < math.inf and len(other.trajectory.times) > 1:
                virtual += self._copies(flight, other, at)
        if len(virtual) == before or self.deadline.expired():
            return None
        ever = self._rests(motion, window[1])
        obstacles = (*(Placed(r.name, r.body, r.pose) for r in ever), *virtual)
        query = PathQuery(motion.body, motion.poses, obstacles)
        return self.plan(query).trajectory

    def _copies(self, flight: Flight, other: Flight, at: float) -> list[Placed]:
        """Return copies of ``other`` where it is while ``flight`` is near it about the time ``at``,
        but for those that stand where the flight starts or ends.
        """
        reach = flight.reach + other.reach
        speed = max(float(flight.travel[-1]) / max(flight.trajectory.duration, 1e-3), 1e-3)
        apart = self.tuning.copies * other.reach
        span = 2 * reach / speed + 1.0
        found: list[Placed] = []
        for t in np.arange(at - span, at + span, 0.25 * other.reach / speed):
            pose = other.trajectory.at(float(t))
            here = in_space(pose)
            if found and math.dist(here[:3], in_space(found[-1].pose)[:3]) < apart:
                continue
            room = 2 * self.margin
            if all(gap(flight, end, other, here, room) > room for end in flight.ends):
                found.append(Placed(f"{other.object}~{len(found)}", other.body, pose))
        return found

    def _earliest(
        self,
        motion: TimedMotion,
        path: Trajectory,
        window: tuple[float, float],
        others: Sequence[Flight],
    ) -> Flight | None:
        """Return the flight on ``path`` that leaves as early as it can (None: it never can)."""
        since, release = window
        ends = [f.trajectory.end for f in others]
        ends += [t for f in others for t in (f.since, f.until) if math.isfinite(t)]
        last = max([release, *ends]) + self.tuning.step
        start = release
        while not self.deadline.expired():
            flight = flight_of(motion, path, since, start)
            hit = next(
                (o for o in others if first_contact(flight, o, self.margin) < math.inf), None
            )
            if hit is None:
                return flight
            self.met.setdefault(motion.name, set()).add(hit.name)
            if start >= last:
                return None
            start = min(last, start + max(self.tuning.step, 0.1 * (start - release)))
        return None


def flight_of(motion: TimedMotion, path: Trajectory, since: float, start: float) -> Flight:
    """Return a motion on ``path`` that is there from ``since`` and leaves at ``start`` (s)."""
    arrival = start + path.duration
    return Flight(
        motion.name,
        motion.object,
        motion.body,
        path.shifted(start),
        since,
        max(motion.present_until, arrival),
        (motion.release, max(motion.due, arrival)),
        motion.avoid,
    )


def _ends(motion: TimedMotion) -> tuple[Configuration, Configuration]:
    return motion.poses[0], motion.poses[-1]


def decided(motion: FixedMotion) -> Flight:
    """Return what is decided as a flight that keeps clear of everything."""
    busy = (motion.trajectory.start, motion.trajectory.end)
    since, until = motion.present_from, motion.present_until
    return Flight(
        motion.name, motion.object, motion.body, motion.trajectory, since, until, busy
    )  # fmt: skip


def resting(rest: Rest) -> Flight:
    """Return what rests as a flight that never moves."""
    where = Trajectory(np.zeros(1), np.array([rest.pose], dtype=np.float64))
    return Flight(rest.name, rest.name, rest.body, where, rest.since, rest.until)


# ------------------ Several free flyers
# Several free flyers (SE3) at once: one after the other, each as early as those before it allow.
# Prioritised planning (Erdmann & Lozano-Perez 1987): every flyer takes its planner's best path
# among what rests and leaves when it meets nobody on it, or a path around where it would meet
# somebody. Other orders, and paths that keep out of the places where the others start and end,
# are tried where somebody is late. Nobody steps aside for another: finding nothing proves
# nothing.
#
# Bodies that drive in the plane among them are decided already: groups of both kinds are planned
# by ``up_samp.motion.fleet.coordination``.


def coordinate_flights(service: PathPlanner, query: GroupQuery, deadline: Deadline) -> GroupReport:
    """Find flights for all motions of ``query`` (free flyers): clear of each other, of what rests
    and of what is decided; late if there is no other way found. Deterministic, but for the
    deadline.
    """
    began = time.monotonic()
    world = [*map(resting, query.rests), *map(decided, query.fixed)]
    motions = {m.name: m for m in query.motions}
    tuning = fleet_tuning(service).flights
    space = PrioritisedFlyers(service, tuning, motions, query.rests, world, deadline)
    best: dict[str, Flight] | None = None
    least, stuck = math.inf, ""
    for wide, order in itertools.product((False, True), _orders(motions, tuning.orders)):
        if deadline.expired() or least <= TIMES.on_time or (wide and len(motions) < 2):
            break
        flights, failed = _one_by_one(space, order, wide)
        late = sum(max(0.0, f.trajectory.end - motions[n].due) for n, f in flights.items())
        if failed:
            stuck = failed
        elif late < least - TIMES.on_time:
            best, least = flights, late
    seconds = time.monotonic() - began
    complete = space.complete and not deadline.expired()
    if best is None:
        return replace(_nothing(space, stuck, seconds), complete=complete)
    return replace(_found(space, best, seconds), complete=complete)


def _orders(motions: Mapping[str, TimedMotion], most: int) -> Iterator[tuple[str, ...]]:
    """Yield so many orders of priority at most, by release first; one object's motions stay in
    order.
    """
    first = sorted(motions, key=lambda n: (motions[n].release, motions[n].due, n))
    rank = {name: i for i, name in enumerate(first)}

    def fits(order: Sequence[str]) -> bool:
        return all(
            rank[a] < rank[b]
            for a, b in itertools.combinations(order, 2)
            if motions[a].object == motions[b].object
        )

    some = itertools.islice(itertools.permutations(first), 20 * most)
    yield from itertools.islice(filter(fits, some), most)


def _one_by_one(
    space: PrioritisedFlyers, order: Sequence[str], wide: bool
) -> tuple[dict[str, Flight], str]:
    """Return the flights of an order, and who has none (then the others are incomplete)."""
    flights: dict[str, Flight] = {}
    space.virtual.clear()
    for index, name in enumerate(order):
        flight = space.fly(name, flights, wide, order[index + 1 :])
        if flight is None:
            return flights, name
        for other, known in flights.items():
            if known.object == flight.object and flight.trajectory.start > known.trajectory.end:
                # it rests where it arrived until it flies on
                flights[other] = replace(known, until=min(known.until, flight.trajectory.start))
        flights[name] = flight
    return flights, ""


def _nothing(space: PrioritisedFlyers, stuck: str, seconds: float) -> GroupReport:
    conflict = {stuck, *(space.met.get(stuck, set()) & set(space.motions))} - {""}
    why = space.report.reason if space.report is not None else "it would always meet somebody"
    return GroupReport(
        Outcome.OUT_OF_TIME if space.deadline.expired() else Outcome.NOT_FOUND,
        conflict=frozenset(conflict or space.motions),
        blockers=frozenset(r.name for r in space.rests),
        reason=f"{stuck}: {why}" if stuck else "out of time",
        seconds=seconds,
    )


def _found(space: PrioritisedFlyers, flights: Mapping[str, Flight], seconds: float) -> GroupReport:
    ends = {name: flights[name].trajectory.end for name in sorted(flights)}
    late = {n: end for n, end in ends.items() if end > space.motions[n].due + TIMES.on_time}
    met = set().union(*(space.met.get(n, set()) for n in late), late)
    return GroupReport(
        Outcome.FOUND,
        {name: flights[name].trajectory for name in sorted(flights)},
        late,
        frozenset(met & set(space.motions)) if late else frozenset(),
        frozenset(r.name for r in space.rests) if late else frozenset(),
        f"late: {', '.join(late)}" if late else "",
        seconds,
    )


def earliest_flight(
    service: PathPlanner,
    motion: TimedMotion,
    rests: Sequence[Rest],
    fixed: Sequence[FixedMotion],
    deadline: Deadline,
) -> PathReport:
    """Return the earliest found arrival of one flyer (in plan time; perhaps after its due)."""
    began = time.monotonic()
    report = coordinate_flights(
        service, GroupQuery((motion,), tuple(rests), tuple(fixed)), deadline
    )
    return PathReport(
        report.outcome,
        report.trajectories.get(motion.name),
        report.blockers,
        reason=report.reason,
        planner="flights",
        seconds=time.monotonic() - began,
        complete=report.complete,
    )
