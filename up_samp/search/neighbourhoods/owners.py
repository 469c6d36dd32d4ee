"""Who does what: the robots that each activity of a problem belongs to, and what excludes what.

A guess from what activities have to do with, good enough to say what is worth a look together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from unified_planning.model import FNode
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.walkers.free_vars import FreeVarsExtractor

from up_samp.model.snapshot import Snapshot, TermKind
from up_samp.upio import Relaxation


@dataclass(frozen=True)
class Owners:
    """``of``: activity -> the robots that it belongs to (none: nobody knows). ``rivals``: activity
    -> those that stand for it or cannot be present with it. ``places``: activity -> where its robot
    has to be for it, and ``ways``: motion activity -> the places that it leads from and to.
    """

    of: Mapping[str, frozenset[str]]
    rivals: Mapping[str, frozenset[str]]
    places: Mapping[str, frozenset[str]]
    ways: Mapping[str, frozenset[str]]

    @property
    def robots(self) -> list[str]:
        """All robots that something belongs to, in order."""
        return sorted({robot for some in self.of.values() for robot in some})

    def open_to(self, robots: Collection[str], present: Collection[str]) -> set[str]:
        """Return the activities that ``robots`` may do beside those ``present``: nothing that is
        excluded by these, and no ways to places where there is nothing to do any more.
        """
        mine = {n for n, own in self.of.items() if own <= set(robots)}
        barred = mine & {r for name in present for r in self.rivals.get(name, ())}
        mine -= barred
        done = [n for n in present if self.of.get(n, frozenset()) & set(robots)]
        useful = {p for n in (*mine, *done) for p in self.places.get(n, ())}
        useful |= {p for n in done for p in self.ways.get(n, ())}
        useless = {p for n in barred for p in self.places.get(n, ())} - useful
        return {n for n in mine if not self.ways.get(n, frozenset()) & useless} - set(present)


def owners_of(relaxation: Relaxation) -> Owners:
    """Return who does what in a problem."""
    problem, snapshot = relaxation.problem, relaxation.snapshot
    free = problem.environment.free_vars_extractor
    touched = {a.name: set(_touched(a, free)) for a in problem.activities}
    drivers: dict[str, set[str]] = {a.name: set() for a in problem.activities}
    for task in snapshot.tasks:
        drivers[task.activity].add(task.object)
    theirs: dict[FNode, set[str]] = defaultdict(set)
    for name, robots in drivers.items():
        for fluent in touched[name] if robots else ():
            theirs[fluent] |= robots
    private = {fluent: robots for fluent, robots in theirs.items() if len(robots) == 1}
    private |= {relaxation.state[r]: {r} for robots in drivers.values() for r in robots}
    of = {
        name: frozenset(own or {r for f in touched[name] if f in private for r in private[f]})
        for name, own in drivers.items()
    }
    places = {a.name: frozenset(_places(a)) for a in problem.activities if not drivers[a.name]}
    return Owners(of, _rivals(problem), places, _ways(snapshot))


def _touched(activity: Activity, free: FreeVarsExtractor) -> Iterator[FNode]:
    """Yield the ground fluents that an activity has to do with."""
    expressions = [c for some in activity.conditions.values() for c in some]
    for effects in activity.effects.values():
        expressions += [x for e in effects for x in (e.fluent, e.value, e.condition)]
    for expression in expressions:
        for fluent in free.get(expression):
            if all(a.is_constant() or a.is_object_exp() for a in fluent.args):
                yield fluent


def _places(activity: Activity) -> Iterator[str]:
    """Yield the objects that some fluent has to hold for an activity, or may."""
    todo = [c for conditions in activity.conditions.values() for c in conditions]
    for node in todo:
        if node.is_and() or node.is_or():
            todo += node.args
        elif node.is_equals():
            yield from (side.object().name for side in node.args if side.is_object_exp())


def _ways(snapshot: Snapshot) -> dict[str, frozenset[str]]:
    found: dict[str, set[str]] = defaultdict(set)
    for task in snapshot.tasks:
        ends = (task.terms[0], task.terms[-1])
        found[task.activity] |= {t.name for t in ends if t.kind is TermKind.CONSTANT}
    return {name: frozenset(some) for name, some in found.items()}


def _rivals(problem: SchedulingProblem) -> dict[str, frozenset[str]]:
    """Return which activities stand for each other or exclude each other, as far as unconditional
    clauses on presences say: where one of them stays, the others are not worth a look.
    """
    found: dict[str, set[str]] = defaultdict(set)
    for constraint, scope in problem._base._constraints:
        names = _clause(constraint) if not scope else ()
        for name in names:
            found[name].update(names)
    return {name: frozenset(some - {name}) for name, some in found.items()}


def _clause(constraint: FNode) -> tuple[str, ...]:
    """Return the activities of "one of these", or of "not both of these"."""
    args = constraint.args if constraint.is_or() else ()
    if len(args) == 2 and all(a.is_not() for a in args):
        args = tuple(a.arg(0) for a in args)
    if not all(a.is_present_exp() for a in args):
        return ()
    return tuple(a.presence().container for a in args)
