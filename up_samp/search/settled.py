"""What surely rests where while a motion lasts: doors that its own robot has come through, say.

A door that is opened and never shut again is open for good. Whoever is at a place to which no way
leads while the door is shut has come through it, so whenever it leaves that place the door is open.
A door that is a static obstacle and would block the way is open from the motion's start on. Cuts
that hold while such a door stands open then hold always.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.search.cases import MotionCase
from up_samp.search.facts import Facts

if TYPE_CHECKING:
    from up_samp.motion import MotionService

Where = Mapping[MotionTask, Mapping[str, str]]
"""Motions -> objects, and where they surely are from its start to its end."""


def surely_there(facts: Facts, service: MotionService) -> Where:
    """Return what surely rests where all through each motion: what its driver has come through, and
    static obstacles that it would not get past elsewise.

    Assumes: a thing is moved to one other place only, and a driver comes to places by its drives
    alone.
    """
    snapshot = facts.snapshot
    found: dict[MotionTask, dict[str, str]] = {}
    for thing, then in _once_and_for_all(facts):
        for driver in sorted(facts.drivers):
            tasks = [t for t in snapshot.tasks if t.object == driver]
            if any(t.kind is not TermKind.CONSTANT for task in tasks for t in task.terms):
                continue
            shut = [task for task in tasks if _is_shut(facts, service, task, thing)]
            for task in _from_behind(snapshot, driver, tasks, shut):
                found.setdefault(task, {})[thing] = then
            for task in shut:
                if thing in (task.static or ()):
                    found.setdefault(task, {})[thing] = then
    return found


def _from_behind(
    snapshot: Snapshot, driver: str, tasks: list[MotionTask], shut: list[MotionTask]
) -> list[MotionTask]:
    """Return the motions of a driver that begin where it only comes to by those that are shut at
    first; none where something else may take it elsewhere.
    """
    other = snapshot.moved_otherwise
    once = len({t.activity for t in tasks}) == len(tasks)
    if driver in other or not once:
        return []
    ends = {task: (task.terms[0].name, task.terms[-1].name) for task in tasks}
    passable = {ends[t] for t in set(tasks).difference(shut)}
    ways = set(ends.values())
    behind = sealed(snapshot.initial[driver], ways, ways - passable)
    return [task for task in tasks if ends[task][0] in behind]


def sealed(
    first: str, ways: Collection[tuple[str, str]], shut: Collection[tuple[str, str]]
) -> set[str]:
    """Return the places to which nobody comes from ``first`` on but by a way that is ``shut`` at
    first, at one step or another.
    """
    reached, todo = {first}, [first]
    while todo:
        here = todo.pop()
        after = {b for a, b in ways if a == here and (a, b) not in shut} - reached
        reached |= after
        todo += sorted(after)
    return {place for way in ways for place in way} - reached


def remaining(places: Mapping[str, str], case: MotionCase, there: Where) -> dict[str, str]:
    """Return which of the ``places`` (object -> configuration) do not go without saying while the
    motion of a case lasts.
    """
    sure = there.get(case.task, {})
    return {name: place for name, place in places.items() if sure.get(name) != place}


def _once_and_for_all(facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield objects that change their configuration for one other only, with that."""
    snapshot = facts.snapshot
    for thing in sorted(facts.instant):
        terms = [c.term for c in snapshot.changes if c.object == thing]
        names = {t.name for t in terms}
        if all(t.kind is TermKind.CONSTANT for t in terms) and len(names) == 1:
            (then,) = names
            if then != snapshot.initial[thing]:
                yield thing, then


def _is_shut(facts: Facts, service: MotionService, task: MotionTask, thing: str) -> bool:
    """Return whether it is proven that a motion cannot be made before a thing is moved."""
    if task.avoid is not None and thing not in task.avoid:
        return False
    closed = facts.placed(thing, facts.snapshot.initial[thing])
    body = facts.snapshot.body(task.activity, task.index, task.object)
    poses = tuple(facts.snapshot.configurations[t.name] for t in task.terms)
    if body.flies or closed.body.flies:
        return False
    return service.certificate(body, poses, (closed,)) is not None
