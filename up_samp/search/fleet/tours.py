"""Prioritised planning of many robots: whole tours, one robot after the other.

A robot's *tour* is all that it does until it stays somewhere for good. Tours are decided one after
the other, each among those decided before (prioritised planning; Erdmann and Lozano-Pérez 1987).
Within its tour a robot may stand at a place as long as nobody who is decided comes by there: the
stays that this leaves are searched depth first, the soonest first (safe intervals; Phillips and
Likhachev 2011). What is decided is thus never in the way of what is decided, and nobody starves: a
station that others visit later is free until then.

Where the floor is *well-formed* this never fails. Every tour begins and ends where a robot is in
nobody's way, and between any two places where robots stop there is a way past all others at such
ends. So in the worst case a robot waits at its start until all those before it have come to their
ends, and then drives alone (Čáp, Novák, Kleiner and Selecký, "Prioritized Planning Algorithms for
Trajectory Coordination of Multiple Mobile Robots", IEEE T-ASE 2015). Elsewhere it is a try.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from up_samp.model import (
    CandidateSchedule,
    Configuration,
    Deadline,
    Rest,
    TimedMotion,
    Trajectory,
    same_pose,
)
from up_samp.model.arrays import FloatArray
from up_samp.model.graphs import reached
from up_samp.motion.fleet.paths import Path, path_of
from up_samp.motion.fleet.reservations import ReservationTable
from up_samp.motion.fleet.timed_path import TimedPath, natural_timing, run_of
from up_samp.scheduling.partial_order import Earliest
from up_samp.search.fleet.right_of_way import Crossings, Driven
from up_samp.search.fleet.sequential import FleetSolution, ancestors
from up_samp.search.search import Search
from up_samp.search.world import contested, motion_key, others_first
from up_samp.upio import Itinerary

_PATIENCE = 1.3
"""Over a motion's time alone, up to which no other way is sought..."""
GRACE = 3.0
"""...and s more than that."""
_PAST = 2
"""Ways past the places where others stand, that are looked for first, for each motion."""
_TRIES = 200
"""Motions tried for one tour."""
_CLOSE = 8.0
"""Seconds after one robot may leave a place, within which the next one has waited for it."""
_TIGHT, _LOSES, _LOOKING = 0.5, 4.0, 20
"""s at most from one motion to the one behind it, and s that both lose at least if the other one
goes first: so many pairs of them look for ways past each other at once.
"""
_PRESSED = 0.8
"""Of the longest tour's time alone: who has less to spare is decided before others."""
NOT_AHEAD: Mapping[str, float] = MappingProxyType({})
"""Everybody's turn comes when it comes to the next place."""


class TourEnd(enum.Enum):
    """How the search for a tour, or for what is left of one, ended."""

    DECIDED = enum.auto()
    STUCK = enum.auto()
    LATE = enum.auto()
    """Something would be too late, whatever is tried from here on."""


