"""What surely rests where whenever a motion begins: doors that its own robot has come through.

A door that is opened and never shut again is open for good. Whoever is at a place to which no way
leads while the door is shut has come through it, so whenever it leaves that place the door is open.
Cuts that hold while an open door stands in the way then hold always.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.search.cases import MotionCase
from up_samp.search.facts import Facts

if TYPE_CHECKING:
    from up_samp.motion import MotionService

Where = Mapping[tuple[str, str], Mapping[str, str]]
"""(driver, place that it leaves) -> objects, and where they surely are then."""


def surely_there(facts: Facts, service: MotionService) -> Where:
    """Return what surely rests where whenever a driver leaves a place."""
    snapshot = facts.snapshot
    found: dict[tuple[str, str], dict[str, str]] = {}
    for thing, then in _once_and_for_all(facts):
        for driver in sorted(facts.drivers):
            ways = _ways(snapshot, driver)
            if ways is None:
                continue
            shut = {pair for pair, tasks in ways.items() if _all_shut(facts, service, tasks, thing)}
            for place in sealed(snapshot.initial[driver], ways, shut):
                found.setdefault((driver, place), {})[thing] = then
    return found


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
    """Return which of the ``places`` (object -> configuration) do not go without saying when the
    motion of a case begins.
    """
    sure = there.get((case.task.object, case.configurations[0]), {})
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


def _ways(snapshot: Snapshot, driver: str) -> dict[tuple[str, str], list[MotionTask]] | None:
    """Return a driver's motions by (from, to); None where something else may take it elsewhere, or
    its ways hang on decisions.
    """
    tasks = [t for t in snapshot.tasks if t.object == driver]
    other = {c.object for c in snapshot.changes} | {r.load for r in snapshot.rides}
    once = len({t.activity for t in tasks}) == len(tasks)
    constant = all(t.kind is TermKind.CONSTANT for task in tasks for t in task.terms)
    if driver in other or not once or not constant:
        return None
    found: dict[tuple[str, str], list[MotionTask]] = {}
    for task in tasks:
        found.setdefault((task.terms[0].name, task.terms[-1].name), []).append(task)
    return found


def _all_shut(
    facts: Facts, service: MotionService, tasks: Collection[MotionTask], thing: str
) -> bool:
    """Return whether it is proven that none of the motions can be made while the thing is where it
    is at first.
    """
    closed = facts.placed(thing, facts.snapshot.initial[thing])
    for task in tasks:
        if task.avoid is not None and thing not in task.avoid:
            return False
        body = facts.snapshot.body(task.activity, task.index, task.object)
        poses = tuple(facts.snapshot.configurations[t.name] for t in task.terms)
        if body.flies or closed.body.flies:
            return False
        if service.certificate(body, poses, (closed,)) is None:
            return False
    return True
