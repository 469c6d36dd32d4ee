"""Facts of the problem: what no search changes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from up_samp.model import Body, Configuration, PathReport, Placed, ScheduledMotion, avoids
from up_samp.model.refinement import Given
from up_samp.model.snapshot import MotionTask, Snapshot, Term, TermKind
from up_samp.upio import ConfigurationChoice


@dataclass(frozen=True)
class MotionCase:
    """A motion task between known ``configurations`` (names): so it is under the decisions
    ``given`` (none: always).
    """

    task: MotionTask
    configurations: tuple[str, ...]
    given: Given = ()

    @property
    def activity(self) -> str:
        """The activity that makes the motion."""
        return self.task.activity

    def __str__(self) -> str:
        places = " to ".join(self.configurations)
        return f"{self.activity} ({self.task.object} from {places})"

    def why_not(self, report: PathReport) -> str:
        """Return why there is no such motion, with what its places are called."""
        if report.where is not None:
            return f"at '{self.configurations[report.where]}' {report.reason}"
        places = " to ".join(f"'{name}'" for name in self.configurations)
        return f"from {places} {report.reason}" if report.reason else ""


def are_apart(snapshot: Snapshot, one: MotionCase, other: MotionCase) -> bool:
    """Return whether two motions are of two objects that heed each other in these and in whatever
    else moves them, so that neither comes to where the other one rests: set there they are by
    nobody but who drives one of them and moves the other one.

    What one of them brings the other one may take on at that instant: their bodies have the load in
    common then, and tell nothing.
    """
    a, b, movers = one.task, other.task, snapshot.movers
    both = a.activity in movers[b.object] or b.activity in movers[a.object]
    if both or a.moved & b.moved or a.index or b.index:
        return False
    given = dict(one.given)
    if any(given.get(name, value) != value for name, value in other.given):
        return False
    return b.object in snapshot.heeded[a.object] and a.object in snapshot.heeded[b.object]


Choices = Mapping[tuple[str, Term, bool], ConfigurationChoice]
"""What configurations hang on that are no constants (see ``Relaxation.choices``)."""
Signature = tuple[Body, tuple[Configuration, ...]]
"""What a motion is to the motion planner: motions of equal signatures are equivalent."""

LATE = 9e-7
"""Lateness (s) that counts as rounding: less than the validator forgives (1e-6 s)."""


@dataclass(frozen=True)
class Facts:
    """The problem as it was read, and what follows from it at once.

    Motions with more than ``most_cases`` are looked at when they are scheduled.
    """

    snapshot: Snapshot
    choices: Choices
    most_cases: int = 128

    # ------------------------------------------------------------------ units
    def seconds(self, units: float) -> float:
        """Return schedule units in s."""
        return units * self.snapshot.seconds_per_unit

    def units(self, seconds: float, parts: int = 1) -> int:
        """Return s in schedule units, rounded up. ``LATE`` s are forgiven, whatever a unit is, of
        each of the ``parts`` that it may be made of.
        """
        return math.ceil((seconds - parts * LATE) / self.snapshot.seconds_per_unit)

    # ---------------------------------------------------------------- motions
    @cached_property
    def cases(self) -> tuple[MotionCase, ...]:
        """All motions between known configurations (none of a task with too many of them)."""
        return tuple(case for task in self.snapshot.tasks for case in self._cases_of(task))

    def _cases_of(self, task: MotionTask) -> Iterator[MotionCase]:
        terms = [self.choice(task, term) for term in task.terms]
        domains = {c.variable: c.values for c in terms if c.variable is not None}
        if math.prod(map(len, domains.values())) > self.most_cases:
            return
        for values in itertools.product(*domains.values()):
            chosen = dict(zip(domains, values, strict=True))
            names = tuple(c.values[0] if c.variable is None else chosen[c.variable] for c in terms)
            yield MotionCase(task, names, tuple(sorted(chosen.items())))

    def choice(self, task: MotionTask, term: Term) -> ConfigurationChoice:
        """Return what one of a task's terms may be."""
        if term.kind is TermKind.CONSTANT:
            return ConfigurationChoice(None, (term.name,))
        return self.choices[task.activity, term, False]

    def signature(self, case: MotionCase) -> Signature:
        """Return what a case is to the motion planner."""
        task = case.task
        body = self.snapshot.body(task.activity, task.index, task.object)
        return body, tuple(self.snapshot.configurations[n] for n in case.configurations)

    @cached_property
    def by_signature(self) -> dict[Signature, list[MotionCase]]:
        """Equivalent motions."""
        found: dict[Signature, list[MotionCase]] = {}
        for case in self.cases:
            found.setdefault(self.signature(case), []).append(case)
        return found

    def case(self, motion: ScheduledMotion) -> MotionCase:
        """Return the case that a scheduled motion is."""
        tasks = self.snapshot.by_activity[motion.activity]
        task = next(t for t in tasks if t.index == motion.constraint)
        return MotionCase(task, motion.configurations, motion.given)

    def like(self, motion: ScheduledMotion) -> list[MotionCase]:
        """Return the case that a scheduled motion is, and all that are the same to the planner."""
        return self.same(self.case(motion))

    def same(self, case: MotionCase) -> list[MotionCase]:
        """Return a case, and all that are the same to the planner."""
        return list(dict.fromkeys((case, *self.by_signature.get(self.signature(case), ()))))

    # ---------------------------------------------------------------- objects
    @cached_property
    def drivers(self) -> frozenset[str]:
        """Objects that some activity drives."""
        return frozenset(self.snapshot.by_object)

    @cached_property
    def instant(self) -> frozenset[str]:
        """Objects that change their configuration but never drive (doors)."""
        return frozenset(c.object for c in self.snapshot.changes) - self.drivers - self.loads

    @cached_property
    def changed_together(self) -> dict[str, tuple[str, ...]]:
        """By each of ``instant``, all that the same activities change, at their ends: the
        leaves of a door.
        """
        movers = self.snapshot.movers
        by_movers: dict[frozenset[str], list[str]] = {}
        for name in sorted(self.instant):
            by_movers.setdefault(movers[name], []).append(name)
        return {name: tuple(by_movers[movers[name]]) for name in self.instant}

    @cached_property
    def loads(self) -> frozenset[str]:
        """Objects that travel with others and never drive."""
        return frozenset(r.load for r in self.snapshot.rides) - self.drivers

    def body(self, motion: ScheduledMotion) -> Body:
        """Return what a scheduled motion drives: an object, with its loads."""
        return self.snapshot.body(motion.activity, motion.constraint, motion.object)

    @cached_property
    def bodies_on_tour(self) -> Mapping[str, Body]:
        """By object what no tour of it from place to place, over others or not, is faster than in
        one drive: loads only slow it down, and what a dock asks for binds the last drive alone.
        """
        return {name: item.body.but_docks for name, item in self.snapshot.objects.items()}

    def placed(self, name: str, configuration: str) -> Placed:
        """Return an object at a configuration."""
        snapshot = self.snapshot
        return Placed(name, snapshot.objects[name].body, snapshot.configurations[configuration])

    def heeded(self, task: MotionTask, places: Mapping[str, str]) -> tuple[Placed, ...]:
        """Return what stands on the floor at these ``places`` that a motion keeps clear of."""
        known = self.snapshot.objects
        some = (n for n in places if avoids(task.avoid, n) and not known[n].body.flies)
        return tuple(self.placed(name, places[name]) for name in some)

    @cached_property
    def fixed(self) -> tuple[Placed, ...]:
        """The movable objects that nothing ever moves."""
        initial = self.snapshot.initial
        return tuple(
            self.placed(n, initial[n]) for n in sorted(set(initial) - self.snapshot.moved())
        )

    def fixed_for(self, cases: Sequence[MotionCase]) -> tuple[Placed, ...]:
        """Those of them that all ``cases`` heed: what is said of all may count on no others."""
        return tuple(o for o in self.fixed if all(avoids(c.task.avoid, o.name) for c in cases))

    def returns_to(self, obstacle: str, configuration: str) -> bool:
        """Return whether some activity may bring ``obstacle`` to ``configuration``."""
        terms = [t.terms[-1] for t in self.snapshot.by_object.get(obstacle, ())]
        terms += [r.goal for r in self.snapshot.rides if r.load == obstacle]
        terms += [c.term for c in self.snapshot.changes if c.object == obstacle]
        return any(t.kind is not TermKind.CONSTANT or t.name == configuration for t in terms)


def just_this(facts: Facts, motion: ScheduledMotion) -> list[MotionCase]:
    """Return the case that a motion is, and nothing that is like it."""
    return [facts.case(motion)]
