"""How long robots travel, before anybody's motions are decided: a model that gets better.

At first a drive takes what it takes at least. Bounds know little of turns, and of some bodies less
than of others. So the drives that somebody is meant to make are planned, each alone on the floor,
which costs little; what they really take is known then, and how far bounds of the same body are
off tells something about its other drives.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

import numpy as np
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import Body, Configuration, Deadline
from up_samp.model.arrays import FloatArray
from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.search.fleet.duties import Duties
from up_samp.search.fleet.jobs import Jobs, WorkMode, stated_precedences

ENOUGH = 12
"""Drives of a body, after which others are not planned if bounds tell them..."""
_CLOSE = 1.1
"""...which they do if how far they are off differs by no more than this factor."""
_ALIKE, _OTHER_BODY = 0.1, 0.2
"""Between the directions of drives that leave a place, or come there, so that handovers are alike
(chord of the unit circle), and how much what another body drives tells of them.
"""
_TOLD = 1e-3
"""What all that is known of others counts at least, so that a handover is guessed by it."""

_NONE = Duties()
Lasts = Callable[[Body, Configuration, Configuration], float]
"""How long a body takes at least from one pose to another (s)."""
Drives = Callable[[Body, Configuration, Configuration, Deadline], float | None]
"""How long a body takes alone on the floor from one pose to another (s), None if it is unknown."""
OneDrive = tuple[str, Configuration, Configuration]
"""A robot that drives, from where to where."""
Handover = Callable[[OneDrive, OneDrive, Deadline], float | None]
"""How long after one robot begins to leave a place another one may be there (s), None if it is
unknown.
"""
Drive = tuple[Body, Configuration, Configuration]
"""How a body drives, from where to where."""


class TravelTimeModel:
    """What work takes a robot, from place to place: ``lasts`` at least, ``drives`` really.

    :param pauses: units between the activities of an option at least, by its leader.
    :param duties: what robots have to do beside their jobs.
    """

    def __init__(
        self,
        snapshot: Snapshot,
        lasts: Lasts,
        drives: Drives | None = None,
        pauses: Mapping[str, int] | None = None,
        duties: Duties = _NONE,
        hands_over: Handover | None = None,
    ) -> None:
        self.snapshot, self.duties = snapshot, duties
        self._lasts, self._drives = lasts, drives
        self._pauses = pauses or {}
        self._hands_over = hands_over
        self._known: dict[Drive, float] = {}
        self._real: dict[Drive, float] = {}
        self.handovers: dict[tuple[Drive, Drive], float] = {}
        """How long after one drive begins another one may end where it began (s)."""
        self._told: dict[Body, list[tuple[float, float]]] = defaultdict(list)
        """What was learned of a body's drives: (bound, really)."""
        self._ratios: dict[Body, float] = {}
        self.rounds = 0
        """How often something was learned: what was guessed before then may be wrong now."""

    def ride(self, robot: str, a: Configuration, b: Configuration) -> float:
        """Return how long (s) a robot drives from one pose to another, in whole units."""
        key = self.snapshot.objects[robot].body, a, b
        real = self._real.get(key)
        if real is None:
            real = self._least(key) * self._ratios.get(key[0], 1.0)
        return self._whole(real)

    def _whole(self, seconds: float) -> float:
        """Return seconds in whole units."""
        unit = self.snapshot.seconds_per_unit
        return unit * math.ceil(seconds / unit - 1e-6)

    def pause(self, option: WorkMode) -> float:
        """Return how long (s) a robot waits at least between the activities of an option."""
        return self._pauses.get(option.leader, 0) * self.snapshot.seconds_per_unit

    def ask(self, ways: Iterable[OneDrive], deadline: Deadline) -> int:
        """Learn what drives really take, and return how many of them were not known. Nothing is
        asked where bounds of a body are found to tell it well enough.
        """
        new = 0
        for robot, a, b in ways:
            key = self.snapshot.objects[robot].body, a, b
            if self._drives is None or key in self._real or a == b or deadline.expired():
                continue
            bound = self._least(key)
            real = None if self._told_well(key[0]) else self._drives(*key, deadline)
            if real is None:
                continue
            new += 1
            self._real[key] = max(real, bound)
            if bound > 0.0:
                self._told[key[0]].append((bound, self._real[key]))
        for body, told in self._told.items():
            self._ratios[body] = sum(real for _, real in told) / sum(bound for bound, _ in told)
        self.rounds += new > 0
        return new

    def ask_handovers(
        self,
        pairs: Iterable[tuple[OneDrive, OneDrive]],
        deadline: Deadline,
        *,
        again: bool = False,
    ) -> int:
        """Learn how long handovers take, and return how many of them were asked for: those that are
        not known, or all of them ``again``, as more ways may be known now.
        """
        new = 0
        for pair in pairs:
            one, other = ((self.snapshot.objects[r].body, a, b) for r, a, b in pair)
            known = (one, other) in self.handovers and not again
            if self._hands_over is None or known or deadline.expired():
                continue
            seconds = self._hands_over(*pair, deadline)
            if seconds is not None:
                new += 1
                self.handovers[one, other] = self._whole(seconds)
        self.rounds += new > 0
        return new

    def _told_well(self, body: Body) -> bool:
        """Return whether a body's drives take as much longer than their bounds as others of it."""
        ratios = [real / bound for bound, real in self._told[body]]
        return len(ratios) >= ENOUGH and max(ratios) <= _CLOSE * min(ratios)

    def _least(self, key: tuple[Body, Configuration, Configuration]) -> float:
        known = self._known.get(key)
        if known is None:
            known = self._known[key] = 0.0 if key[1] == key[2] else self._lasts(*key)
        return known

    @cached_property
    def _ways_on(self) -> Mapping[str, tuple[Configuration, Configuration]]:
        """From where to where activities drive that always drive the same way."""
        pose, found = self.snapshot.configurations, {}
        for task in self.snapshot.tasks:
            if all(term.kind is TermKind.CONSTANT for term in task.terms):
                found[task.activity] = pose[task.terms[0].name], pose[task.terms[-1].name]
        return found

    def home(self, option: WorkMode) -> Configuration | None:
        """Return where a robot has to be when all is done, or may go when it has done a job and
        others need its place.
        """
        names = [
            *sorted(option.extras),
            self.duties.drives_home.get((option.robot, option.exit), ""),
        ]
        ways = [self._ways_on[n] for n in names if n in self._ways_on]
        aside = next((b for a, b in ways if a == option.exit and b != a), None)
        return self.duties.ends.get(option.robot, aside)


