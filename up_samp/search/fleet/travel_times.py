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
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.search.fleet.duties import Duties
from up_samp.search.fleet.jobs import Jobs, WorkMode, stated_precedences

ENOUGH = 12
"""Drives of a body, after which others are not planned if bounds tell them..."""
_CLOSE = 1.1
"""...which they do if how far they are off differs by no more than this factor."""
SECTORS = 64
"""In which others lie, seen from a place: those in one are told alike."""
_ALIKE, _TOLD = 0.12, 1e-3
"""Between directions (chord of the unit circle), so that handovers are alike; and how much all that
is known has to tell of one.
"""

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
            *self.duties.drives_home.get((option.robot, option.exit), ()),
        ]
        ways = [self._ways_on[n] for n in names if n in self._ways_on]
        aside = next((b for a, b in ways if a == option.exit and b != a), None)
        return self.duties.ends.get(option.robot, aside)


def likely_handovers(
    known: Mapping[tuple[Drive, Drive], float], places: Mapping[Configuration, int]
) -> FloatArray:
    """Return how long handovers are likely to take (place, sector where one leaves, sector where
    the other one comes from; s; negative: nothing is known of such; so is all that is last in a
    row). Who leaves by where the next one comes takes two or three times as long as others: it is
    told by what is known of drives at the same place in such directions (kernel regression;
    Nadaraya 1964, Watson 1964).
    """
    at = defaultdict[Configuration, list[tuple[Configuration, Configuration, float]]](list)
    for ((_, place, goal), (_, start, _)), seconds in known.items():
        at[place].append((goal, start, seconds))
    found = np.full((len(places) + 1, SECTORS + 1, SECTORS + 1), -1.0)
    for place in at.keys() & places.keys():
        goals, starts, took = zip(*at[place], strict=True)
        leaving, coming = _telling(place, goals), _telling(place, starts)
        told = leaving.T @ coming
        # rounded, as machines add in orders of their own
        guessed = np.round((leaving.T * took) @ coming / np.maximum(told, _TOLD), 6)
        found[places[place], :-1, :-1] = np.where(told > _TOLD, guessed, -1.0)
    return found


def sectors(poses: Sequence[Configuration]) -> IntArray:
    """Return in which sector of the plane each pose lies, seen from each one (from, to); what is
    last in a row is none (-1).
    """
    x, y = np.array([pose[:2] for pose in poses]).reshape(-1, 2).T
    turns = np.arctan2(y - y[:, None], x - x[:, None]) / (2.0 * np.pi) % 1.0
    found = np.full((len(poses) + 1, len(poses) + 1), -1)
    found[:-1, :-1] = np.minimum(turns * SECTORS, SECTORS - 1)
    return found


def _telling(place: Configuration, others: Sequence[Configuration]) -> FloatArray:
    """Return how much what is known of drives between a place and others tells of each sector
    (others, sectors).
    """
    x, y = np.array([other[:2] for other in others]).T
    angles = np.arctan2(y - place[1], x - place[0])
    middles = (np.arange(SECTORS) + 0.5) * (2.0 * np.pi / SECTORS)
    chords = 2.0 * np.sin(0.5 * (middles - angles[:, None]))
    told: FloatArray = np.exp(-((chords / _ALIKE) ** 2))
    return told


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
