"""Several free flyers (SE3) at once: one after the other, each as early as those before it allow.

Prioritised planning (Erdmann & Lozano-Perez 1987): every flyer takes its planner's best path among
what rests and leaves when it meets nobody on it, or a path around where it would meet somebody.
Other orders, and paths that keep out of the places where the others start and end, are tried where
somebody is late. Nobody steps aside for another: finding nothing proves nothing.

Bodies that drive in the plane among them are decided already: groups of both kinds are planned by
:mod:`up_samp.motion.fleet.mixed`.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from up_samp.model import (
    Configuration,
    Deadline,
    FixedMotion,
    GroupQuery,
    GroupReport,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.fleet.cell_times import TIMES
from up_samp.motion.fleet.flyer_contacts import Flight, first_contact, gap, in_space
from up_samp.motion.fleet.margins import wished
from up_samp.motion.fleet.workspace import PathPlanner, fleet_tuning
from up_samp.motion.tuning import FlightsTuning

FloatArray = npt.NDArray[np.float64]


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
                if other.object != motion.object and _names(motion, other.object):
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
        rests = [r for r in self.rests if _names(motion, r.name)]
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
            if all(gap(flight, end, other, here) > 2 * self.margin for end in flight.ends):
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


def _names(motion: TimedMotion, name: str) -> bool:
    return motion.avoid is None or name in motion.avoid


def _ends(motion: TimedMotion) -> tuple[Configuration, Configuration]:
    return motion.poses[0], motion.poses[-1]


def decided(motion: FixedMotion) -> Flight:
    """Return what is decided as a flight that keeps clear of everything."""
    busy = (motion.trajectory.start, motion.trajectory.end)
    since, until = motion.present_from, motion.present_until
    return Flight(
        motion.name, motion.object, motion.body, motion.trajectory, since, until, busy
    )  # fmt: skip


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


def resting(rest: Rest) -> Flight:
    """Return what rests as a flight that never moves."""
    where = Trajectory(np.zeros(1), np.array([rest.pose], dtype=np.float64))
    return Flight(rest.name, rest.name, rest.body, where, rest.since, rest.until)
