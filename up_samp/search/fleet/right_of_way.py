"""Who goes first wherever two robots' paths meet, and who takes which of its known ways: decided
for all tours at once.

Deciding one robot after the other (:mod:`up_samp.search.fleet.tours`) asks who goes first a few
times, and never again. Here it is a disjunctive program, as of a job shop. A motion's start is a
number; each obstacle of two paths' coordination diagram (O'Donnell and Lozano-Pérez, "Deadlock-free
and collision-free coordination of two robot manipulators", ICRA 1989) is passed by one of the two
first; who rests somewhere leaves before others come by, or comes after them (with one path for each
robot a mixed integer program: Peng and Akella, "Coordinating multiple robots with kinodynamic
constraints along specified paths", IJRR 2005). Which of its ways a motion takes is a choice, too,
and whether a last drive out of others' way is made at all. Robots do not wait on their way here:
what CP-SAT finds is driven as soon as everybody can then
(:meth:`~up_samp.search.fleet.tours.TourPlanner.follow`). So no bound of the program is one of the
problem.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from ortools.sat.python import cp_model

from up_samp.model import Deadline
from up_samp.model.arrays import FloatArray
from up_samp.motion.fleet.paths import Path
from up_samp.scheduling.cpsat.solve.runner import NO_LINEARIZATION, run
from up_samp.scheduling.partial_order.differences import HORIZON, ZERO, Difference, Point

_TICK, _FINE = 0.02, 10
"""Of the program: a tick is about so long (s), and a unit has so many of them at least."""
_EFFORT = 5e-4
"""Deterministic seconds of CP-SAT for each decision."""

Driven = Mapping[str, tuple[Path, float]]
"""The way of each motion that is made, and when it starts (s)."""


@dataclass
class Crossings:
    """What is to be decided, and the program of it.

    :param chains: the motions of each robot, in order.
    :param ways: known ways of each motion, that meet nobody who never moves.
    :param optional: motions at the end of chains that may be left out.
    :param differences: what is asked of starts and ends (units)...
    :param earliest: ...and when these are at the soonest.
    :param unit: how long it is (s).
    :param passing: what it takes that one motion passes before another one, each on one of its ways
        (see :func:`~up_samp.motion.fleet.conflicts.passing_gaps`).
    :param limit: when all has to be done (units).
    """

    chains: Mapping[str, Sequence[str]]
    ways: Mapping[str, Sequence[Path]]
    optional: frozenset[str]
    differences: Sequence[Difference]
    earliest: Mapping[Point, int]
    unit: float
    passing: Callable[[str, Path, str, Path], FloatArray]
    limit: int
    decisions: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.model = model = cp_model.CpModel()
        # what is left out in the end has its times, too: as long after all else as it takes at most
        longest = self.limit + max(self.earliest.values())
        self._ticks = max(_FINE, round(self.unit / _TICK))
        self._latest = self._latest_times(longest)
        self._points = {
            point: model.new_int_var(min(soonest, self._latest[point]), self._latest[point], "")
            for point, soonest in self.earliest.items()
        }
        for d in self.differences:
            model.add(self._points[d.then] - self._points[d.first] >= d.lag + d.strict)
        latest, names = longest * self._ticks, list(self.ways)
        self._starts = {name: model.new_int_var(0, 2 * latest, "") for name in names}
        self._arrivals = {name: model.new_int_var(0, latest, "") for name in names}
        self._made = {name: model.new_bool_var("") for name in names}
        self._takes = {name: [model.new_bool_var("") for _ in self.ways[name]] for name in names}
        pairs = (pair for chain in self.chains.values() for pair in itertools.pairwise(chain))
        self._next = dict(pairs)
        self._before = {b: a for a, b in self._next.items()}
        # who stays somewhere leaves it when all is over, and was always where it is at first
        self._over = 2 * latest
        self._gone = {
            n: (self._starts[n], self._starts.get(self._next.get(n, ""), self._over)) for n in names
        }
        self._comes = {
            n: (self._starts[n], self._arrivals.get(self._before.get(n, ""), -self._over))
            for n in names
        }
        self._state_motions()
        windows = self._windows()
        for one, other in itertools.combinations(self.chains.values(), 2):
            for a, b in itertools.product(one, other):
                # else one of them is over in any case when the other one begins
                if windows[a][0] < windows[b][1] and windows[b][0] < windows[a][1]:
                    self._state_passing(a, b)
        last = model.new_int_var(0, self.limit, "")
        for (anchor, name), end in self._points.items():
            if anchor == "end":
                stated = model.add(last >= end)
                if name in self.optional:
                    stated.only_enforce_if(self._made[name])
        model.minimize(last)

    def _latest_times(self, longest: int) -> dict[Point, int]:
        """Return when points may be at the latest (units) so that all that is not optional is done
        by the limit, and what is by ``longest``.
        """
        found = dict.fromkeys(self.earliest, longest)
        found |= {point: self.limit for point in found if point[1] not in self.optional}
        found |= {ZERO: 0, HORIZON: longest}
        todo = deque(found)
        before = defaultdict[Point, list[Difference]](list)
        for d in self.differences:
            before[d.then].append(d)
        while todo:
            then = todo.popleft()
            for d in before[then]:
                latest = max(0, found[then] - d.lag - d.strict)
                if latest < found[d.first]:
                    found[d.first] = latest
                    todo.append(d.first)
        return found

    def _windows(self) -> dict[str, tuple[float, float]]:
        """Return from when to when (s), at the soonest and at the latest, each motion's object is
        on its way or rests at one of its ends.
        """
        comes = {n: self.unit * self.earliest["start", n] + self._least(n) for n in self.ways}
        # who may leave a last drive out stays where it is
        leaves = {
            n: self.unit * self._latest["end", n] - self._least(n)
            for n in self.ways.keys() - self.optional
        }
        return {
            n: (
                comes.get(self._before.get(n, ""), -math.inf),
                leaves.get(self._next.get(n, ""), math.inf),
            )
            for n in self.ways
        }

    def _least(self, name: str) -> float:
        """Return how long (s) a motion takes at least."""
        return min((path.natural.duration for path in self.ways[name]), default=0.0)

    def decide(self, known: Driven, deadline: Deadline) -> Driven | None:
        """Return what is driven when, so that all is done as soon as it was found to be; None where
        nothing was found.

        :param known: where the search begins.
        """
        self._hint(known)
        found: list[int] = []

        def improved(values: list[int], _: float) -> None:
            found[:] = values

        # from below: the first bound is nearly met, and what meets it is found much sooner so
        options = {
            **NO_LINEARIZATION,
            "use_objective_lb_search": True,
            "num_workers": 1,
            "random_seed": 0,
            "max_deterministic_time": max(1.0, _EFFORT * self.decisions),
        }
        run(self.model, deadline, improved, options=options)
        return self._driven(found) if found else None

    def _state_motions(self) -> None:
        """State when motions are, by the ways that they take."""
        model, points = self.model, self._points
        for name, ways in self.ways.items():
            start, arrival, made = self._starts[name], self._arrivals[name], self._made[name]
            if name not in self.optional:
                model.add(made == 1)
            model.add(sum(self._takes[name]) == made)
            for takes, path in zip(self._takes[name], ways, strict=True):
                lasts = self._enough(path.natural.duration)
                model.add(arrival == start + lasts).only_enforce_if(takes)
            model.add(start == self._over).only_enforce_if(made.negated())
            model.add(start >= self._ticks * points["start", name])
            model.add(arrival <= self._ticks * points["end", name])
            model.add(start >= self._comes[name][1])

    def _state_passing(self, one: str, other: str) -> None:
        """State that wherever two motions meet one of them passes first, on all their ways."""
        ways = self.ways
        for (p, path), (q, there) in itertools.product(
            enumerate(ways[one]), enumerate(ways[other])
        ):
            gate = self._takes[one][p], self._takes[other][q]
            for gaps in self.passing(one, path, other, there):
                first = self.model.new_bool_var("")
                self.decisions += 1
                self._goes_first(one, other, gaps[0], (first, *gate))
                self._goes_first(other, one, gaps[1], (first.negated(), *gate))

    def _goes_first(
        self, one: str, other: str, gaps: FloatArray, where: tuple[cp_model.IntVar, ...]
    ) -> None:
        """State that one motion passes before another one ``where`` literals hold."""
        for (leaves, comes), gap in np.ndenumerate(gaps):
            if gap > -math.inf:
                since, then = self._gone[one][leaves], self._comes[other][comes]
                # a tick more than it has to be: timings are sampled
                ticks = self._enough(gap) + 1
                self.model.add(then - since >= ticks).only_enforce_if(*where)

    def _enough(self, seconds: float) -> int:
        """Return so many ticks that they are no less than some seconds."""
        return math.ceil(seconds / self.unit * self._ticks - 1e-6)

    def _hint(self, known: Driven) -> None:
        """Tell the solver what is known."""
        for name, ways in self.ways.items():
            path, start = known.get(name, (None, 0.0))
            self.model.add_hint(self._made[name], path is not None)
            for takes, way in zip(self._takes[name], ways, strict=True):
                self.model.add_hint(takes, way is path)
            if path is not None:
                self.model.add_hint(self._starts[name], self._enough(start))

    def _driven(self, values: Sequence[int]) -> Driven:
        """Return what a solution of the program drives."""
        tick = self.unit / self._ticks

        def ways() -> Iterator[tuple[str, tuple[Path, float]]]:
            for name, some in self._takes.items():
                for takes, path in zip(some, self.ways[name], strict=True):
                    if values[takes.index]:
                        yield name, (path, values[self._starts[name].index] * tick)

        return dict(ways())
