"""What is due too soon: told at once, with who begins where.

A scheduler finds out, too, but goes through all orders of what robots might do before.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from functools import cached_property

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import check_time
from up_samp.model.graphs import reached
from up_samp.model.refinement import Layer, Refinement
from up_samp.model.snapshot import Term, TermKind
from up_samp.motion import MotionService
from up_samp.refinement import rules
from up_samp.scheduling.cpsat.encode.terms import least
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import clauses_of, held_by, limits_told, needs_in, stated_gaps
from up_samp.search.fleet_bound.timelines import guaranteed_locations
from up_samp.search.fleet_bound.work import units_apart
from up_samp.search.world import Motions

_SEEN = 1
"""Units before the end of a drive at which it may be told that somebody is there."""


def due_too_soon(problem: SchedulingMotionProblem, motions: Motions) -> list[Refinement]:
    """Return proofs that activities are absent which have to end sooner than anybody can: what has
    to be present with them comes first, and who drives comes from where it is at first.
    """
    soonest, found = SoonestEnds(problem, motions.facts, motions.service), []
    for name, needed, at_end, latest in limits_told(problem, latest=True):
        check_time()
        if needed <= soonest.with_it(name):
            first = soonest.of(name)[at_end]
            if first > latest:
                what = "" if at_end else "begin: "
                why = f"{what}due at {latest}, {first} at the soonest{soonest.who(name)}"
                found.append(rules.impossible(name, why, Layer.BOUND))
    return found


class SoonestEnds:
    """When activities begin and end at the soonest."""

    def __init__(
        self, problem: SchedulingMotionProblem, facts: Facts, service: MotionService
    ) -> None:
        self._problem, self._facts, self._service = problem, facts, service
        self._snapshot = facts.snapshot
        self._always = frozenset(a.name for a in problem.activities if not a.optional)

    @cached_property
    def _needs(self) -> Mapping[str, frozenset[str]]:
        return needs_in(clauses_of(self._problem))

    @cached_property
    def _before(self) -> Mapping[str, Mapping[str, int]]:
        found: dict[str, dict[str, int]] = {}
        for (first, then), units in stated_gaps(self._problem).items():
            found.setdefault(then, {})[first] = units
        return found

    @cached_property
    def _released(self) -> Mapping[str, list[tuple[frozenset[str | None], bool, int]]]:
        """What activities may not begin, or end, before (see :func:`.limits_told`)."""
        found = defaultdict[str, list[tuple[frozenset[str | None], bool, int]]](list)
        for name, needed, at_end, units in limits_told(self._problem, latest=False):
            found[name].append((needed, at_end, units))
        return found

    @cached_property
    def _stands(self) -> Mapping[str, Mapping[str, str]]:
        """Where robots have to be as activities begin, as far as that is sure."""
        found = defaultdict[str, dict[str, str]](dict)
        sure = guaranteed_locations(self._problem, self._snapshot).places
        for (name, robot), place in sure.items():
            found[name][robot] = place
        return found

    @cached_property
    def _held(self) -> Mapping[str, frozenset[FNode]]:
        return held_by(self._problem)

    @cached_property
    def _durations(self) -> Mapping[str, int]:
        return {a.name: least(a.duration) for a in self._problem.activities}

    def with_it(self, name: str) -> frozenset[str]:
        """Return what is present wherever an activity is, itself included."""
        return self._always.union(reached([name], lambda n: self._needs.get(n, ())))

    def of(self, name: str) -> tuple[int, int]:
        """Return when an activity begins and ends at the soonest (units)."""
        there = self.with_it(name)
        known: dict[str, tuple[int, int]] = {}

        def times(name: str, path: Collection[str]) -> tuple[int, int]:
            if name not in known:
                start, end = self._driven(name)
                for needed, at_end, units in self._released.get(name, ()):
                    if needed <= there:
                        start, end = max(start, units * (not at_end)), max(end, units * at_end)
                for first, gap in self._before.get(name, {}).items():
                    if first in there and first not in path:  # in a ring nothing is left anyhow
                        began, ended = times(first, {*path, name})
                        start = max(start, ended + gap, began + self._apart(first, name))
                known[name] = start, max(end, start + self._lasts(name))
            return known[name]

        return times(name, {name})

    def who(self, name: str) -> str:
        """Return who drives for an activity, and from where."""
        some = sorted(self.with_it(name) - self._always)
        tasks, stands = self._snapshot.by_activity, self._stands
        drivers = {t.object for n in (name, *some) for t in tasks.get(n, ())}.union(
            *(stands.get(n, ()) for n in (name, *some))
        )
        some = [f"{d} begins at {self._snapshot.initial[d]}" for d in sorted(drivers)]
        return f": {', '.join(some)}" if some else ""

    def _driven(self, name: str) -> tuple[int, int]:
        """Return when who drives for an activity, or has to be somewhere for it, may be there at
        the soonest, for its start and its end.
        """
        start = end = 0
        for task in self._snapshot.by_activity.get(name, ()):
            start = max(start, self._comes(task.object, task.terms[0]))
            end = max(end, self._comes(task.object, task.terms[-1]))
        for robot, place in self._stands.get(name, {}).items():
            start = max(start, self._units(robot, self._snapshot.initial[robot], place) - _SEEN)
        return start, end

    def _comes(self, name: str, place: Term) -> int:
        """Return when an object may have come to a place at the soonest (0: it is not known)."""
        if place.kind is not TermKind.CONSTANT:
            return 0
        return self._units(name, self._snapshot.initial[name], place.name)

    def _apart(self, first: str, then: str) -> int:
        """Return how long after the start of one activity another one begins at least, as somebody
        has to be somewhere for each.
        """
        here, there = (self._stands.get(name, {}) for name in (first, then))
        both = [r for r in sorted(here.keys() & there.keys()) if self._rests(r, first)]
        return max((self._units(r, here[r], there[r]) - _SEEN for r in both), default=0)

    def _rests(self, robot: str, name: str) -> bool:
        """Return whether a robot surely rests as an activity begins. What tells where it is says
        that it is where it was last all the while it is on its way.
        """
        drives = {task.activity for task in self._snapshot.by_object[robot]}
        held, before = self._held, self._before
        apart = {
            drive for drive in drives if held[name] & held[drive] or name in before.get(drive, ())
        }
        return name in drives or drives <= apart | before.get(name, {}).keys()

    def _lasts(self, name: str) -> int:
        """Return how long an activity lasts at least (units)."""
        lower_bound, pose = self._service.lower_bound, self._snapshot.configurations
        units = self._durations[name]
        for task in self._snapshot.by_activity.get(name, ()):
            if all(term.kind is TermKind.CONSTANT for term in task.terms):
                body = self._snapshot.body(task.activity, task.index, task.object)
                poses = tuple(pose[term.name] for term in task.terms)
                units = max(units, self._facts.units(lower_bound(body, poses)))
        return units

    def _units(self, name: str, start: str, goal: str) -> int:
        """Return what an object takes from place to place at least (units); 0 where something else
        may move it.
        """
        if start == goal or name in self._snapshot.moved_otherwise:
            return 0
        return units_apart(self._facts, self._service, name, start, goal)
