"""What everybody's day takes if places are taken in turns: a rehearsal without motions.

A place that several robots work at is taken by one of them at a time, the one that comes first; the
next one comes when it has left (list scheduling of a unary resource). Whoever ends at a place where
others come later has to go on from there. Aisles, and who waits where, are left out: it is a guess.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from up_samp.geometry.memory import Memory
from up_samp.model import Configuration
from up_samp.search.guesses import Guess
from up_samp.search.jobs import Jobs, Option
from up_samp.search.tuning import DealsTuning

Step = tuple[int, int]
"""A job and which of its options is taken."""
Stop = tuple[float, Configuration | None, float, float]
"""How long (s) a robot drives to a place where others work, too (None: nobody does), how long it
works there, and when it has to be done (s).
"""


@dataclass(frozen=True)
class Day:
    """What a robot does: ``stops``, and a way ``home`` (s) if others need the ``last`` place."""

    stops: tuple[Stop, ...]
    last: Configuration | None
    home: float


@dataclass
class Rehearsal:
    """Days of robots that have jobs to do.

    :param bias: what a step is taken to cost more or less than guessed (share).
    """

    guess: Guess
    jobs: Jobs
    tuning: DealsTuning
    bias: Mapping[Step, float] = field(default_factory=dict)
    _days: Memory[Day] = field(default_factory=lambda: Memory(5_000))

    def __post_init__(self) -> None:
        jobs = Counter[Configuration]()
        for options in self.jobs.options:
            jobs.update({pose for option in options for pose in stops_of(option)})
        self._shared = {pose for pose, many in jobs.items() if many > 1}

    def weight(self, tours: Mapping[str, Sequence[Step]]) -> float:
        """Return what a share of all jobs is worth: less is better."""
        steep = self.tuning.steep
        ends = self.ends(tours)
        return math.fsum((end + self.tuning.late * late) ** steep for end, late in ends.values())

    def ends(self, tours: Mapping[str, Sequence[Step]]) -> dict[str, tuple[float, float]]:
        """Return when (s) each robot has done its jobs, and by how much it is late in all."""
        days = {robot: self.day(robot, tour) for robot, tour in tours.items()}
        free: dict[Configuration, float] = {}
        last: dict[Configuration, str] = {}
        found = dict.fromkeys(days, (0.0, 0.0))
        queue = [(day.stops[0][0], robot, 0) for robot, day in days.items() if day.stops]
        heapq.heapify(queue)
        while queue:
            came, robot, number = heapq.heappop(queue)
            stops = days[robot].stops
            _, place, stay, due = stops[number]
            if place is None:
                done = came + stay
            else:
                begin = came if last.get(place) == robot else max(came, free.get(place, 0.0))
                done = begin + stay
                free[place] = done + self.tuning.handover
                last[place] = robot
            # traffic takes time, too
            late = max(0.0, self.tuning.traffic * done - due) if due < math.inf else 0.0
            found[robot] = done, found[robot][1] + late
            if number + 1 < len(stops):
                heapq.heappush(queue, (done + stops[number + 1][0], robot, number + 1))
        for robot, day in days.items():
            if day.last is not None and last.get(day.last) != robot:
                found[robot] = found[robot][0] + day.home, found[robot][1]
        return found

    def alone(self, robot: str, tour: Sequence[Step]) -> tuple[float, float]:
        """Return when (s) a robot would have done its jobs without others, and how late it is."""
        return self.ends({robot: tour})[robot]

    def day(self, robot: str, tour: Sequence[Step]) -> Day:
        """Return what a robot does that has a tour of jobs to do."""
        key = robot, tuple(tour), self.guess.rounds
        return self._days.get_or(key, lambda: self._day(robot, tour))

    def _day(self, robot: str, tour: Sequence[Step]) -> Day:
        snapshot, ride = self.guess.snapshot, self.guess.ride
        here = snapshot.configurations[snapshot.initial[robot]]
        stops: list[Stop] = []
        on_the_way = 0.0
        option: Option | None = None
        for step in tour:
            option = self.jobs.options[step[0]][step[1]]
            places = stops_of(option)
            drives = [ride(robot, here, option.entry), *(ride(robot, a, b) for a, b in option.legs)]
            more = self.bias.get(step, 0.0) * (option.work + sum(drives[1:]))
            each = (option.work + self.guess.pause(option) + more) / len(places)
            last = len(places) - 1
            for number, (drive, place) in enumerate(zip(drives, places, strict=True)):
                if place in self._shared or (number == last and option.due < math.inf):
                    due = option.due * snapshot.seconds_per_unit if number == last else math.inf
                    shared = place if place in self._shared else None
                    stops.append((on_the_way + drive, shared, each, due))
                    on_the_way = 0.0
                else:
                    on_the_way += drive + each
            here = option.exit
        if on_the_way > 0.0:
            stops.append((on_the_way, None, 0.0, math.inf))
        home = None if option is None else self.guess.home(option)
        if home is None or here not in self._shared:
            return Day(tuple(stops), None, 0.0)
        return Day(tuple(stops), here, ride(robot, here, home))


def stops_of(option: Option) -> list[Configuration]:
    """Return where the work of an option is done: where it is entered, and where its legs end."""
    return [option.entry, *(b for _, b in option.legs)]
