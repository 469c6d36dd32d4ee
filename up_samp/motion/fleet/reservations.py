"""Motions that are decided one after the other, each among those decided before.

Whoever has made its last decided motion stays where that ended, until it is given another one: so
a motion is only taken if it can end where nobody who is decided comes by later (the invariant of
token passing; Ma et al., "Lifelong multi-agent path finding for online pickup and delivery tasks",
AAMAS 2017). Thus nobody ever has to move on in a hurry, and the decided motions are valid at every
step.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from up_samp.model import Body, Configuration, Deadline, Placed, Rest, TimedMotion, avoids
from up_samp.model.arrays import FloatArray
from up_samp.motion.fleet.one_robot import (
    Attempt,
    Stand,
    is_good,
    plan_one,
    virtual_obstacles,
    ways_past,
)
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.space_time import proposer_of
from up_samp.motion.fleet.speed import fit
from up_samp.motion.fleet.timed_path import TimedPath, pair_flags
from up_samp.motion.fleet.workspace import KnownPaths, PathPlanner, rest_run, workspace_of


class ReservationTable:
    """The decided runs of all objects on one floor.

    :param service: plans single paths.
    :param rests: everything that is there, where it is at first (or always).
    """

    def __init__(self, service: PathPlanner, rests: Iterable[Rest]) -> None:
        self._workspace = workspace_of(service)
        self._first = {rest.name: rest_run(self._workspace, rest) for rest in rests}
        self._runs: dict[str, list[TimedPath]] = {}
        self._placed: list[TimedPath] = []

    def arrival(self, name: str) -> float:
        """Return when an object's last decided motion ends (s)."""
        runs = self._runs.get(name)
        return runs[-1].arrival if runs else -math.inf

    def place(self, rests: Sequence[Rest]) -> None:
        """Let things that others move (doors) rest so for what is decided next."""
        self._placed = [rest_run(self._workspace, rest) for rest in rests]

    def plan(self, motion: TimedMotion, deadline: Deadline) -> Attempt:
        """Return a run of a motion among what is decided: on time, or else the earliest found."""
        others = self._others({motion.object}, motion.release)
        return plan_one(self._workspace, self._after_last(motion), others, deadline)

    def alone(self, body: Body, poses: tuple[Configuration, ...], deadline: Deadline) -> float:
        """Return how long (s) a body takes on its best path if nobody else is there (inf: there is
        none). That path is one of those that are known then.
        """
        path = self._workspace.path(body, poses, (), deadline)
        if not isinstance(path, Path):
            return math.inf
        self._workspace.ways(body, poses).paths.setdefault(path.number, path)
        return path.natural.duration

    def ways(self, motion: TimedMotion) -> KnownPaths:
        """Return the paths for a motion that were of use, for whoever it was."""
        return self._workspace.ways(motion.body, motion.poses)

    def known_ways(self, motion: TimedMotion, moving: Collection[str]) -> list[Path]:
        """Return the paths that were of use for a motion and meet nobody who stays where it is at
        first: all but those who are ``moving``, and what is placed.
        """
        still = [rest for name, rest in self._first.items() if name not in moving]
        return [
            path
            for path in self.ways(motion).quickest_first()
            if not len(
                self._workspace.forbidden(
                    path, motion.object, motion.avoid, [*still, *self._placed]
                )
            )
        ]

    def passing(self, one: TimedMotion, path: Path, other: TimedMotion, there: Path) -> FloatArray:
        """Return what it takes that one of two motions passes before the other, on given paths."""
        flags = pair_flags(one.object, one.avoid, other.object, other.avoid)
        return self._workspace.passing(path, there, flags)

    def handover(self, leaver: TimedMotion, comer: TimedMotion) -> float:
        """Return how long (s) after one motion begins another one may end where it began, on ways
        that are known and that they take without a stop (inf: none is known). What these take
        longer than the quickest ones is counted, too.
        """
        some, others = (self.ways(motion).quickest_first() for motion in (leaver, comer))
        best = math.inf
        for path, there in sorted(
            itertools.product(some, others), key=lambda two: sum(p.natural.duration for p in two)
        ):
            longer = path.natural.duration - some[0].natural.duration
            longer += there.natural.duration - others[0].natural.duration
            if longer >= best:
                break
            gaps = self.passing(leaver, path, comer, there)
            # of obstacles with the place itself: who comes there first has to leave it again
            shared = gaps[np.any(gaps[:, 1, 1] > -math.inf, axis=1), 0, 0, 0]
            wait = max(0.0, np.max(shared, initial=-math.inf) + there.natural.duration)
            best = min(best, longer + wait)
        return best

    def sooner(self, motion: TimedMotion, run: TimedPath, others: Sequence[TimedPath]) -> TimedPath:
        """Return the earliest run of a motion on the path of a run that is known, among ``others``
        and who never moves.
        """
        objects = {other.object for other in others}
        still = [r for n, r in self._first.items() if n not in objects | {motion.object}]
        found = fit(self._workspace, motion, run.path, [*others, *still, *self._placed], run)
        return run if found is None else found

    def by_known_ways(self, motion: TimedMotion) -> TimedPath | None:
        """Return the earliest run of a motion on a path that was of use for it before, if any."""
        asked = self._after_last(motion)
        others = self._others({motion.object}, motion.release)
        best: TimedPath | None = None
        for path in self.ways(motion).quickest_first():
            best = fit(self._workspace, asked, path, others, best)
            if is_good(best, motion):
                break
        return best

    def by_proposed_way(self, motion: TimedMotion, best: TimedPath | None) -> TimedPath | None:
        """Return the run of a motion on a way that a search in space and time proposes among what
        is decided, or ``best`` if that is not later. The way is a known one then.
        """
        asked, proposer = self._after_last(motion), proposer_of(self._workspace)
        others = self._others({motion.object}, motion.release)
        until = math.inf if best is None else best.arrival
        path = None if proposer is None else proposer.propose(asked, others, until=until)
        if path is None:
            return best
        self.ways(motion).paths.setdefault(path.number, path)
        return fit(self._workspace, asked, path, others, best)

    def learn_ways_past(
        self, motion: TimedMotion, stands: Sequence[Stand], deadline: Deadline, tries: int
    ) -> None:
        """Look for ways of a motion past the places where others may stand, once; they are known
        ways then.
        """
        ways = self.ways(motion)
        if ways.past or not ways.paths:
            return
        ways.past = True
        best = ways.quickest_first()[0]
        asked = motion.poses, best, stands, deadline
        for path in ways_past(self._workspace, *asked, tries=tries):
            ways.paths.setdefault(path.number, path)

    def learn_way_past(
        self, motion: TimedMotion, path: Path, other: TimedPath, deadline: Deadline
    ) -> Path | None:
        """Return a new way of a motion past where ``path`` meets another run's, if one is found. It
        is a known way then.
        """
        ways, rows = self.ways(motion), self._workspace.conflicts(path, other.path)
        met = [(other, int(np.median(rows[:, 1:])), 0.0)] if len(rows) else []
        virtual, found = virtual_obstacles(self._workspace, path, met), None
        if virtual:
            found = self._workspace.detour(motion.body, motion.poses, (), virtual, deadline)
        if found is None or found.number in ways.paths:
            return None
        return ways.paths.setdefault(found.number, found)

    def past_all_ends(self, motion: TimedMotion, deadline: Deadline) -> TimedPath | None:
        """Return the earliest run of a motion on its best path past the places where all others
        stay in the end, if there is such a path and a timing.

        Whatever the others do before, on that path it can drive once they have done it.
        """
        others = self._others({motion.object}, -math.inf)
        ends = [
            Placed(o.object, o.path.body, o.path.ends[1])
            for o in others
            if o.until == math.inf and avoids(motion.avoid, o.object)
        ]
        path = self._workspace.path(motion.body, motion.poses, ends, deadline)
        if not isinstance(path, Path):
            return None
        return fit(self._workspace, self._after_last(motion), path, others)

    def add(self, run: TimedPath) -> None:
        """Decide a run: its object leaves where its last one ended when it leaves."""
        runs = self._runs.setdefault(run.object, [])
        if runs:
            runs[-1] = replace(runs[-1], until=run.since)
        runs.append(run)

    def withdraw(self, name: str) -> None:
        """Undo the last decided motion of an object: it stays where that began."""
        runs = self._runs[name]
        runs.pop()
        if runs:
            runs[-1] = replace(runs[-1], until=math.inf)
        else:
            del self._runs[name]

    def clear(self, runs: Sequence[TimedPath]) -> bool:
        """Return whether an object's runs meet nothing that is decided of others."""
        others = self._others({run.object for run in runs}, -math.inf)
        pairs = itertools.product(runs, others)
        return all(self._workspace.meeting(*pair)[0] == math.inf for pair in pairs)

    def stays(self, motion: TimedMotion) -> list[tuple[float, float]]:
        """Return when (from, until; s) the object of a motion may rest where that ends, after its
        release, as far as all others are decided; ascending.
        """
        rest = self._workspace.resting(motion.body, motion.poses[-1])
        taken: list[tuple[float, float]] = []
        for other in self._others({motion.object}, motion.release):
            if pair_flags(motion.object, motion.avoid, other.object, other.avoid):
                cells = self._workspace.conflicts(rest, other.path)
                # nobody drives to where another one stands: rests count, too
                taken += [(other.held[j], other.held[k + 1]) for i, j, k in cells if i == 1]
        taken.sort()
        found, free = [], motion.release
        for low, high in taken:
            if low > free:
                found.append((free, float(low)))
            free = max(free, float(high))
        return found if math.isinf(free) else [*found, (free, math.inf)]

    def trajectories(self) -> dict[str, TimedPath]:
        """Return all decided runs by name."""
        return {run.name: run for runs in self._runs.values() for run in runs}

    def _after_last(self, motion: TimedMotion) -> TimedMotion:
        """Return a motion of an object that is at its start since its last decided one."""
        return replace(motion, present_from=self.arrival(motion.object))

    def _others(self, mine: set[str], since: float) -> list[TimedPath]:
        """Return what is there of others after ``since`` (s)."""
        found = [r for n, r in self._first.items() if n not in mine and n not in self._runs]
        others = (runs for name, runs in self._runs.items() if name not in mine)
        found += [run for runs in others for run in runs if run.until > since]
        return [*found, *self._placed]
