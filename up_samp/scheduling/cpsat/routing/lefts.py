"""How long all that is left takes at least, once the first of it has started.

A sum of times knows nothing of waiting: what comes one after the other in a job keeps few
travellers busy. So the best end of what is left is found itself, for travellers who begin wherever
they like: that depends on the set of tasks that is left alone, however they came about. It is
found for few tasks first, and tells of more where to stop (Russian doll search; Verfaillie,
Lemaitre and Schiex 1996). What opens doors is set aside: the sets are fewer, and the doors open.

Why it holds: take the tasks that are left in any schedule, but for those aside, and count time from
the first start among them. Everybody is somewhere then, so as a sequence that begins anywhere they
end no sooner than the best one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from up_samp.scheduling.cpsat.routing.dispatch import Memory
from up_samp.scheduling.cpsat.routing.programme import Programme
from up_samp.scheduling.cpsat.routing.rules import Rules
from up_samp.scheduling.cpsat.routing.sequences import Sequences
from up_samp.scheduling.cpsat.tuning import BoundsTuning


def aside_of(programme: Programme) -> int:
    """Return (bits of) the tasks that open doors, as far as nothing else has to come before them:
    with all of these, what may be done at some time is such a set again.
    """
    found = sum(1 << number for number, task in enumerate(programme.tasks) if task.opens)
    while True:
        kept = sum(
            1 << number
            for number, needs in enumerate(programme.before)
            if found >> number & 1 and not needs & ~found
        )
        if kept == found:
            return found
        found = kept


def with_lefts(
    rules: Rules,
    most: int,
    over: Callable[[], bool],
    memory: Memory | None = None,
    tuning: BoundsTuning | None = None,
) -> Rules:
    """Return the rules with what is left of each set of tasks, as far as ``most`` beginnings and
    the time allow to find it out. ``memory``: what was found out for the same tasks when no more
    was stated; what is found out goes there.

    Assumes: what a ``memory`` holds was found of the same tasks when no more was stated.
    """
    aside = aside_of(rules.programme)
    free = rules.anywhere(over)
    if free is None:
        return rules
    free = replace(free, aside=aside, lefts=rules.lefts.copy())
    looked = Sequences(free, most, tuning=tuning or BoundsTuning())
    sets = [int(done) for done in rules.sets if int(done) & aside == aside]
    found = {} if memory is None else memory.setdefault(_names(rules, aside), {})
    for done in sorted(sets, key=lambda some: -some.bit_count()):
        known = found.get(done)
        if known is None:
            known = _of_more(free, done)
            sequences = replace(looked, begun=done)
            while not over() and not looked.is_spent and sequences.refuted(known, over):
                known += 1
            if not over() and not looked.is_spent:
                found[done] = known
        free.lefts[free.row(done)] = known
    lefts = free.lefts[free.row(rules.sets | aside)]
    return replace(rules, aside=aside, lefts=lefts)


def _names(rules: Rules, aside: int) -> tuple[object, ...]:
    """Return what the tasks of sets are called, one way and another."""
    return aside, *(tuple(name for _, name, _ in task.ways) for task in rules.programme.tasks)


def _of_more(rules: Rules, done: int) -> int:
    """Return the most that is left when one more task than ``done`` has been done."""
    return max(
        (
            int(rules.lefts[rules.row(done | 1 << task)])
            for task, needs in enumerate(rules.programme.before)
            if not done >> task & 1 and not needs & ~done
        ),
        default=0,
    )
