"""What an assignment of jobs to robots takes if places are taken in turns, without motions.

A place that several robots work at is taken by one of them at a time, the one that comes first; the
next one comes when it has left (list scheduling of a unary resource). Whoever ends at a place where
others come later has to go on from there. Aisles, and who waits where, are left out: it is a guess.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from up_samp.model import Body, Configuration
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.search.fleet.duties import BatteryUse
from up_samp.search.fleet.evaluator_kernel import (
    BatteryTables,
    CostWeights,
    HandoverTables,
    TourArrays,
    WorkTables,
    beside,
    ends_of,
    length_of,
)
from up_samp.search.fleet.jobs import Jobs, WorkMode
from up_samp.search.fleet.travel_times import TravelTimeModel, likely_handovers, sectors

Step = tuple[int, int]
"""A job and which of its options is taken."""
Stop = tuple[str, Configuration]
"""A robot, and where it may stand."""


@dataclass
class AssignmentEvaluator:
    """Days of robots that have jobs to do."""

    guess: TravelTimeModel
    jobs: Jobs
    rules: CostWeights = field(default_factory=CostWeights)
    exact: bool = False
    """Whether handovers at shared places take what is known of each, or likely by what is known of
    others, else all of them the same.
    """
    _known: tuple[tuple[int, bool], WorkTables] | None = None
    """What options ask for, with how much was learned of drives when that was written down, and
    whether it is ``exact``: who is replaced by another one hands it on."""

    def __post_init__(self) -> None:
        self.robots = sorted({o.robot for options in self.jobs.options for o in options})
        """All that there are jobs for."""
        self._numbers = {robot: number for number, robot in enumerate(self.robots)}
        self._first = np.cumsum([0, *(len(options) for options in self.jobs.options)])
        self._steps = [
            (j, k) for j, options in enumerate(self.jobs.options) for k in range(len(options))
        ]
        jobs = Counter[Configuration]()
        for options in self.jobs.options:
            jobs.update({pose for option in options for pose in option.stops})
        shared = sorted(pose for pose, many in jobs.items() if many > 1)
        self._shared = {pose: number for number, pose in enumerate(shared)}

    def ends(self, tours: Mapping[str, Sequence[Step]]) -> dict[str, tuple[float, float]]:
        """Return when (s) each robot has done its jobs, and by how much it is late in all."""
        found = zip(self.robots, self._ends(tours), strict=True)
        return {r: (float(end), float(late)) for r, (end, late) in found if r in tours}

    def length(self, tours: Mapping[str, Sequence[Step]]) -> float:
        """Return how long (s) an assignment of all jobs takes (see :func:`length_of`)."""
        return float(length_of(self._ends(tours), self.rules))

    def _ends(self, tours: Mapping[str, Sequence[Step]]) -> FloatArray:
        return ends_of(self.work(), self.rules, self.arrays(tours), len(self._shared))

    def arrays(self, tours: Mapping[str, Sequence[Step]]) -> TourArrays:
        """Return tours as rows of numbers, with room for one job more than there are."""
        rows = np.full((len(self.robots), len(self.jobs.options) + 1), -1)
        counts = np.zeros(len(self.robots), dtype=np.int64)
        for robot, tour in tours.items():
            number = self._numbers[robot]
            counts[number] = len(tour)
            rows[number, : len(tour)] = [self._first[j] + k for j, k in tour]
        return TourArrays(rows, counts)

    def tours(self, arrays: TourArrays) -> dict[str, list[Step]]:
        """Return what tours are whose rows these are."""
        rows = zip(self.robots, arrays.tours, arrays.counts, strict=True)
        return {robot: [self._steps[o] for o in row[:count]] for robot, row, count in rows}

    def work(self) -> WorkTables:
        """Return what options ask for, by what is known of drives now."""
        asked = self.guess.rounds, self.exact
        if self._known is None or self._known[0] != asked:
            self._known = asked, self._work()
        return self._known[1]

    def _work(self) -> WorkTables:
        snapshot, ride = self.guess.snapshot, self.guess.ride
        options = [option for some in self.jobs.options for option in some]
        starts = {r: snapshot.configurations[snapshot.initial[r]] for r in self.robots}
        stops = [option.stops for option in options]
        goals, homes = self.guess.duties.ends, [self.guess.home(option) for option in options]
        poses = {*starts.values(), *goals.values(), *(option.exit for option in options)}
        poses |= {*filter(None, homes), *itertools.chain(*stops)}
        number = {pose: n for n, pose in enumerate(sorted(poses))}
        drives, stays = [], []
        for option in options:
            drives += [0.0, *(ride(option.robot, a, b) for a, b in option.legs)]
            many = len(option.stops)
            stays += [(option.work + self.guess.pause(option)) / many] * many
        kinds, rides = self._rides(options, starts, number)
        rests, loads, crews = self.guess.duties.rests, self.guess.duties.loads, self.jobs.crews
        of, robot, entry, exit_, crew = _columns(
            (j, self._numbers[o.robot], number[o.entry], number[o.exit], crews.get(j, -1))
            for (j, _), o in zip(self._steps, options, strict=True)
        )
        start, kind, goal, aboard = _columns(
            (number[starts[r]], kind, number.get(goals.get(r, ()), -1), loads.get(r, 1))
            for r, kind in zip(self.robots, kinds, strict=True)
        )
        return WorkTables(
            of=of,
            robot=robot,
            first=self._first,
            entry=entry,
            exit=exit_,
            home=np.array([*map(self._way_home, options)]),
            due=np.array([o.due * snapshot.seconds_per_unit for o in options], dtype=float),
            release=np.array([o.release * snapshot.seconds_per_unit for o in options]),
            head=np.cumsum([0, *map(len, stops)]),
            drive=np.array(drives, dtype=float),
            place=np.array([self._shared.get(pose, -1) for places in stops for pose in places]),
            stays=np.array(stays, dtype=float),
            crew=crew,
            start=start,
            kind=kind,
            rides=rides,
            goal=goal,
            rests=np.array([rests.get(r, 0.0) for r in self.robots]),
            loads=aboard,
            cells=self._cells(options, kinds, number, rides),
            handovers=self._handovers(kinds, number, [*itertools.chain(*stops)], homes),
        )

    def _handovers(
        self,
        kinds: Sequence[int],
        number: Mapping[Configuration, int],
        stops: Sequence[Configuration],
        homes: Sequence[Configuration | None],
    ) -> HandoverTables:
        """Return what is known of handovers at shared places, or likely by what is, with where all
        stops are, and where options lead home.
        """
        known = self.guess.handovers if self.exact else {}
        mine = defaultdict[Body, set[int]](set)
        for robot, kind in zip(self.robots, kinds, strict=True):
            mine[self.guess.snapshot.objects[robot].body].add(kind)
        leaving, coming = (dict.fromkeys(pair[side] for pair in known) for side in (0, 1))
        leaves, comes = np.full((2, max(kinds) + 1, len(number) + 1, len(number) + 1), -1)
        for table, drives in ((leaves, leaving), (comes, coming)):
            for row, (body, a, b) in enumerate(drives):
                table[sorted(mine[body]), number[a], number[b]] = row
        seconds = np.full((len(leaving) + 1, len(coming) + 1), -1.0)
        rows, columns = ({d: n for n, d in enumerate(some)} for some in (leaving, coming))
        for (one, other), least in known.items():
            seconds[rows[one], columns[other]] = least
        likely = likely_handovers(known, self._shared)
        at = np.array([number[pose] for pose in stops])
        home = np.array([-1 if pose is None else number[pose] for pose in homes])
        return HandoverTables(at, home, leaves, comes, seconds, sectors([*number]), likely)

    def _way_home(self, option: WorkMode) -> float:
        """Return how long (s) it takes from where an option ends to where its robot is in nobody's
        way (negative: nobody has to go).
        """
        home = self.guess.home(option)
        if home is None or option.robot in self.guess.duties.ends:
            return -1.0
        return self.guess.ride(option.robot, option.exit, home)

    def _rides(
        self,
        options: Sequence[WorkMode],
        starts: Mapping[str, Configuration],
        number: Mapping[Configuration, int],
    ) -> tuple[list[int], FloatArray]:
        """Return which row of rides is each robot's, and those rides (kind, from, to; s): from
        where robots of a kind are at first, and where their jobs end, to where others begin and
        where they have to be in the end; between all of these, if some carry several loads at once.
        """
        kinds: dict[tuple[Body, float], list[str]] = {}
        for robot in self.robots:
            kinds.setdefault(self._kind(robot), []).append(robot)
        goals = self.guess.duties.ends
        rides = np.full((len(kinds), len(number), len(number)), np.inf)
        for kind, some in enumerate(kinds.values()):
            mine = [o for o in options if o.robot in some]
            ends = {goals[r] for r in some if r in goals}
            begin, end = {o.entry for o in mine}, {o.exit for o in mine}
            if not self.guess.duties.loads.keys().isdisjoint(some):
                begin = end = begin | end
            first = sorted({starts[r] for r in some} | end)
            for a, b in itertools.product(first, sorted(ends | begin)):
                rides[kind, number[a], number[b]] = self.guess.ride(some[0], a, b)
        order = {key: kind for kind, key in enumerate(kinds)}
        return [order[self._kind(robot)] for robot in self.robots], rides

    def _kind(self, robot: str) -> tuple[Body, float]:
        """Return what robots have in common that drive alike: a body, and a size of battery."""
        return self.guess.snapshot.objects[robot].body, self._battery(robot).full

    def _battery(self, robot: str) -> BatteryUse:
        return self.guess.duties.batteries.get(robot, BatteryUse(math.inf, 0.0))

    def charging(self, tours: Mapping[str, Sequence[Step]]) -> frozenset[Stop]:
        """Return who has to charge on a tour, with where that may be."""
        arrays, work = self.arrays(tours), self.work()
        rows = enumerate(zip(self.robots, arrays.tours, arrays.counts, strict=True))
        often = {robot: beside(work, r, *tour)[1] for r, (robot, *tour) in rows}
        some = filter(often.__getitem__, often)
        return frozenset((robot, pose) for robot in some for pose in self._battery(robot).given)

    def _cells(
        self,
        options: Sequence[WorkMode],
        kinds: Sequence[int],
        number: Mapping[Configuration, int],
        rides: FloatArray,
    ) -> BatteryTables:
        """Return what drives take from batteries, and how far chargers are out of the way. Drives
        that no robot makes take all that there is.
        """
        ride, told = self.guess.ride, self.guess.duties.taken
        taken, detour = np.zeros_like(rides), np.zeros_like(rides)
        batteries = [self._battery(robot) for robot in self.robots]
        for kind, robot in dict(zip(kinds, self.robots, strict=True)).items():
            battery = self._battery(robot)
            late = self.rules.late * battery.full  # where nobody can charge
            made = itertools.product(number.items(), repeat=2) if battery.full else ()
            for (a, i), (b, j) in made:
                taken[kind, i, j] = told.get((*self._kind(robot), a, b), battery.full * (i != j))
                by_way = (ride(robot, a, c) + ride(robot, c, b) for c in battery.given)
                detour[kind, i, j] = min(by_way, default=late) - ride(robot, a, b)
        uses = [
            math.fsum(told.get((*self._kind(o.robot), *leg), 0.0) for leg in o.legs)
            for o in options
        ]
        level, full, pace = np.array([(b.first, b.full, b.pace) for b in batteries]).T
        return BatteryTables(level, full, pace, np.array(uses), taken, detour)


def _columns(rows: Iterable[tuple[int, ...]]) -> IntArray:
    """Return the columns of rows, each as an array of its own."""
    return np.ascontiguousarray(np.array([*rows], dtype=np.int64).T)
