"""Interaction profiles: two motions that meet, learned for a whole range of start offsets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from up_samp.model import Deadline, TimedMotion
from up_samp.model.refinement import Refinement, Strength
from up_samp.refinement import rules
from up_samp.search.cuts.protocol import Failure
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


def _behind(
    motions: Motions, leader: TimedMotion, follower: TimedMotion, slack: int, deadline: Deadline
) -> Callable[[int], int]:
    """Return what tells for the follower's start after the leader's its earliest end after that
    (units; 0: not known) if it gives way, or any that is within ``slack``. Only the two are there.
    """
    facts, drive = motions.facts, motions.fastest_alone(leader)

    def end(offset: int) -> int:
        if drive is None:
            return 0
        release = facts.seconds(offset)
        moved = replace(
            follower,
            release=release,
            due=math.inf,
            present_from=release,
            present_until=math.inf,
        )
        arrival = motions.arrival(moved, leader, drive, facts.seconds(slack), deadline)
        return 0 if arrival is None else facts.units(arrival)

    return end


def _pair_cut(
    failure: Failure, first: str, second: str, deadline: Deadline
) -> list[Refinement] | None:
    """Return the pair's cuts for the widest range of offsets that still rejects the candidate."""
    a, b = failure.scheduled[first], failure.scheduled[second]
    timed_a, timed_b = failure.timed[first], failure.timed[second]
    motions, slack_first, slack_second = failure.motions, a.end - b.start, b.end - a.start
    second_end = _behind(motions, timed_a, timed_b, slack_second, deadline)
    first_end = _behind(motions, timed_b, timed_a, slack_first, deadline)
    offset = b.start - a.start

    def second_late(at: int) -> bool:
        return second_end(at) > slack_second

    def first_late(at: int) -> bool:
        return first_end(-at) > slack_first

    if not second_late(offset) or not first_late(offset):
        return None
    reach = max(a.end - a.start, b.end - b.start)
    low = _widest(offset, -1, reach, second_late)
    high = _widest(offset, +1, reach, first_late)
    needed_b, needed_a = second_end(low), first_end(-high)
    if low > high or not needed_b or not needed_a:
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
        for x, y in failure.pairs_like(a, b)
    ]


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
