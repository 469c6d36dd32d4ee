"""All that one robot may do, one after the other, where it surely is then, and the units that it
loses in between: for proofs.
"""

from __future__ import annotations

from collections import ChainMap, defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from unified_planning.model import Effect, FNode, Timing
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search.fleet.jobs import Gaps, closed, idle_between, stand_told
from up_samp.upio.expressions import asks_at_start, own_end
from up_samp.upio.movers import changes_of, whereabouts

# ------------------ Where robots surely are when activities start
# ``search/fleet/jobs.py`` takes each fluent that tells where a robot is. Here it is made sure that
# no drive fails to set it, at its very end, and that it is right from the beginning.


@dataclass(frozen=True)
class GuaranteedLocations:
    """``places``: by activity and robot where the robot is when the activity starts, if no drive of
    it is under way then. ``fluents`` tell that; an activity ``sets`` some of them at its very end,
    and ``reads`` some at its very start.
    """

    fluents: frozenset[str]
    places: Mapping[tuple[str, str], str]
    sets: Mapping[str, frozenset[str]]
    reads: Mapping[str, frozenset[str]]


def guaranteed_locations(
    problem: SchedulingMotionProblem, snapshot: Snapshot
) -> GuaranteedLocations:
    """Return what is sure about where robots are.

    Assumes: a fluent is set at the end of every drive of a robot, to where that leads, and never
    else.
    """
    whose = _surely_told(problem, snapshot)
    places: dict[tuple[str, str], str] = {}
    sets: dict[str, set[str]] = defaultdict(set)
    reads: dict[str, set[str]] = defaultdict(set)
    text = {fluent: str(fluent) for fluent in whose}
    for activity in problem.activities if whose else ():
        for condition, at_once in asked_at_start(activity):
            stand = stand_told(condition, whose)
            if stand is not None:
                places[activity.name, stand[0]] = stand[1]
                seen = condition.args if at_once else ()
                reads[activity.name] |= {text[a] for a in seen if a in whose}
        for timing, effects in activity.effects.items():
            if own_end(timing, activity) == (True, 0):
                sets[activity.name] |= {text[e.fluent] for e in effects if e.fluent in whose}
    return GuaranteedLocations(frozenset(text.values()), places, _frozen(sets), _frozen(reads))


def _frozen(sets: Mapping[str, set[str]]) -> Mapping[str, frozenset[str]]:
    return {name: frozenset(some) for name, some in sets.items()}


def _surely_told(problem: SchedulingMotionProblem, snapshot: Snapshot) -> Mapping[FNode, str]:
    """Return the fluents that are set to a robot's place whenever it has come there, at the end of
    its drive (or a unit before), and never otherwise. It comes nowhere but by drives.
    """
    drives = _drives(snapshot)
    assigned, loose = changes_of(problem)
    wild = loose.union(
        fluent.fluent()
        for fluent, changes in assigned.items()
        if not all(e.value.is_object_exp() and plainly_at_end(a, t, e) for a, t, e in changes)
    )
    found: dict[FNode, str] = {}
    for fluent, robot in whereabouts(problem).items():
        start = problem.initial_value(fluent)
        here = start.is_object_exp() and start.object().name == snapshot.initial[robot]
        if not here or robot not in drives or fluent.fluent() in wild:
            continue
        if drives[robot] == {
            (a.name, e.value.object().name) for a, _, e in assigned.get(fluent, ())
        }:
            found[fluent] = robot
    return found


def _drives(snapshot: Snapshot) -> dict[str, set[tuple[str, str]]]:
    """Return by robot the activities that drive it, with where they end; no robot that is moved
    otherwise, or drives to where is not known, or twice in one activity.
    """
    other = set(snapshot.moved_otherwise)
    found: dict[str, set[tuple[str, str]]] = defaultdict(set)
    tasks: dict[str, list[str]] = defaultdict(list)
    for task in snapshot.tasks:
        if task.terms[-1].kind is not TermKind.CONSTANT:
            other.add(task.object)
        found[task.object].add((task.activity, task.terms[-1].name))
        tasks[task.object].append(task.activity)
    twice = {robot for robot, names in tasks.items() if len(names) > len(set(names))}
    return {robot: ways for robot, ways in found.items() if robot not in other | twice}


def asked_at_start(activity: Activity) -> Iterator[tuple[FNode, bool]]:
    """Yield what has to hold right when an activity starts, and whether it has to at that very
    instant (else at the next one).
    """
    for interval, conditions in activity.conditions.items():
        if asks_at_start(interval, activity, least(activity.duration)):
            yield from ((condition, not interval.is_left_open()) for condition in conditions)


def plainly_at_end(activity: Activity, timing: Timing, effect: Effect) -> bool:
    """Return whether an effect sets a ground fluent whenever an activity ends, or a unit before."""
    at_end = own_end(timing, activity) in ((True, 0), (True, -1))
    plain = at_end and effect.is_assignment() and effect.condition.is_true()
    return plain and all(a.is_object_exp() for a in effect.fluent.args)


