"""What the problem asks of the order of activities, as differences: constraints, fluents,
resources, objects that rest, one motion after the other for each robot.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from up_samp.model import ProblemError
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.expressions import Expr, show, subexpressions
from up_samp.scheduling.compilers.plain import Effect
from up_samp.scheduling.partial_order.differences import (
    HORIZON,
    MISSING,
    Difference,
    Planned,
    Point,
    kept,
    other_way,
)
from up_samp.scheduling.partial_order.objects import lives, resting
from up_samp.scheduling.partial_order.order import OrderConstraint


def orders_of(planned: Planned, snapshot: Snapshot) -> list[OrderConstraint]:
    """Return all that the problem asks of the order of present activities.

    Raises :class:`ProblemError` where the plan breaks a constraint, ``UnsupportedError`` for
    constraints that are no differences.
    """
    found = list(_constraints(planned))
    found += _durations(planned)
    found += _fluents(planned)
    found += resting(planned, snapshot)
    found += lives(planned, snapshot)
    return found


def _constraints(planned: Planned) -> Iterator[OrderConstraint]:
    for constraint in planned.problem.constraints:
        needs = kept(planned, constraint)
        if needs is None:
            raise ProblemError(f"the plan breaks the constraint '{_short(constraint)}'")
        instead = other_way(planned, constraint, needs)
        for need in needs:
            yield OrderConstraint(need, "constraint", _short(constraint), instead)


def _short(e: Expr) -> str:
    text = show(e)
    return text if len(text) <= 160 else text[:157] + "..."


def _durations(planned: Planned) -> Iterator[OrderConstraint]:
    for activity in planned.problem.activities:
        if activity.name not in planned.times:
            continue
        start, end = ("start", activity.name), ("end", activity.name)
        for bound, sign in ((activity.lower, 1), (activity.upper, -1)):
            if any(e[0] == "flu" for e in subexpressions(bound)):
                # read at the start, where the order of effects keeps it as planned
                value: Any = planned.time(end) - planned.time(start)
            else:
                terms = planned.linear(bound)
                if terms is MISSING or not isinstance(terms, tuple) or terms[0]:
                    continue
                value = terms[1]
            why = f"duration of {activity.name}"
            if sign > 0:
                yield OrderConstraint(Difference(start, end, value), "duration", why)
            else:
                yield OrderConstraint(Difference(end, start, -value), "duration", why)


# ------------------------------------------------------------------ fluents


@dataclass(frozen=True)
class _Write:
    """An effect that happens: ``delay`` units after ``point``, at ``time`` as planned."""

    point: Point
    delay: int
    time: int
    owner: str | None
    effect: Effect


@dataclass(frozen=True)
class _Read:
    """Something that depends on fluents from ``low`` to ``high`` (instants, as planned)."""

    low: tuple[Point, int]
    high: tuple[Point, int]
    owner: str | None
    what: str


def _fluents(planned: Planned) -> Iterator[OrderConstraint]:
    writes, reads = _writes(planned), _reads(planned)
    for key, all_writes in writes.items():
        all_writes.sort(key=lambda w: w.time)
        chained = _capacity(planned, key, all_writes)
        if chained is not None:
            yield from _chained(planned, key, all_writes, chained)
        else:
            yield from _in_order(planned, key, all_writes)
        for read in reads.get(key, ()):
            yield from _around(planned, key, read, all_writes, chained is not None)


def _writes(planned: Planned) -> dict[Expr, list[_Write]]:
    found: dict[Expr, list[_Write]] = {}
    for effect in planned.problem.effects:
        if effect.owner is not None and effect.owner not in planned.times:
            continue
        at = planned.point(effect.time)
        key = planned.ground(effect.fluent)
        if at is None or key is None:
            continue
        time = planned.time(at[0]) + at[1]
        found.setdefault(key, []).append(_Write(at[0], at[1], time, effect.owner, effect))
    return found


def _reads(planned: Planned) -> dict[Expr, list[_Read]]:
    found: dict[Expr, list[_Read]] = {}

    def add(expressions: tuple[Expr, ...], read: _Read) -> None:
        keys = {
            key
            for e in expressions
            for sub in subexpressions(e)
            if sub[0] == "flu" and (key := planned.ground(sub)) is not None
        }
        for key in sorted(keys, key=str):
            found.setdefault(key, []).append(read)

    for condition in planned.problem.conditions:
        if condition.owner is not None and condition.owner not in planned.times:
            continue
        low, high = planned.point(condition.low), planned.point(condition.high)
        if low is None or high is None:
            continue
        if planned.time(low[0]) + low[1] > planned.time(high[0]) + high[1]:
            continue  # nothing is asked of an empty interval
        what = f"condition '{_short(condition.expression)}' of {condition.owner or 'the problem'}"
        add((condition.expression,), _Read(low, high, condition.owner, what))
    for effect in planned.problem.effects:
        if effect.owner is not None and effect.owner not in planned.times:
            continue
        at = planned.point(effect.time)
        if at is None:
            continue
        what = f"effect on {show(effect.fluent)} of {effect.owner or 'the problem'}"
        add((effect.condition, effect.value), _Read(at, at, effect.owner, what))
    for activity in planned.problem.activities:
        if activity.name in planned.times:
            at = ("start", activity.name), 0
            what = f"duration of {activity.name}"
            add((activity.lower, activity.upper), _Read(at, at, activity.name, what))
    return found


def _dense(first: Point, then: Point, lag: int) -> Difference:
    """Return "``lag`` instants later" as the floor means it: one instant later is after."""
    return (
        Difference(first, then, max(lag - 1, 0), strict=True)
        if lag >= 1
        else Difference(first, then, lag)
    )


def _around(
    planned: Planned, key: Expr, read: _Read, writes: list[_Write], every: bool
) -> Iterator[OrderConstraint]:
    """Producers before the reader, the next writer after it."""
    (low, dl), (high, dh) = read.low, read.high
    begin, end = planned.time(low) + dl, planned.time(high) + dh
    if high == HORIZON:
        end = max([end, *(w.time for w in writes)]) + 1
    before = [w for w in writes if w.time < begin or (low == HORIZON and w.time <= end)]
    after = [w for w in writes if w.time > end]
    if not every:
        before = [w for w in before if w.time == before[-1].time]
        after = [w for w in after if w.time == after[0].time]
    for w in before:
        if w.owner != read.owner and low != HORIZON:
            need = _dense(w.point, low, w.delay - dl + 1)
            why = f"{w.owner or 'the problem'} sets {show(key)} for the {read.what}"
            yield OrderConstraint(need, "fluent", why)
    for w in after:
        if w.owner != read.owner and high != HORIZON:
            need = _dense(high, w.point, dh - w.delay + 1)
            why = f"{w.owner or 'the problem'} changes {show(key)} only after the {read.what}"
            yield OrderConstraint(need, "fluent", why)


def _in_order(planned: Planned, key: Expr, writes: list[_Write]) -> Iterator[OrderConstraint]:
    """Changes of one fluent happen in the plan's order."""
    instants = sorted({w.time for w in writes})
    for one, two in itertools.pairwise(instants):
        for w in (w for w in writes if w.time == one):
            for v in (v for v in writes if v.time == two):
                if w.owner != v.owner or w.owner is None:
                    need = _dense(w.point, v.point, w.delay - v.delay + 1)
                    why = f"{w.owner or 'the problem'} sets {show(key)} before {v.owner} does"
                    yield OrderConstraint(need, "fluent", why)