def likely_handovers(
    leaving: Sequence[Drive], coming: Sequence[Drive], seconds: FloatArray
) -> FloatArray:
    """Return how long handovers take (s) after one drive (row) until another one ends (column),
    also those that are not known (negative): by what is known at the same place of drives in such
    directions (kernel regression; Nadaraya 1964, Watson 1964). Who leaves by where the next one
    comes takes two or three times as long as others.
    """
    found = seconds.copy()
    for place in sorted({a for _, a, _ in leaving}):
        rows = [n for n, (_, a, _) in enumerate(leaving) if a == place]
        columns = [n for n, (_, _, b) in enumerate(coming) if b == place]
        block = seconds[np.ix_(rows, columns)]
        told = block >= 0.0
        row, column = np.nonzero(told)
        one = _likeness([(body, b, a) for body, a, b in map(leaving.__getitem__, rows)])[:, row]
        other = _likeness([*map(coming.__getitem__, columns)])[:, column]
        weight = one @ other.T
        guessed = ~told & (weight > _TOLD)
        block[guessed] = ((one * block[told]) @ other.T)[guessed] / weight[guessed]
        found[np.ix_(rows, columns)] = block
    return found


def _likeness(drives: Sequence[Drive]) -> FloatArray:
    """Return how much each of some drives to a place tells of each other one (n, n)."""
    ways = np.array([np.subtract(a[:2], b[:2]) for _, a, b in drives]).reshape(-1, 2)
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
    chords = np.linalg.norm(ways[:, None] - ways, axis=2)
    bodies = {body: number for number, body in enumerate(dict.fromkeys(d[0] for d in drives))}
    body = np.array([bodies[d[0]] for d in drives])
    alike: FloatArray = np.exp(-((chords / _ALIKE) ** 2))
    return alike * np.where(body[:, None] == body, 1.0, _OTHER_BODY)


def pauses_of(problem: SchedulingMotionProblem, jobs: Jobs) -> dict[str, int]:
    """Return units between the activities of each option at least, by leader: one ends before
    another one begins.
    """
    then: dict[str, set[str]] = defaultdict(set)
    for first, second in stated_precedences(problem, strictly=True):
        then[second].add(first)
    found = {}
    for option in (o for options in jobs.options for o in options):
        before = {m: then[m] & option.members for m in option.members}
        depth: dict[str, int] = {}
        try:
            for name in TopologicalSorter(before).static_order():
                depth[name] = max((depth[b] + 1 for b in before[name]), default=0)
        except CycleError:
            continue  # nobody can do it
        found[option.leader] = max(depth.values(), default=0)
    return found