# ------------------ What one robot does in turn, and the units that it loses in between


@dataclass(frozen=True)
class TimelineStop:
    """Where a robot is when an activity begins and when it ends, one of some places (None:
    somewhere). ``drives``: the activity drives it. ``setting``: what it sets at its end, which
    others that are ``reading`` it at their start see a unit later. ``loose``: its drive begins
    where one of the fluents ``reading`` says.
    """

    begins: frozenset[str] | None
    ends: frozenset[str] | None
    drives: bool = False
    loose: bool = False
    setting: frozenset[str] = frozenset()
    reading: frozenset[str] = frozenset()


class RobotTimeline:
    """What one robot does in turn: its ``stops`` by activity, with the ``gaps`` that are told."""

    def __init__(self, stops: Mapping[str, TimelineStop], gaps: dict[tuple[str, str], int]) -> None:
        self.stops, self._gaps = stops, gaps
        self._ending, self._beginning = (
            _by_place({name: stop.ends for name, stop in stops.items()}),
            _by_place({name: stop.begins for name, stop in stops.items()}),
        )

    def idle(self, members: frozenset[str]) -> int:
        """Return units in which the robot does nothing, right before or after some activities that
        are all present if one of them is.

        What comes after a drive is counted there, and not before what follows it.
        """
        told = ChainMap(closed(self._gaps, members), self._gaps)
        total = 0
        for name in sorted(members & self.stops.keys()):
            stop = self.stops[name]
            before = self._near(self._ending, stop.begins)
            total += idle_between(name, before, members, told, self._unless_driven, after=False)
            if stop.drives:
                then = self._near(self._beginning, stop.ends)
                total += idle_between(name, then, members, told, self.gap, after=True)
        return total

    def gap(self, first: str, then: str) -> int:
        """Return units between two activities, of which the second comes right after the first."""
        one, two = self.stops[first], self.stops[then]
        told = self._gaps.get((first, then), 0)
        if not one.setting & two.reading:
            return told
        # a drive that begins where a fluent says may read the older value, if that is the same
        same = two.loose and (one.begins is None or one.ends is None or bool(one.begins & one.ends))
        return told if same else max(told, 1)

    def _unless_driven(self, first: str, then: str) -> int:
        return 0 if self.stops[first].drives else self._gaps.get((first, then), 0)

    def _near(
        self, table: Mapping[str | None, list[str]], places: frozenset[str] | None
    ) -> Collection[str]:
        if places is None:
            return sorted(self.stops)
        return dict.fromkeys(n for place in (*sorted(places), None) for n in table.get(place, ()))


def _by_place(places: Mapping[str, frozenset[str] | None]) -> dict[str | None, list[str]]:
    found: dict[str | None, list[str]] = defaultdict(list)
    for name in sorted(places):
        some = places[name]
        for place in (None,) if some is None else sorted(some):
            found[place].append(name)
    return found


# ------------------ What a robot has to end before it begins anything else
# It carries one thing at a time. A Boolean fluent says that the robot is free. Whoever takes
# something asks for that and ends it, whoever gives it away brings it back. So between taking a
# thing and giving it away nothing else is taken or given.


def carried(
    problem: SchedulingMotionProblem, needs: Mapping[str, frozenset[str]], gaps: Gaps
) -> dict[str, tuple[str, FNode]]:
    """Return by activity that gives something away which one takes it, and the fluent that says
    that nothing else is taken or given in between (by those who set that fluent, if they are done
    one after the other).
    """
    takers, givers = defaultdict[FNode, set[str]](set), defaultdict[FNode, set[str]](set)
    wild = {effect.fluent.fluent().name for _, effect in problem.base_effects}
    for activity in problem.activities:
        asked = {condition for condition, at_once in asked_at_start(activity) if at_once}
        for fluent, value in _set(activity):
            if value is None or (value is False and fluent not in asked):
                wild.add(fluent.fluent().name)
            (givers if value else takers)[fluent].add(activity.name)
    found: dict[str, tuple[str, FNode]] = {}
    for fluent, giving in givers.items():
        pairs = {
            giver: taker
            for giver in giving
            for taker in needs.get(giver, frozenset()) & takers[fluent]
            if giver in needs.get(taker, frozenset()) and (taker, giver) in gaps
        }
        each = len(pairs) == len(giving) == len(takers[fluent]) == len(set(pairs.values()))
        if each and not giving & takers[fluent] and fluent.fluent().name not in wild:
            found |= {giver: (taker, fluent) for giver, taker in pairs.items()}
    return found


def _set(activity: Activity) -> Iterator[tuple[FNode, bool | None]]:
    """Yield the Boolean fluents that an activity sets at its end (or a unit before), and to what;
    None: to something else, or otherwise.
    """
    for timing, effects in activity.effects.items():
        for effect in effects:
            if not effect.fluent.type.is_bool_type():
                continue
            plain = effect.value.is_bool_constant() and plainly_at_end(activity, timing, effect)
            yield effect.fluent, effect.value.bool_constant_value() if plain else None