def _capacity(planned: Planned, key: Expr, writes: list[_Write]) -> int | None:
    """Return how much there is of a resource that activities take at their start and give back at
    their end (``None``: the fluent is something else).
    """
    type_ = planned.problem.fluents[key[1]].type
    if type_[0] != "int":
        return None
    taken: dict[str, int] = {}
    given: dict[str, int] = {}
    for w in writes:
        effect = w.effect
        if effect.owner is None or w.delay or effect.kind == "assign" or effect.value[0] != "int":
            return None
        amount = effect.value[1] if effect.kind == "decrease" else -effect.value[1]
        side = taken if w.point[0] == "start" else given
        side[effect.owner] = side.get(effect.owner, 0) + amount
    if any(taken.get(n, 0) <= 0 or given.get(n, 0) != -taken[n] for n in taken | given):
        return None
    initial = planned.value(planned.problem.initial_value(key))
    return int(initial - (type_[1] if type_[1] is not None else 0))


def _chained(
    planned: Planned, key: Expr, writes: list[_Write], capacity: int
) -> Iterator[OrderConstraint]:
    """Whose units an activity takes over (chaining: Policella et al. 2004)."""
    amount: dict[str, int] = {}
    for w in writes:
        if w.point[0] == "start" and w.owner is not None:
            amount[w.owner] = amount.get(w.owner, 0) + w.effect.value[1]
    users = sorted(amount, key=lambda n: planned.times[n])
    alone = max(amount.values()) <= capacity < sum(sorted(amount.values())[:2])
    if alone and all(
        planned.times[a][1] <= planned.times[b][0] for a, b in itertools.pairwise(users)
    ):
        # one after the other, in whatever order
        for one, two in itertools.combinations(users, 2):
            need = Difference(("end", one), ("start", two), 0)
            instead = Difference(("end", two), ("start", one), 0)
            yield OrderConstraint(need, "resource", f"{two} takes {show(key)} after {one}", instead)
        return
    units: list[tuple[int, int, str | None]] = [(0, capacity, None)]  # free since, how many, after
    for name in users:
        start, end = planned.times[name]
        left = amount[name]
        free = sorted((u for u in units if u[0] <= start), key=lambda u: -u[0])
        for unit in free:
            if left == 0:
                break
            units.remove(unit)
            since, many, last = unit
            used = min(many, left)
            left -= used
            if many > used:
                units.append((since, many - used, last))
            units.append((end, used, name))
            if last is not None:
                need = Difference(("end", last), ("start", name), 0)
                yield OrderConstraint(
                    need, "resource", f"{name} takes {show(key)} over from {last}"
                )
        if left:
            raise ProblemError(f"the plan takes more of {show(key)} than there is, in {name}")
