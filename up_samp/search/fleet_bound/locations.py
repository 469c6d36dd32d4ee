"""Where robots surely are when activities start: for proofs.

:mod:`up_samp.search.fleet.jobs` takes each fluent that tells where a robot is. Here it is made sure
that no drive fails to set it, at its very end, and that it is right from the beginning.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from unified_planning.model import Effect, FNode, Timing
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.scheduling.cpsat.encode.numbers import least
from up_samp.search.fleet.jobs import stand_told
from up_samp.upio.spans import asks_at_start, own_end
from up_samp.upio.whereabouts import changes_of, whereabouts


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
