"""How soon all jobs can be done when robots share them as evenly as can be: a linear relaxation.

Each job is done in one way. Robots of a kind leave a place as often as they come there, and
once more for each that begins there (the relaxation of routes as a flow); in the end no more of
them are at a place than there is room for (:mod:`up_samp.search.fleet_bound.final_occupancy`).
All that robots of a kind do takes no longer than the makespan for each of them. Jobs may be cut
in pieces, so no plan is better.

Who has no part in the work has none in the time either: that is told by a bound that holds
already (``since``). Work <= T robots <= since robots + (T - since) size for every T >= since,
so each bound makes way for a better one.

The value is what the solver's multipliers prove (Lagrange): whatever its tolerances, it is a
bound.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from up_samp.model.arrays import FloatArray
from up_samp.search.fleet_bound.final_occupancy import FinalOccupancy, least
from up_samp.search.fleet_bound.work import JobMode, JobWork, Leg

LoadBalance = tuple[float, frozenset[Leg]]
"""Units that no plan is shorter than, and the drives that the share is made of."""
Comings = Mapping[tuple[int, str], int]
"""What it takes a kind of robots at least to come to a place otherwise than for jobs (units)."""


def called(ways: Sequence[JobMode]) -> set[tuple[int, str]]:
    """Return from where (kind, place) robots may come to jobs."""
    return {(w.kind, p) for w in ways if w.goal is not None for p in w.origins}


def least_share(
    work: JobWork,
    ways: Sequence[JobMode],
    comings: Comings,
    seconds: float,
    last: FinalOccupancy | None = None,
    since: int = 0,
) -> LoadBalance:
    """Return a bound on the makespan of all jobs, 0 where there is no time for it.

    :param seconds: limit of the solver.
    :param since: no plan is shorter, that is known.
    """
    from scipy.optimize import linprog  # half a second, for those who have many jobs

    model = _Model(work, ways, comings, last or FinalOccupancy(), since)
    found = linprog(
        model.costs,
        A_ub=model.less.matrix(len(model.costs)),
        b_ub=np.array(model.less.limits),
        A_eq=model.equal.matrix(len(model.costs)),
        b_eq=np.array(model.equal.limits),
        method="highs",
        options={"time_limit": max(seconds, 0.01)},
    )
    if found.status != 0:
        return 0.0, frozenset()
    proven = model.proven(found.eqlin.marginals, found.ineqlin.marginals)
    # beyond the limit of a column nothing is proven of it, but of the makespan that it is more
    return min(proven, model.most), model.legs(found.x)


@dataclass
class _Rows:
    """Rows of a linear program."""

    limits: list[float] = field(default_factory=list)
    _entries: list[tuple[int, int, float]] = field(default_factory=list)

    def add(self, entries: Sequence[tuple[int, float]], limit: float) -> None:
        """Add a row: (column, coefficient)s and the right-hand side."""
        self._entries += [(len(self.limits), column, value) for column, value in entries]
        self.limits.append(float(limit))

    def matrix(self, columns: int) -> Any:
        """Return all rows, sparse; coefficients of the same place add up."""
        from scipy.sparse import csr_array

        rows, cols, values = zip(*self._entries, strict=True) if self._entries else ((), (), ())
        return csr_array((values, (rows, cols)), shape=(len(self.limits), columns))


class _Model:
    """The linear program: least T such that the jobs fit. Column 0 is T."""

    def __init__(
        self,
        work: JobWork,
        ways: Sequence[JobMode],
        comings: Comings,
        last: FinalOccupancy,
        since: int,
    ) -> None:
        self._work, self._ways, self._last, self._since = work, ways, last, since
        self.less, self.equal = _Rows(), _Rows()
        self._columns = [(i, p) for i, w in enumerate(ways) for p in _origins(w)]
        self._first = {pair: 1 + n for n, pair in enumerate(self._columns)}
        self._called = sorted(called(ways))
        self._comings = sorted(comings.items())
        self._others = {at: 1 + len(self._columns) + n for n, (at, _) in enumerate(self._comings)}
        known = 1 + len(self._columns) + len(self._others)
        self._aways = {away: known + n for n, away in enumerate(sorted(last.aways, key=str))}
        self._left = {away: least(legs, work.units) for away, legs in last.aways.items()}
        known += len(self._aways)
        kinds = sorted(work.sizes)
        stays = [(kind, place) for kind in kinds for place in sorted(last.places)]
        self._staying = {stay: known + n for n, stay in enumerate(stays)}
        known += len(stays)
        self._working = {kind: known + n for n, kind in enumerate(kinds)}
        self.costs = np.zeros(known + len(kinds))
        self.costs[0] = 1.0
        self._units = [ways[i].units(p, work.units) for i, p in self._columns]
        jobs = {w.job for w in ways}
        self._most = self._limits(jobs)
        self._state_jobs(jobs)
        self._state_places()
        self._state_ends()
        self._state_time()

    @property
    def most(self) -> float:
        """The makespan up to which something is proven."""
        return float(self._most[0])

    def _limits(self, jobs: set[int]) -> FloatArray:
        """Return what each column is at most, in plans that are no longer than one robot would take
        for all jobs, each in the worst way.
        """
        found = np.ones(len(self.costs))
        worst = defaultdict[int, int](int)
        for (i, p), units in zip(self._columns, self._units, strict=True):
            way = self._ways[i]
            worst[way.job] = max(worst[way.job], units)
            if way.job in self._last.repeated:
                found[self._first[i, p]] = self._last.repeated[way.job]
        times = [self._last.repeated.get(job, 1) for job in jobs]
        found[list(self._others.values())] = sum(times)
        for away, column in self._aways.items():
            found[column] = self._last.often[away]
        for kind, column in self._working.items():
            found[column] = self._work.sizes[kind]
        longest = max((units for units, _ in self._left.values()), default=0)
        found[0] = sum(worst.values()) + longest * len(jobs)
        return found

    def _state_jobs(self, jobs: set[int]) -> None:
        """Each job is done once, or several times where that makes no difference to others."""
        by_job = defaultdict[int, list[int]](list)
        for pair, column in self._first.items():
            by_job[self._ways[pair[0]].job].append(column)
        for job in sorted(jobs):
            if job in self._last.repeated:
                self.less.add([(column, -1.0) for column in by_job[job]], -1.0)
            else:
                self.equal.add([(column, 1.0) for column in by_job[job]], 1.0)

    def _state_places(self) -> None:
        """Nobody leaves a place more often than somebody came there or began there, whether for
        these jobs or otherwise.
        """
        leaving = defaultdict[tuple[int, str], list[int]](list)
        coming = defaultdict[tuple[int, str], list[tuple[int, float]]](list)
        for (i, p), column in self._first.items():
            way = self._ways[i]
            if p is not None:
                leaving[way.kind, p].append(column)
            for end in way.ends:
                coming[way.kind, end].append((column, -1.0))
        for at in self._called:
            starts, out, came = self._work.starts[at], leaving[at], coming[at]
            other = [(self._others[at], -1.0)] if at in self._others else []
            other += [(c, -1.0) for away, c in self._aways.items() if (away[0], away[2]) == at]
            self.less.add([*((c, 1.0) for c in out), *came, *other], starts)

    def _state_ends(self) -> None:
        """No more than one of all robots is at a place in the end, and those that worked are there,
        or drove away.
        """
        staying = defaultdict[tuple[int, str], list[tuple[int, float]]](list)
        for (i, origin), column in self._first.items():
            way = self._ways[i]
            begins = (*(way.leaves or ()), *(() if origin is None else (origin,)))
            for place in way.ends:
                staying[way.kind, place].append((column, 1.0))
            for place in begins:
                staying[way.kind, place].append((column, -1.0))
        for (kind, start, goal), column in self._aways.items():
            staying[kind, start].append((column, -1.0))
            if goal is not None:
                staying[kind, goal].append((column, 1.0))
        for at, column in self._staying.items():
            self.less.add([*staying[at], (column, -1.0)], 0.0)
        for place in sorted(self._last.places):
            self.less.add([(c, 1.0) for (_, p), c in self._staying.items() if p == place], 1.0)
        for kind, column in self._working.items():
            self.less.add([(column, 1.0)], self._work.sizes[kind])
            if self._last.everybody:
                some = [c for (k, _), c in self._staying.items() if k == kind]
                some += [c for (k, _, _), c in self._aways.items() if k == kind]
                self.less.add([(column, 1.0), *((c, -1.0) for c in some)], 0.0)

    def _state_time(self) -> None:
        """Robots of a kind that work have time until T, each (see the module)."""
        for kind, size in sorted(self._work.sizes.items()):
            entries = [(0, -float(size)), (self._working[kind], -float(self._since))]
            first = zip(self._first.items(), self._units, strict=True)
            entries += [(c, float(u)) for ((j, *_), c), u in first if self._ways[j].kind == kind]
            entries += [(self._others[at], float(u)) for at, u in self._comings if at[0] == kind]
            left = self._left.items()
            entries += [(self._aways[at], float(u)) for at, (u, _) in left if at[0] == kind]
            self.less.add(entries, -float(size * self._since))

    def proven(self, equal: FloatArray, less: FloatArray) -> float:
        """Return what multipliers prove: no choice of all columns within their limits that keeps
        the rows costs less.
        """
        less = np.minimum(less, 0.0)
        columns = len(self.costs)
        reduced = self.costs - equal @ self.equal.matrix(columns)
        reduced = reduced - less @ self.less.matrix(columns)
        parts = [*(equal * self.equal.limits), *(less * self.less.limits)]
        parts += list(np.minimum(reduced, 0.0) * self._most)
        return math.fsum(parts)

    def legs(self, values: FloatArray) -> frozenset[Leg]:
        """Return the drives of what is used."""
        used = {
            leg
            for (i, p), column in self._first.items()
            if values[column] > 1e-7
            for leg in self._ways[i].drives(p)
        }
        aways = {self._left[away][1] for away, c in self._aways.items() if values[c] > 1e-7}
        return frozenset(used | aways)


def _origins(way: JobMode) -> Sequence[str | None]:
    return [None] if way.goal is None else sorted(way.origins)