class TourPlanner:
    """Tours that wait to be decided, and those that are: whole ones, robot by robot, or piece by
    piece in the order of time.

    Whole tours are not fair: who is decided last finds gaps only, and waits. In turns, whoever
    comes first to the next place that others need is decided next, until it stands where nobody
    else has to be. That is token passing (Ma, Li, Kumar and Koenig, "Lifelong multi-agent path
    finding for online pickup and delivery tasks", AAMAS 2017), with places of one's own as the
    endpoints where agents wait for the token.
    """

    def __init__(
        self, search: Search, itinerary: Itinerary, times: Earliest, homes: frozenset[str]
    ) -> None:
        self._facts, self._service = search.facts, search.motions.service
        self._itinerary, self._times = itinerary, times
        self._motions = {m.activity: m for m in itinerary.motions}
        self._waiting = dict(self._motions)
        self._must = ancestors(self._waiting, times)
        self._leave = others_first(self._facts, self._service, itinerary)
        self._floor = ReservationTable(self._service, self._rests())
        self._homes = homes
        self._chains: dict[str, list[str]] = defaultdict(list)
        for motion in itinerary.motions:
            self._chains[motion.object].append(motion.activity)
        own = {name: set(chain) for chain in self._chains.values() for name in chain}
        self._others = {n: (self._must[n] | self._leave[n]) - own[n] for n in own}
        """What others have to do before a motion."""
        self._dead: set[tuple[str, float]] = set()
        """Stays (motion, until) of the present tour from which there is no way on."""
        self._tries = 0
        self._contested = contested(search.facts, search.motions.service, itinerary)
        self._wait_apart()
        self._begun = times.state()
        self._ahead: Mapping[str, float] = {}
        self._looks = 0
        self._hard = True
        """Whether new ways are looked for where others stand in all that are known: not as long as
        somebody can go on without, for they are about to go on, too.
        """

    def _wait_apart(self) -> None:
        """Let who has to wait until something is released do so before, where nobody else has to
        be, if it comes by such a place: at a station it would keep others away for all that time.
        """
        released = self._times.released()
        for chain in self._chains.values():
            apart: str | None = chain[0]
            for name, then in itertools.zip_longest(chain, chain[1:]):
                wait = self._times.slack(name)
                if apart and wait > 0 and not released.isdisjoint(self._times.after(("end", name))):
                    self._times.raised({("start", apart): self._start(apart) + wait})
                    apart = None
                if name not in self._contested:
                    apart = then

    def set_off_later(self) -> None:
        """Let who would wait for others where somebody has to come by set off only once their
        motions are decided, unless these wait for it in turn: so it comes there after them.
        """
        chains = self._chains.values()
        waiting = {a: {b} for chain in chains for a, b in itertools.pairwise(chain)}
        for name, others in self._others.items():
            for other in others:
                waiting.setdefault(other, set()).add(name)
        for then, name in itertools.chain(*(itertools.pairwise(reversed(c)) for c in chains)):
            if name in self._contested:
                behind = reached([name], lambda one: waiting.get(one, ()))
                for other in self._others[then] - self._others[name] - behind:
                    self._others[name].add(other)
                    waiting.setdefault(other, set()).add(name)

    def schedule(self) -> CandidateSchedule:
        """Return the candidate with the times that its motions need."""
        old = self._itinerary.schedule
        at = self._times.times
        times = {name: (at["start", name], at["end", name]) for name in old.times}
        return CandidateSchedule(times, old.parameters)

    def _take(self, name: str, run: TimedPath) -> bool:
        """Decide a run, if its times keep what the problem asks."""
        facts = self._facts
        unit = facts.seconds(1)
        end = facts.units(run.arrival)
        start = max(self._start(name), int((run.timing.trajectory.start + 1e-6) // unit))
        for begin in (min(start, end), self._start(name)):
            pins = {("start", name): begin, ("end", name): max(end, self._end(name))}
            if self._times.raised(pins, pin=True):
                break
        else:
            return False
        self._floor.add(run)
        del self._waiting[name]
        return True

    def _start(self, name: str) -> int:
        return self._times.times["start", name]

    def _end(self, name: str) -> int:
        return self._times.times["end", name]

    def _timed(self, name: str) -> TimedMotion:
        """Return a motion as it is asked for now: good if it takes little more than alone."""
        return self._timed_as(name, self._facts.seconds(self._start(name)))

    def _timed_as(self, name: str, release: float) -> TimedMotion:
        """Return a motion as it is asked for from ``release`` (s) on."""
        facts, motion = self._facts, self._motions[name]
        least = facts.seconds(self._end(name) - self._start(name))
        return TimedMotion(
            name=name,
            object=motion.object,
            body=facts.body(motion),
            poses=motion.poses,
            release=release,
            due=release + _PATIENCE * least + GRACE,
            avoid=motion.avoid,
        )

    def _rests(self) -> list[Rest]:
        """Return everything that nobody changes on the way, where it is at first."""
        snapshot = self._facts.snapshot
        return [
            Rest(name, snapshot.objects[name].body, snapshot.configurations[place])
            for name, place in sorted(snapshot.initial.items())
            if name not in self._facts.instant
        ]

    def _place_changed(self, name: str) -> None:
        """Put doors where they are during a motion (see :func:`_beside_changes`)."""
        snapshot, motion = self._facts.snapshot, self._waiting[name]
        found = []
        for door in sorted(self._facts.instant):
            place = snapshot.initial[door]
            for change in self._itinerary.changes:
                if change.object == door and change.time < motion.end:
                    place = change.configuration
            found.append(Rest(door, snapshot.objects[door].body, snapshot.configurations[place]))
        self._floor.place(found)

    @property
    def robots(self) -> list[str]:
        """All robots that drive."""
        return sorted(self._chains)

    def learn_ways_past(self, deadline: Deadline) -> None:
        """Let all motions know ways past the places where others of these tours may stand."""
        bodies = {name: self._facts.body(motion) for name, motion in self._motions.items()}
        where = {(bodies[n].footprint, m.poses[-1]): n for n, m in sorted(self._motions.items())}
        stands = [(bodies[name], pose) for (_, pose), name in where.items()]
        for name in sorted(self._motions):
            if deadline.expired():
                return
            self._floor.learn_ways_past(self._timed_as(name, 0.0), stands, deadline, _PAST)

    def robot_of(self, name: str) -> str:
        """Return who makes a motion."""
        return self._motions[name].object

    def handovers(self, decided: FleetSolution) -> list[float]:
        """Return the times (s), ascending, from when one robot may leave a place that others need,
        too, to when the next one came there that has waited for it.
        """
        return sorted(gap for gap, _, _ in self._handovers(decided) if gap <= _CLOSE)

    def _handovers(self, decided: FleetSolution) -> Iterator[tuple[float, str, str]]:
        """Yield how long (s) after one robot may leave a place that others need, too, the next one
        came there, with the motions that brought them.
        """
        visits: dict[Configuration, list[tuple[float, float, str]]] = defaultdict(list)
        for chain in self._chains.values():
            for name, then in itertools.pairwise(chain):
                if name in self._contested and then in decided.pins:
                    left = self._facts.seconds(decided.pins[then][0])
                    arrival = decided.runs[name].arrival
                    visits[self._motions[name].poses[-1]].append((arrival, left, name))
        for some in visits.values():
            yield from (
                (max(0.0, arrival - left), one, other)
                for (_, left, one), (arrival, _, other) in itertools.pairwise(sorted(some))
                if self.robot_of(one) != self.robot_of(other)
            )

    def reset(self) -> None:
        """Let nothing be decided."""
        self._times.restore(self._begun)
        self._waiting = dict(self._motions)
        self._floor = ReservationTable(self._service, self._rests())

    def decided(self) -> FleetSolution:
        """Return what is decided, when all is."""
        runs = self._floor.trajectories()
        pins = {name: (self._start(name), self._end(name)) for name in runs}
        keys = {name: motion_key(motion) for name, motion in self._motions.items()}
        return FleetSolution(self.schedule(), runs, pins, keys, self._needless())

    def _needless(self) -> frozenset[str]:
        """Return the last motions, of those that may be left out, that nobody needs; the latest are
        left out first. They are not decided any more then.
        """
        runs = self._floor.trajectories()
        found = {name for name in self._waiting if name in self._homes}
        driven = self._homes & runs.keys()
        last = [c[-2:] for c in self._chains.values() if len(c) > 1 and c[-1] in driven]
        for before, name in sorted(last, key=lambda two: (-runs[two[1]].arrival, two)):
            arrival = runs[before].arrival
            here = self._timed_as(before, arrival)
            if any(a <= arrival and b == math.inf for a, b in self._floor.stays(here)):
                self._floor.withdraw(runs[name].object)
                found.add(name)
        return frozenset(found)

    def crossings(self, limit: int) -> Crossings:
        """Return what is to be decided so that all motions are over by ``limit`` (units), on the
        ways that are known.
        """
        self.reset()
        motions = {name: self._timed_as(name, 0.0) for name in self._motions}
        ways = {}
        for name, motion in motions.items():
            self._place_changed(name)
            ways[name] = self._floor.known_ways(motion, self._chains.keys())
        times, _ = self._begun

        def passing(one: str, path: Path, other: str, there: Path) -> FloatArray:
            return self._floor.passing(motions[one], path, motions[other], there)

        optional = frozenset(c[-1] for c in self._chains.values() if len(c) > 1) & self._homes
        chains, differences = dict(self._chains), self._times.differences
        unit = self._facts.seconds(1)
        return Crossings(chains, ways, optional, differences, times, unit, passing, limit)

    def coordinated(self, known: Driven, limit: int, deadline: Deadline) -> FleetSolution | None:
        """Return all tours decided at once, on the ways that are known, so that they are over by
        ``limit`` (units) at the latest; None where nothing was found.

        :param known: where the search begins.
        """
        driven = self.crossings(limit).decide(known, deadline)
        return None if driven is None else self.follow(driven)

    def as_planned(self, plan: Mapping[str, Trajectory]) -> FleetSolution | None:
        """Return what comes of it if all is driven as in a plan; None where that knows nothing of a
        motion, or is too late for what is asked now. Whether robots meet is for a judge to say.
        What is driven is a known way from then on.
        """
        driven: dict[str, tuple[Path, float]] = {}
        for name, motion in self._motions.items():
            own, asked = plan.get(motion_key(motion)), self._timed_as(name, 0.0)
            path = None if own is None else path_of(own, asked.body, decided=True)
            if own is not None and path is not None and _leads(path, asked):
                driven[name] = path, own.start
                self._floor.ways(asked).paths.setdefault(path.number, path)
        if self._motions.keys() - self._homes - driven.keys():
            return None
        return self.follow(driven, unseen=True)

    def follow(self, driven: Driven, *, unseen: bool = False) -> FleetSolution | None:
        """Return what comes of it if motions are made on such ways at such times, each as soon as
        it can be then; None where that does not keep what is asked.

        :param unseen: whether robots may meet, as somebody else will judge: cells are coarser than
            bodies.
        """
        self.reset()
        runs = {robot: self._planned(robot, driven) for robot in self.robots}
        numbers = {run.name: k for some in runs.values() for k, run in enumerate(some)}
        for name in sorted(driven, key=lambda name: (driven[name][1], name)):
            self._place_changed(name)
            mine, k, motion = runs[self.robot_of(name)], numbers[name], self._timed(name)
            others = [run for r, some in runs.items() if r != motion.object for run in some]
            later = mine[k + 1 :]
            then = min((run.timing.trajectory.start for run in later), default=math.inf)
            asked = replace(motion, present_from=mine[k].since, present_until=then)
            run = self._floor.sooner(asked, mine[k], others)
            if run.timing.trajectory.start < motion.release - 1e-6 or not self._take(name, run):
                return None
            mine[k : k + 2] = _one_after_the_other([run, *later[:1]])
        clear = unseen or all(map(self._floor.clear, runs.values()))
        return self.decided() if clear else None

    def _planned(self, robot: str, driven: Driven) -> list[TimedPath]:
        """Return a robot's runs on such ways at such times."""
        runs = []
        for name in filter(driven.__contains__, self._chains[robot]):
            path, start = driven[name]
            motion = self._timed_as(name, start)
            runs.append(run_of(motion, path, natural_timing(path, start)))
        return _one_after_the_other(runs)

    def past_each_other(
        self, decided: FleetSolution, limit: int, deadline: Deadline
    ) -> FleetSolution | None:
        """Return all tours decided at once again, over by ``limit`` (units) at the latest, after
        motions that meet on their way have looked for ways past each other; None where there are no
        new ones, or nothing was found. New ways that are of no use then are forgotten.
        """
        new = self._ways_past_each_other(decided, deadline)
        if not new:
            return None
        driven = self.crossings(limit).decide(decided.driven(), deadline)
        used = {path.number for path, _ in (driven or {}).values()}
        for name, path in new:
            if path.number not in used:
                del self._floor.ways(self._timed_as(name, 0.0)).paths[path.number]
        return None if driven is None else self.follow(driven)

    def _ways_past_each_other(
        self, decided: FleetSolution, deadline: Deadline
    ) -> list[tuple[str, Path]]:
        """Return new ways of motions, which are known ones from then on, past others that meet them
        on their way and make them lose most if they go first.
        """
        new, driven = list[tuple[str, Path]](), decided.driven()
        for one, other in self._close(driven)[:_LOOKING]:
            for name, there in ((one, other), (other, one)):
                motion, run = self._timed_as(name, 0.0), decided.runs[there]
                path = self._floor.learn_way_past(motion, driven[name][0], run, deadline)
                if path is not None:
                    new.append((name, path))
        return new

    def _close(self, driven: Driven) -> list[tuple[str, str]]:
        """Return the motions of which one drives right behind the other one where both come by,
        those first where that one has to be gone for longest.
        """

        def apart(pair: tuple[str, str]) -> float:
            (path, start), (there, then) = map(driven.__getitem__, pair)
            lasts, over = path.natural.duration, there.natural.duration
            return 2 * abs(then - start + (over - lasts) / 2) - lasts - over

        def loses(pair: tuple[str, str]) -> float:
            (path, start), (there, then) = map(driven.__getitem__, pair)
            one, other = (self._timed_as(name, 0.0) for name in pair)
            gaps, since = self._floor.passing(one, path, other, there)[:, :, 0, 0], then - start
            left = np.where(since >= gaps[:, 0], since - gaps[:, 0], -since - gaps[:, 1])
            return float(np.max(gaps[left < _TIGHT].sum(axis=1), initial=0.0))

        pairs = itertools.combinations(sorted(driven), 2)
        met = [p for p in pairs if len({*map(self.robot_of, p)}) > 1 and apart(p) < 0.0]
        lost = dict(zip(met, map(loses, met), strict=True))
        return sorted((p for p in met if lost[p] > _LOSES), key=lambda p: -lost[p])

    def decide_in_turns(
        self,
        deadline: Deadline,
        first: Sequence[str] = (),
        ahead: Mapping[str, float] = NOT_AHEAD,
        looks: int = 0,
    ) -> str | None:
        """Decide all tours piece by piece in the order of time; return None, or the robot that
        should have gone sooner.

        :param first: robots whose whole tours are decided before all others, in this order.
        :param ahead: by how much (s) a robot's turn comes sooner than it does to the next place.
        :param looks: how often other ways from pose to pose are looked for, if one is known.
        """
        self._ahead, self._looks, self._hard = ahead, looks, True
        for robot in first:
            if self._decide(self._stretch(robot), deadline) is TourEnd.LATE or deadline.expired():
                return robot
        asleep = set[str]()  # they found no way among what is decided
        self._hard = False
        while self._waiting:
            pieces = {r: self._piece(r) for r in self.robots if r not in asleep}
            ready = [(self._rank(r, piece), r) for r, piece in pieces.items() if piece]
            turn = min(ready, default=(math.inf, None))[1]
            end = TourEnd.STUCK if turn is None else self._decide(pieces[turn], deadline)
            if end is TourEnd.DECIDED:
                self._hard = False
                asleep.clear()
            elif not self._hard and (turn is None or end is TourEnd.LATE):
                self._hard = True
                asleep.clear()
            elif turn is None or end is TourEnd.LATE:
                return turn or next(r for r in self.robots if self._left(r))
            else:
                asleep.add(turn)
            if deadline.expired():
                return turn or self.robots[0]
        self._hard = True
        return None

    def _rank(self, robot: str, piece: Sequence[str]) -> float:
        """Return when a robot's turn comes (s): when it comes to the next place, or sooner."""
        return self._facts.seconds(self._end(piece[0])) - self._ahead.get(robot, 0.0)

    def _piece(self, robot: str) -> list[str]:
        """Return the next motions of a robot, up to the first that ends where no other one has to
        be: there it may stay until its turn comes again.
        """
        stretch = self._stretch(robot)
        own = [n for n, name in enumerate(stretch) if name not in self._contested]
        return stretch[: own[0] + 1] if own else stretch

    def ranked(self) -> list[str]:
        """Return all robots: those that may well be late, then the others; those with the least
        time to spare come first, until something of theirs has to be done or until all is done.
        """
        latest, times = self._times.latest(), self._times.times
        last = {r: times["end", chain[-1]] for r, chain in self._chains.items()}
        longest = max(last.values(), default=0)
        spare = {
            robot: min(latest["end", m] - times["end", m] for m in chain)
            for robot, chain in self._chains.items()
        }
        pressed = [r for r in last if spare[r] < _PRESSED * longest]
        pressed.sort(key=lambda r: (spare[r], r))
        others = sorted((r for r in last if r not in pressed), key=lambda r: (-last[r], r))
        return [*pressed, *others]

    def _left(self, robot: str) -> list[str]:
        """Return the motions of a robot that are not decided."""
        return [m for m in self._chains[robot] if m in self._waiting]

    def _stretch(self, robot: str) -> list[str]:
        """Return the next motions of a robot, up to the first that has to wait for one of another's
        that is not decided.
        """
        waiting = self._waiting.keys()
        free = itertools.takewhile(
            lambda name: waiting.isdisjoint(self._others[name]), self._left(robot)
        )
        return list(free)

    def _decide(self, stretch: Sequence[str], deadline: Deadline) -> TourEnd:
        """Decide a robot's next motions, all or none."""
        self._dead.clear()
        self._tries = 0
        return self._drive(stretch, deadline)

    def _drive(self, stretch: Sequence[str], deadline: Deadline) -> TourEnd:
        """Decide motions one after the other, the soonest stays first."""
        if not stretch:
            return TourEnd.DECIDED
        name, rest = stretch[0], stretch[1:]
        motion = self._timed(name)
        self._place_changed(name)
        for since, until in self._floor.stays(motion):
            if (rest and (name, until) in self._dead) or (not rest and until < math.inf):
                continue
            if max(since, motion.release + self._least(name)) + self._stay(stretch) > until:
                continue
            end = self._stop(stretch, since, until, deadline)
            if end is not TourEnd.STUCK or deadline.expired() or self._tries > _TRIES:
                return end
        return TourEnd.STUCK

    def _stop(
        self, stretch: Sequence[str], since: float, until: float, deadline: Deadline
    ) -> TourEnd:
        """Decide motions of which the first ends in a stay (s)."""
        name, rest = stretch[0], stretch[1:]
        run = self._run(name, since, until, deadline)
        if run is None:
            return TourEnd.STUCK
        motion, before = self._motions[name], self._times.state()
        if not self._take(name, run):
            return TourEnd.LATE
        end = TourEnd.STUCK
        if not rest or self._facts.seconds(self._start(rest[0])) <= until:
            end = self._drive(rest, deadline)
        if end is not TourEnd.DECIDED:
            # whoever comes there later can leave no sooner
            self._dead.add((name, until))
            self._floor.withdraw(motion.object)
            self._times.restore(before)
            self._waiting[name] = motion
        return end

    def _run(self, name: str, since: float, until: float, deadline: Deadline) -> TimedPath | None:
        """Return a run that ends in a stay (s), if one is found."""
        self._tries += 1
        motion = self._timed(name)
        due = max(motion.due, since + GRACE)
        asked = replace(motion, present_until=until, due=due)
        ways = self._floor.ways(asked)
        best = self._floor.by_known_ways(asked)
        if best is None and self._hard:
            best = self._floor.past_all_ends(asked, deadline)
        hard = best is None and until == math.inf and self._hard
        most = self._looks + hard
        if ways.looks < most and (best is None or best.arrival > due):
            ways.looks += 1
            best = self._floor.by_proposed_way(asked, best)
            best = best or self._floor.plan(asked, deadline).run
        if best is None or best.arrival > until:
            return None
        ways.paths.setdefault(best.path.number, best.path)
        return best

    def _stay(self, stretch: Sequence[str]) -> float:
        """Return how long (s) a robot stays at least where its first of some motions ends."""
        if len(stretch) < 2:
            return 0.0
        return self._facts.seconds(self._start(stretch[1]) - self._end(stretch[0]))

    def _least(self, name: str) -> float:
        """Return the least time (s) that a motion takes."""
        return self._facts.seconds(self._end(name) - self._start(name))


def _leads(path: Path, motion: TimedMotion) -> bool:
    """Return whether a path begins and ends where a motion does."""
    return all(map(same_pose, path.ends, (motion.poses[0], motion.poses[-1])))


def _one_after_the_other(runs: Sequence[TimedPath]) -> list[TimedPath]:
    """Return the runs of one object, of which each is there from when the last one ended."""
    if not runs:
        return []
    ends = [runs[0].since, *(run.arrival for run in runs)]
    ends[-1] = runs[-1].until
    return [
        replace(run, since=since, until=until)
        for run, (since, until) in zip(runs, itertools.pairwise(ends), strict=True)
    ]
