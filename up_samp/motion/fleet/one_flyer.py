"""One flyer among flights that are decided: its best path when it meets nobody there, a detour."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from up_samp.model import (
    Configuration,
    Deadline,
    FixedMotion,
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
from up_samp.motion.fleet.workspace import PathPlanner
from up_samp.motion.tuning import FlightsTuning


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


def resting(rest: Rest) -> Flight:
    """Return what rests as a flight that never moves."""
    where = Trajectory(np.zeros(1), np.array([rest.pose], dtype=np.float64))
    return Flight(rest.name, rest.name, rest.body, where, rest.since, rest.until)
