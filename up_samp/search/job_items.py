"""Jobs as what robots do at places, where nothing tells how they come there.

Where it is not told which drives belong to a job, it is still told where its parts are done. Each
part follows another one, or the robot's start, and from one place to the next the robot has to
drive somehow. So each part is looked at as a job of its own, done in one of the ways of its robots.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model.deadline import check_time
from up_samp.search.carrying import carried
from up_samp.search.job_ways import Way
from up_samp.search.job_work import Work
from up_samp.search.jobs import Jobs, Option
from up_samp.search.lines import Line

Part = tuple[tuple[str, ...], str, str]
"""Activities that follow each other, where they begin and where they end."""


def items_of(
    problem: SchedulingMotionProblem,
    jobs: Jobs,
    work: Work,
    counted: Sequence[Sequence[Option]],
) -> list[Way] | None:
    """Return the ways to do all parts of some jobs, numbered anew; None where it is not known where
    some part is done, or a robot does several things at a time.

    Assumes: where all parts of a job are done is told, and its robot does one thing at a time.
    """
    taken = _Taken(jobs, carried(problem, jobs.needs, work.gaps))
    found: list[Way] = []
    number = 0
    for options in counted:
        check_time()
        split = _alike([_parts(work, option, taken) for option in options])
        if split is None:
            split = _alike([_parts(work, option, None) for option in options])
        if split is None:
            return None
        for option, parts in zip(options, split, strict=True):
            line = work.lines[option.robot]
            assert line is not None
            for at, part in enumerate(parts):
                idle = line.idle(option.members) if at == 0 else 0
                found.append(_way(work, option.robot, number + at, part, idle))
        number += len(split[0])
    return _with_origins(work, found)


def _alike(split: Sequence[list[Part] | None]) -> list[list[Part]] | None:
    """Return the parts of all options of a job if they are as many; None where they are not."""
    known = [parts for parts in split if parts is not None]
    same = len(known) == len(split) and len({len(parts) for parts in known}) == 1
    return known if same else None


def _with_origins(work: Work, ways: Sequence[Way]) -> list[Way]:
    """Return each way once, with the places where its kind of robots may come from."""
    places = defaultdict[int, set[str]](set)
    for kind, place in work.fleet.starts:
        places[kind].add(place)
    for way in ways:
        places[way.kind].update(way.ends)
    return [way.from_places(places[way.kind]) for way in dict.fromkeys(ways)]


class _Taken:
    """What is taken by which activity and given away by which other one."""

    def __init__(self, jobs: Jobs, pairs: Mapping[str, tuple[str, object]]) -> None:
        self.pairs = pairs
        self._mine = defaultdict[str, set[str]](set)
        for options in jobs.options:
            for option in options:
                self._mine[option.robot] |= option.members

    def one(self, line: Line, option: Option) -> bool:
        """Return whether an option is to take something and to give it away, and nothing else that
        its robot does for jobs can be in between.
        """
        given = [name for name in option.members if name in self.pairs]
        if len(option.members) != 2 or len(given) != 1:
            return False
        taker, fluent = self.pairs[given[0]]
        alike = {
            name
            for giver, (other, said) in self.pairs.items()
            if said == fluent
            for name in (giver, other)
        }
        mine = self._mine[option.robot]
        return taker in option.members and mine <= alike <= line.stops.keys()


def _parts(work: Work, option: Option, taken: _Taken | None) -> list[Part] | None:
    """Return the parts of an option, as far as constraints tell in their order."""
    line = work.lines.get(option.robot)
    if line is None or not option.members <= line.stops.keys():
        return None
    before = {n: sum((m, n) in work.gaps for m in option.members) for n in option.members}
    order = sorted(option.members, key=lambda n: (before[n], n))
    if taken is not None and taken.one(line, option):
        order.sort(key=lambda n: n in taken.pairs)
        one, two = (_place(line, (n,)) for n in order)
        return None if one is None or two is None else [(tuple(order), one[1], two[2])]
    parts = [_place(line, (name,)) for name in order]
    return None if None in parts else [part for part in parts if part is not None]


def _place(line: Line, names: tuple[str, ...]) -> Part | None:
    stop = line.stops[names[0]]
    if stop.begins is None or stop.ends is None or len(stop.begins) != 1 or len(stop.ends) != 1:
        return None
    return names, min(stop.begins), min(stop.ends)


def _way(work: Work, robot: str, job: int, part: Part, idle: int) -> Way:
    names, start, goal = part
    body = work.body(robot)
    busy = idle + sum(work.standing(name) for name in names)
    legs = ((body, start, goal),) if start != goal else ()
    return Way(job, work.fleet.kind_of[robot], busy, legs, body, start, (goal,), frozenset({goal}))
