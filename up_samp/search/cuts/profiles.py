"""Interaction profiles: two motions that meet, learned for a whole range of start offsets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

from up_samp.model import Deadline, FixedMotion, ScheduledMotion, TimedMotion, avoids
from up_samp.model.refinement import Given, Refinement, Strength
from up_samp.model.snapshot import MotionTask
from up_samp.refinement import rules
from up_samp.search.cuts.protocol import Failure
from up_samp.search.facts import MotionCase
from up_samp.search.motions import Motions


def pair_cuts(failure: Failure, late: str) -> list[Refinement]:
    """Return an interaction profile of the late motion with one that it meets.

    Stated for all pairs of motions that are the same to the motion planner.
    """
    deadline = failure.motions.budget.part("interaction profile")
    for other in _partners(failure, late):
        if deadline.expired():
            break
        first, second = sorted((late, other), key=lambda n: (failure.scheduled[n].start, n))
        cut = _pair_cut(failure, first, second, deadline)
        if cut is not None:
            return cut
    return []


def _partners(failure: Failure, late: str) -> list[str]:
    """Return whom the late motion may have met: those that the planner names, if it does. Who takes
    on what the other one brings is one body with it at that instant: no such pair is looked at.
    """
    mine = failure.scheduled[late]
    named = failure.report.conflict
    overlapping = [
        n
        for n, m in sorted(failure.scheduled.items())
        if not m.moved & mine.moved and m.start <= mine.end and mine.start <= m.end
    ]
    return [n for n in overlapping if n in named] or overlapping


@dataclass(frozen=True)
class _Pair:
    """Two motions; offsets are the second's start after the first's (units)."""

    motions: Motions
    first: TimedMotion
    second: TimedMotion
    slack_first: int
    """Units after the second's start by which the first may end."""
    slack_second: int
    deadline: Deadline

    def second_end(self, offset: int) -> int | None:
        """Return the second's end after the first's start, if it gives way."""
        return self._behind(self._leader_first, self.second, offset, self.slack_second)

    def first_end(self, offset: int) -> int | None:
        """Return the first's end after the second's start, if it gives way."""
        return self._behind(self._leader_second, self.first, -offset, self.slack_first)

    @cached_property
    def _leader_first(self) -> FixedMotion | None:
        return self._leading(self.first)

    @cached_property
    def _leader_second(self) -> FixedMotion | None:
        return self._leading(self.second)

    def _leading(self, motion: TimedMotion) -> FixedMotion | None:
        drive = self.motions.fastest_alone(motion)
        if drive is None:
            return None
        return FixedMotion(motion.name, motion.object, motion.body, drive, drive.start, drive.end)

    def _behind(
        self, leader: FixedMotion | None, follower: TimedMotion, offset: int, slack: int
    ) -> int | None:
        """Return the follower's earliest end (units after the leader's start) when it gives way,
        or any that is within ``slack``. Only the two are there.
        """
        if leader is None:
            return None
        facts = self.motions.facts
        release = facts.seconds(offset)
        moved = replace(
            follower,
            release=release,
            due=math.inf,
            present_from=release,
            present_until=math.inf,
        )
        arrival = self.motions.arrival(
            moved, fixed=(leader,), enough=facts.seconds(slack), deadline=self.deadline
        )
        return None if arrival is None else facts.units(arrival)


def _pair_cut(
    failure: Failure, first: str, second: str, deadline: Deadline
) -> list[Refinement] | None:
    """Return the pair's cuts for the widest range of offsets that still rejects the candidate."""
    a, b = failure.scheduled[first], failure.scheduled[second]
    timed_a, timed_b = failure.timed[first], failure.timed[second]
    pair = _Pair(failure.motions, timed_a, timed_b, a.end - b.start, b.end - a.start, deadline)
    offset = b.start - a.start

    def second_late(at: int) -> bool:
        return (pair.second_end(at) or 0) > pair.slack_second

    def first_late(at: int) -> bool:
        return (pair.first_end(at) or 0) > pair.slack_first

    if not second_late(offset) or not first_late(offset):
        return None
    reach = max(a.end - a.start, b.end - b.start)
    low = _widest(offset, -1, reach, second_late)
    high = _widest(offset, +1, reach, first_late)
    needed_b, needed_a = pair.second_end(low), pair.first_end(high)
    if low > high or needed_b is None or needed_a is None:
        return None
    why = f"{a.activity} and {b.activity} meet when started {low} to {high} units apart"
    exhaustive = failure.motions.order_decides(timed_a, timed_b)
    strength = Strength.RELATIVE if exhaustive else Strength.HEURISTIC
    return [
        rules.only_given(
            replace(
                rules.pair_meets(x.activity, y.activity, (low, high), needed_b, needed_a, why),
                strength=strength,
            ),
            tuple(sorted({*x.given, *y.given})),
        )
        for x, y in _same_pairs(failure, first, second)
    ]


def _same_pairs(
    failure: Failure, first: str, second: str
) -> Iterator[tuple[MotionCase, MotionCase]]:
    """Yield the pair and all pairs of two objects' motions that are the same to the planner."""
    facts = failure.facts
    a, b = failure.scheduled[first], failure.scheduled[second]
    mine = facts.case(a), facts.case(b)
    yield mine
    if a.constraint or b.constraint:
        return
    if not _each_other(a, b):
        return
    for one in failure.alike(facts, a):
        for two in failure.alike(facts, b):
            x, y = one.task, two.task
            if x.moved & y.moved or (one, two) == mine or _contradict(one.given, two.given):
                continue
            if x.index == y.index == 0 and _each_other(x, y):
                yield one, two


def _contradict(one: Given, two: Given) -> bool:
    """Return whether two motions ask for different values of one variable."""
    values = dict(one)
    return any(values.get(name, value) != value for name, value in two)


def _each_other(a: ScheduledMotion | MotionTask, b: ScheduledMotion | MotionTask) -> bool:
    return avoids(a.avoid, b.object) and avoids(b.avoid, a.object)


def _widest(offset: int, step: int, reach: int, works: Callable[[int], bool]) -> int:
    """Return the offset farthest from ``offset`` on one side at which ``works`` still holds.

    ``works`` is monotone: who starts earlier never arrives later.
    """
    good, size = offset, 1
    while size <= reach and works(offset + step * size):
        good = offset + step * size
        size *= 2
    bad = offset + step * size
    while abs(bad - good) > 1:
        middle = (good + bad) // 2
        if works(middle):
            good = middle
        else:
            bad = middle
    return good
