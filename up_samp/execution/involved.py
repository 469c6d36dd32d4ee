"""Which activities need an object, however the problem says so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.motion import MovableObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.execution.substitute import names_in
from up_samp.upio.whereabouts import brought, whereabouts


class Involved:
    """Who needs whom in a problem. An activity needs an object if

    - it moves it, or a condition or effect of it speaks of it;
    - a condition or effect of it speaks of a fluent that tells where the object is;
    - it takes at its start what every drive of the object takes, and no other object's drive;
    - it is kept apart from every drive of the object, pair by pair, and so of no other object.

    Names of activities say nothing. ``told`` are the fluents that tell where objects are.
    """

    def __init__(
        self, problem: SchedulingMotionProblem, told: Mapping[FNode, str] | None = None
    ) -> None:
        self.told = whereabouts(problem) if told is None else told
        self.moved = {a.name: frozenset(brought(a)) for a in problem.activities}
        self._of = {
            a.name: {*self.moved[a.name], *(who for n in _spoken(a) for who in self.about(n))}
            for a in problem.activities
        }
        drives: dict[str, set[str]] = {}
        for activity in problem.motion_activities:
            for constraint in activity.motion_constraints:
                for who in self.moved[activity.name] & _objects(constraint.movable):
                    drives.setdefault(who, set()).add(activity.name)
        driving = set().union(*drives.values())
        for takers in _takers(problem).values():
            whole = _whole(takers, drives)
            others = [d for d in drives if d not in whole and drives[d] & takers]
            for name in takers - driving if len(whole) == 1 and not others else ():
                self._of[name] |= whole
        for name, rivals in _rivals(problem).items():
            whole = _whole(rivals, drives)
            if name not in driving and len(whole) == 1:
                self._of[name] |= whole

    def needs(self, activity: str, name: str) -> bool:
        """Return whether an activity needs an object."""
        return name in self._of.get(activity, ())

    def moves(self, activity: str, name: str) -> bool:
        """Return whether an activity drives an object or puts it elsewhere."""
        return name in self.moved.get(activity, ())

    def about(self, node: FNode) -> frozenset[str]:
        """Return the movable objects that an expression speaks of, or of whose whereabouts."""
        return _objects(node) | {self.told[n] for n in _parts(node) if n in self.told}


def _spoken(activity: Activity) -> Iterator[FNode]:
    for nodes in activity.conditions.values():
        yield from nodes
    for effects in activity.effects.values():
        yield from (e.fluent for e in effects)


def _parts(node: FNode) -> Iterator[FNode]:
    stack = [node]
    while stack:
        item = stack.pop()
        yield item
        stack += item.args


def _objects(node: FNode) -> frozenset[str]:
    objects = (n.object() for n in _parts(node) if n.is_object_exp())
    return frozenset(o.name for o in objects if isinstance(o, MovableObject))


def _takers(problem: SchedulingMotionProblem) -> dict[FNode, set[str]]:
    """Return which activities change a fluent as they start."""
    found: dict[FNode, set[str]] = {}
    for activity in problem.activities:
        for timing, effects in activity.effects.items():
            for effect in effects if timing.is_from_start() else ():
                found.setdefault(effect.fluent, set()).add(activity.name)
    return found


def _rivals(problem: SchedulingMotionProblem) -> dict[str, set[str]]:
    """Return by activity those that are kept apart from it, by a constraint on just the two that
    speaks of the start and the end of both.
    """
    found: dict[str, set[str]] = {}
    owners: list[tuple[str | None, Any]] = [(None, problem._base)]
    owners += [(a.name, a) for a in problem.activities]
    for owner, chronicle in owners:
        for constraint, _ in chronicle._constraints:
            pair = names_in(constraint) | ({owner} if owner else set())
            points = {
                (n.timing().timepoint.container or owner, n.timing().is_from_start())
                for n in _parts(constraint)
                if n.is_timing_exp()
            }
            if len(pair) == 2 and len(points) == 4:
                for name in pair:
                    found.setdefault(name, {name}).update(pair)
    return found


def _whole(members: set[str], drives: Mapping[str, set[str]]) -> set[str]:
    """Return the objects of which every drive is among some activities."""
    return {who for who, mine in drives.items() if mine <= members}
