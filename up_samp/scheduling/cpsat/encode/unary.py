"""Unary resources in whatever style: levels of one, busy flags, and states that are held.

Each finder returns activities of which no two overlap, with the gap that they keep: what follows
from the effects and conditions on one state variable. ``whole`` says that the state variable asks
nothing else, so that the disjunctions may take its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from up_samp.scheduling.cpsat.encode.forms import Lin
from up_samp.scheduling.cpsat.encode.numbers import pair_uses
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar, Write


@dataclass(frozen=True)
class Unary:
    """Activities (indices) done one at a time: ``b.start >= a.end + gap``, or vice versa."""

    key: Key
    gap: int
    members: tuple[int, ...]
    whole: bool


@dataclass(frozen=True)
class Section:
    """What one activity keeps for itself: the instants ``lo..hi``."""

    owner: int
    lo: Lin
    hi: Lin


def find_unary(states: States) -> list[Unary]:
    """Return all unary resources among the state variables."""
    found = []
    for key, state in states.vars.items():
        if key[0] not in states.dynamic or len(state.writes) < 2:
            continue
        unary = _borrowed(states, state) or _marked(states, state) or _held(states, state)
        if unary is not None and len(unary.members) > 1:
            found.append(unary)
    return found


# -- a level of which each takes more than half --------------------------------------------------
def _borrowed(states: States, state: StateVar) -> Unary | None:
    """Find who borrows more than half of what there is (``uses``, a decrease and an increase).

    Assumes: each takes more than half of what there is, at its start, and gives it back in the end.
    """
    if not state.numeric or state.initial is None:
        return None
    uses = pair_uses(states, state)
    if uses is None or any(u.owner is None for u in uses):
        return None
    capacity = state.initial - state.bounds[0]
    owners = [u.owner for u in uses]
    sections = [
        Section(u.owner, u.start, u.end)
        for u in uses
        if u.owner is not None
        and owners.count(u.owner) == 1
        and capacity < 2 * u.amount
        and u.active == states.activity(u.owner).present
        and states.difference(u.end, u.start)[0] >= 1
    ]
    if not sections:
        return None
    exact = all(_exactly(states, s) for s in sections)
    fits = all(u.amount <= capacity for u in uses) and state.initial <= state.bounds[1]
    whole = exact and fits and len(sections) == len(uses) and not state.reads
    return _unary(states, state, sections, 0, whole)


# -- a flag that is set by who begins and needs it free ------------------------------------------
def _marked(states: States, state: StateVar) -> Unary | None:
    """Find who needs a state free, takes it, and frees it in the end.

    In the order of taking, the last effect before anybody takes it must be one that frees it; it
    cannot be the taking of the one before.

    Assumes: whoever takes needs it free, frees it itself, and what is free is never what is taken.
    """
    if state.numeric:
        return None
    pairs = _takes_and_frees(states, state)
    if not pairs:
        return None
    taken = {take.value.const for take, _ in pairs.values()}
    freed = {free.value.const for _, free in pairs.values()}
    if taken & freed:
        return None
    sections, left = [], list(state.reads)
    exact = state.initial is not None
    for owner, (take, free) in pairs.items():
        needed = next(
            (
                r
                for r in state.reads
                if r.owner == owner
                and r.active == take.active
                and r.allowed is not None
                and not r.allowed & taken
                and states.difference(take.time, r.hi)[0] >= 0
                and states.difference(take.time, r.hi)[1] <= 1
            ),
            None,
        )
        if needed is None:
            return None
        sections.append(Section(owner, needed.lo, free.time))
        allowed = needed.allowed or frozenset()
        at_once = states.difference(needed.lo, take.time) == (0, 0)
        exact &= at_once and freed | {state.initial} <= allowed
        implied = [r for r in left if r is needed or _while_taken(states, r, owner, take, free)]
        left = [r for r in left if all(r is not other for other in implied)]
    whole = exact and not left and all(_exactly(states, s) for s in sections)
    return _unary(states, state, sections, 1, whole)


def _takes_and_frees(states: States, state: StateVar) -> dict[int, tuple[Write, Write]]:
    """Return the two effects of each owner; nothing if there are any others."""
    by_owner: dict[int, list[Write]] = {}
    for write in state.writes:
        if write.owner is None or write.value.terms:
            return {}
        if write.active != states.activity(write.owner).present:
            return {}
        by_owner.setdefault(write.owner, []).append(write)
    pairs = {}
    for owner, writes in by_owner.items():
        if len(writes) != 2:
            return {}
        one, other = writes
        if states.difference(other.time, one.time)[0] >= 1:
            pairs[owner] = (one, other)
        elif states.difference(one.time, other.time)[0] >= 1:
            pairs[owner] = (other, one)
        else:
            return {}
    return pairs


def _while_taken(states: States, read: Read, owner: int, take: Write, free: Write) -> bool:
    """Return whether a read asks no more than that its owner holds what it has taken."""
    after = 0 if read.guard_only else 1
    return (
        read.owner == owner
        and read.active == take.active
        and read.value is None
        and (read.allowed is None or take.value.const in read.allowed)
        and states.difference(read.lo, take.time)[0] >= after
        and states.difference(free.time, read.hi)[0] >= 0
    )


# -- a state that everybody changes once and holds -----------------------------------------------
def _held(states: States, state: StateVar) -> Unary | None:
    """Find who changes a state at one end of a span over which it keeps others from doing so.

    Assumes: each sets it once, at one end of the span over which it keeps it.
    """
    if state.numeric:
        return None
    for at_end in (True, False):
        sections = list(_spans(states, state, at_end))
        if len(sections) > 1:
            unary = _unary(states, state, sections, 1, False)
            if unary is not None:
                return unary
    return None


def _spans(states: States, state: StateVar, at_end: bool) -> Iterator[Section]:
    writes: dict[int, list[Write]] = {}
    for write in state.writes:
        if write.owner is not None:
            writes.setdefault(write.owner, []).append(write)
    seen = set()
    for read in state.reads:
        mine = writes.get(-1 if read.owner is None else read.owner, [])
        if len(mine) != 1 or read.owner is None or read.owner in seen or read.loose:
            continue
        write = mine[0]
        present = states.activity(read.owner).present
        if read.active != present or write.active != present:
            continue
        before = states.difference(write.time, read.hi)
        after = states.difference(read.lo, write.time)
        if at_end and before[0] >= 0 and before[1] <= 1:
            seen.add(read.owner)
            yield Section(read.owner, read.lo, write.time)
        elif not at_end and after[0] >= 0 and after[1] <= 1:
            seen.add(read.owner)
            yield Section(read.owner, write.time, read.hi)


# -- common ------------------------------------------------------------------------------------
def _unary(
    states: States, state: StateVar, sections: list[Section], margin: int, whole: bool
) -> Unary | None:
    """Return what sections that are ``margin`` apart say of their activities."""
    covering = []
    for section in sections:
        activity = states.activity(section.owner)
        tail = states.difference(section.hi, activity.end)[0]
        head = states.difference(section.lo, activity.start)[1]
        covering.append((tail, head, section.owner))
    gap = margin + min(t for t, _, _ in covering) - max(h for _, h, _ in covering)
    if gap < 0:
        return None
    return Unary(state.key, gap, tuple(sorted(o for _, _, o in covering)), whole)


def _exactly(states: States, section: Section) -> bool:
    """Return whether a section is its activity's time, start to end."""
    activity = states.activity(section.owner)
    return (
        states.difference(section.lo, activity.start) == (0, 0)
        and states.difference(section.hi, activity.end) == (0, 0)
        and states.difference(activity.end, activity.start)[0] >= 1
    )
