"""What the problem asks of the order of activities, as differences."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.errors import short
from up_samp.model.graphs import grouped
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.constraints import amounts_taken
from up_samp.scheduling.compilers.plain import Condition, Effect, Expr, show, subexpressions
from up_samp.scheduling.compilers.translate import read_constraints
from up_samp.scheduling.partial_order.differences import (
    HORIZON,
    MISSING,
    ZERO,
    Difference,
    Planned,
    Point,
    constant,
    kept,
    other_way,
)


@dataclass(frozen=True)
class OrderConstraint:
    """A difference with its reason: ``kind`` is a stable word, ``why`` is for people. ``instead``
    would do what is asked as well.
    """

    difference: Difference
    kind: str
    why: str
    instead: Difference | None = None


# ------------------ What objects ask of the order of activities


def _movers(planned: Planned, snapshot: Snapshot) -> dict[str, list[tuple[str, bool]]]:
    """Return for each object who moves it (activity, whether it drives), in the plan's order: what
    is set somewhere at an instant may drive on from there at once.
    """
    found: dict[str, list[tuple[str, bool]]] = {}
    driven = {(t.activity, t.object) for t in snapshot.tasks}
    for task in snapshot.tasks:
        if task.activity in planned.times:
            for name in (task.object, *(ride.load for ride in task.rides)):
                found.setdefault(name, []).append((task.activity, True))
    for change in snapshot.changes:
        if change.activity in planned.times and (change.activity, change.object) not in driven:
            found.setdefault(change.object, []).append((change.activity, False))
    for movers in found.values():
        movers.sort(key=lambda m: _place_in_life(planned, *m))
    return found


def _place_in_life(planned: Planned, activity: str, drives: bool) -> tuple[int, int, bool, str]:
    start, end = planned.times[activity]
    return (start if drives else end), end, drives, activity


def lives(planned: Planned, snapshot: Snapshot) -> Iterator[OrderConstraint]:
    """One motion or change of an object after the other."""
    for name, movers in _movers(planned, snapshot).items():
        for (one, _), (two, drives) in itertools.pairwise(movers):
            then = ("start" if drives else "end", two)
            need = Difference(("end", one), then, 0, strict=True)
            yield OrderConstraint(need, "object", f"{one} and {two} both move {name}")


def resting(planned: Planned, snapshot: Snapshot) -> Iterator[OrderConstraint]:
    """Static obstacles rest from the start to the end of the motion that lists them."""
    movers = _movers(planned, snapshot)
    for task in snapshot.tasks:
        if task.activity not in planned.times:
            continue
        start, end = planned.times[task.activity]
        for obstacle in sorted(task.static or ()):
            for name, drives in movers.get(obstacle, ()):
                if name == task.activity:
                    continue
                begin, stop = planned.times[name]
                why = f"{obstacle} rests during {task.activity}, {name} moves it"
                then = ("start" if drives else "end", name)
                before = Difference(("end", name), ("start", task.activity), 0)
                after = Difference(("end", task.activity), then, 0)
                if stop <= start:
                    yield OrderConstraint(before, "static obstacle", why, after)
                elif end <= (begin if drives else stop):
                    yield OrderConstraint(after, "static obstacle", why, before)
                else:
                    raise ProblemError(f"in the plan {why} at the same time")


def performers(planned: Planned, snapshot: Snapshot) -> Mapping[str, tuple[str, ...]]:
    """Return which driven objects each activity mentions: who does it."""
    found: dict[str, dict[str, None]] = {name: {} for name in planned.times}
    for task in snapshot.tasks:
        if task.activity in found:
            found[task.activity][task.object] = None
    mentions: list[tuple[str | None, Expr]] = []
    mentions += [(c.owner, c.expression) for c in planned.problem.conditions]
    mentions += [(e.owner, e.fluent) for e in planned.problem.effects]
    for owner, e in mentions:
        if owner not in found:
            continue
        for sub in subexpressions(e):
            value = planned.value(sub) if sub[0] in ("obj", "par") else None
            if isinstance(value, str) and value in snapshot.by_object:
                found[owner][value] = None
    return {name: tuple(sorted(who)) for name, who in found.items()}


def orders_of(planned: Planned, snapshot: Snapshot) -> list[OrderConstraint]:
    """Return all that the problem asks of the order of present activities.

    Raises :class:`ProblemError` where the plan breaks a constraint, ``UnsupportedError`` for
    constraints that are no differences.
    """
    found = list(_constraints(planned))
    found += durations(planned)
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


def constraint_texts(problem: SchedulingProblem) -> Iterator[tuple[FNode, str]]:
    """Yield a problem's constraints, each with the text by which its orders are named."""
    for node, constraint in read_constraints(problem):
        yield node, _short(constraint)


def _short(e: Expr) -> str:
    return short(show(e), 160)


def durations(planned: Planned) -> Iterator[OrderConstraint]:
    """Yield how long present activities last, at least and at most."""
    for activity in planned.problem.activities:
        if activity.name not in planned.times:
            continue
        start, end = ("start", activity.name), ("end", activity.name)
        told = ((activity.lower, start, end, 1), (activity.upper, end, start, -1))
        for bound, first, then, sign in told:
            if any(e[0] == "flu" for e in subexpressions(bound)):
                # read at the start, where the order of effects keeps it as planned
                value: Any = planned.time(end) - planned.time(start)
            else:
                form = planned.linear(bound)
                if form is None or form.coefficients:
                    continue
                value = form.constant
            need = Difference(first, then, sign * value)
            yield OrderConstraint(need, "duration", f"duration of {activity.name}")


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
    """Something that depends on fluents from ``low`` to ``high`` (instants, as planned).

    ``open_low``, ``open_high``: where the interval may be open in dense time, an effect of others
    a whole unit before or after it is not one that is only just outside.
    """

    low: tuple[Point, int]
    high: tuple[Point, int]
    owner: str | None
    what: str
    open_low: bool = False
    open_high: bool = False


def _fluents(planned: Planned) -> Iterator[OrderConstraint]:
    writes, asked = _writes(planned), _asked(planned)
    idle = _idle(planned, writes, asked)
    yield from _as_short(idle)
    left = set(map(id, idle))
    reads = _reads(planned, [one for one in asked if id(one) not in left])
    moments: dict[int, list[Moment]] = {}
    for key, all_writes in writes.items():
        all_writes.sort(key=lambda w: w.time)
        yield from _after_zero(key, all_writes)
        mine = reads.get(key, ())
        # whoever looks at it while units change hands sees the plan's sequence of values
        watched = any(read.owner is None for read in mine)
        chained = None if watched else _capacity(planned, key, all_writes)
        if chained is not None:
            yield from _chained(planned, key, all_writes, chained)
        else:
            yield from _in_order(planned, key, all_writes)
            for time, groups in _several_at_once(all_writes):
                moments.setdefault(time, []).append((key, groups))
        for read in mine:
            yield from _around(planned, key, read, all_writes, chained is not None)
    yield from _at_once(planned, writes, moments)


def _writes(planned: Planned) -> dict[Expr, list[_Write]]:
    found: dict[Expr, list[_Write]] = {}
    for effect in planned.problem.effects:
        if not planned.there(effect.owner):
            continue
        at = planned.point(effect.time)
        key = planned.ground(effect.fluent)
        if at is None or key is None:
            continue
        if at[0] == HORIZON:
            raise UnsupportedError(
                f"the effect on {show(key)} at the plan's end: no executive could keep it"
            )
        time = planned.time(at[0]) + at[1]
        found.setdefault(key, []).append(_Write(at[0], at[1], time, effect.owner, effect))
    return found


def _after_zero(key: Expr, writes: list[_Write]) -> Iterator[OrderConstraint]:
    """No effect comes before the plan's start."""
    for w in writes:
        if w.delay < 0 and w.point != ZERO:
            why = f"{_who(w)} sets {show(key)} after the plan's start"
            yield OrderConstraint(Difference(ZERO, w.point, -w.delay), "fluent", why)


Asked = tuple[Condition, tuple[Point, int], tuple[Point, int]]
"""A condition, and the points and delays from which and until which it is asked for."""


def _asked(planned: Planned) -> list[Asked]:
    """Return the conditions that are asked for at all.

    Raises ``UnsupportedError`` for times before the plan's end: these are no differences.
    """
    found: list[Asked] = []
    for condition in planned.problem.conditions:
        low, high = planned.point(condition.low), planned.point(condition.high)
        if not planned.there(condition.owner) or low is None or high is None:
            continue
        if any(point == HORIZON and delay < 0 for point, delay in (low, high)):
            raise UnsupportedError(
                f"{_named(condition)} before the plan's end: no executive could keep it"
            )
        found.append((condition, low, high))
    return found


def _idle(planned: Planned, writes: Mapping[Expr, list[_Write]], asked: list[Asked]) -> list[Asked]:
    """Return what is asked over intervals that are empty as planned and have to stay so. Of others
    all that is asked is so, and can be kept should something take longer.
    """
    times = sorted({w.time for some in writes.values() for w in some})
    last = 1 + max([planned.makespan, *times])  # in conditions the plan's end comes after all
    found: list[Asked] = []
    empty: list[tuple[int, Asked]] = []
    for one in asked:
        begin, end = (
            (last if point == HORIZON else planned.time(point)) + delay for point, delay in one[1:]
        )
        if end < begin and any(end < t < begin for t in times):
            found.append(one)
        elif end < begin:
            empty.append((begin, one))
    empty.sort(key=lambda e: -e[0])
    now = planned
    for time, now in _replayed(planned, writes, last) if empty else ():
        while empty and empty[-1][0] <= time:
            found += _false(now, empty.pop()[1])
    return found + [one for _, left in empty for one in _false(now, left)]


def _false(now: Planned, one: Asked) -> list[Asked]:
    return [one] if kept(now, one[0].expression) is None else []


def _as_short(idle: list[Asked]) -> Iterator[OrderConstraint]:
    """Intervals that have to stay empty."""
    for condition, (low, since), (high, until) in idle:
        if HORIZON in (low, high):
            raise UnsupportedError(
                f"{_named(condition)} does not hold at the plan's end, which comes too soon: no "
                "executive could keep it"
            )
        if low != high:
            why = f"nothing is asked by the {_named(condition)}"
            yield OrderConstraint(Difference(high, low, until - since + 1), "fluent", why)


def _named(condition: Condition) -> str:
    return f"condition '{_short(condition.expression)}' of {condition.owner or 'the problem'}"


def _reads(planned: Planned, asked: list[Asked]) -> dict[Expr, list[_Read]]:
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

    for condition, low, high in asked:
        what = _named(condition)
        read = _Read(low, high, condition.owner, what, low[1] >= 1, condition.dense)
        add((condition.expression,), read)
    for effect in planned.problem.effects:
        if not planned.there(effect.owner):
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
    """Producers before the reader, the next writer after it: what is written at the reader's last
    instant it does not see.
    """
    (low, dl), (high, dh) = read.low, read.high
    begin, end = planned.time(low) + dl, planned.time(high) + dh
    if high == HORIZON:
        end = max([end, *(w.time for w in writes)]) + 1
    before = [w for w in writes if w.time < begin or (low == HORIZON and w.time <= end)]
    after = [w for w in writes if w.time >= max(begin, end)]  # it may be empty
    if not every:
        # of the others' the next ones: the rest comes before or after those
        last = max((w.time for w in before if w.owner != read.owner), default=0)
        others = [w.time for w in after if w.time > end and w.owner != read.owner]
        before = [w for w in before if w.time >= last]
        after = [w for w in after if not others or w.time <= min(others)]
    for w in before:
        lag = w.delay - dl + 1
        if low != HORIZON and _matter(planned, w.point, low, lag):
            need = Difference(w.point, low, lag) if read.open_low else _dense(w.point, low, lag)
            why = f"{w.owner or 'the problem'} sets {show(key)} for the {read.what}"
            yield OrderConstraint(need, "fluent", why)
    for w in after:
        lag = dh - w.delay + (w.time > end)
        if high != HORIZON and _matter(planned, high, w.point, lag):
            plain = read.open_high or w.time == end
            need = Difference(high, w.point, lag) if plain else _dense(high, w.point, lag)
            why = f"{w.owner or 'the problem'} changes {show(key)} only after the {read.what}"
            yield OrderConstraint(need, "fluent", why)


def _matter(planned: Planned, first: Point, then: Point, lag: int) -> bool:
    """Return whether it has to be stated that ``then`` comes ``lag`` units after ``first``: an
    activity's end comes after its start.
    """
    name = first[1]
    if first != ("start", name) or then != ("end", name):
        return first != then
    return lag > _least(planned, name)


def _least(planned: Planned, name: str) -> int:
    """Return how long (units) an activity lasts at least."""
    lower = planned.problem.activity(name).lower
    if any(e[0] == "flu" for e in subexpressions(lower)):
        return planned.times[name][1] - planned.times[name][0]
    form = planned.linear(lower)
    return 0 if form is None or form.coefficients else max(0, form.constant)


def _in_order(planned: Planned, key: Expr, writes: list[_Write]) -> Iterator[OrderConstraint]:
    """Changes of one fluent at different instants happen in the plan's order."""
    instants = sorted({w.time for w in writes})
    for one, two in itertools.pairwise(instants):
        first, then = ([w for w in writes if w.time == time] for time in (one, two))
        for w, v in itertools.product(first, then):
            lag = w.delay - v.delay + 1
            if _matter(planned, w.point, v.point, lag):
                need = _dense(w.point, v.point, lag)
                why = f"{_who(w)} sets {show(key)} before {_who(v)} does"
                yield OrderConstraint(need, "fluent", why)


def _who(write: _Write) -> str:
    return write.owner or "the problem"


# ------------------------------------------------------------------ several changes at one instant


Groups = list[list[_Write]]
"""Increases and decreases of a fluent at one instant, by several activities: they add up, and
bounds are looked at after all of them. On the floor one happens after the other; those that are one
event there belong together."""
Moment = tuple[Expr, Groups]


def _several_at_once(writes: list[_Write]) -> Iterator[tuple[int, Groups]]:
    for time, some in itertools.groupby(writes, key=lambda w: w.time):
        together = grouped(some, attrgetter("point", "delay"))
        if len(together) > 1:
            yield time, list(together.values())


def _at_once(
    planned: Planned, writes: Mapping[Expr, list[_Write]], moments: Mapping[int, list[Moment]]
) -> Iterator[OrderConstraint]:
    """Give-back and take at one instant: in an order in which all values are within bounds. Where
    there is none, each waits for the other.
    """
    if not moments:
        return
    for time, now in _replayed(planned, writes, max(moments)):
        for key, groups in moments.get(time, ()):
            blocks = _sequence(now, key, groups)
            for one, two in itertools.pairwise(blocks):
                for w, v in itertools.product(one, two):
                    if w.point != v.point:
                        need = Difference(w.point, v.point, w.delay - v.delay)
                        why = f"{_who(w)} changes {show(key)} at once with {_who(v)}"
                        yield OrderConstraint(need, "fluent", f"{why}, and first")


def _replayed(
    planned: Planned, writes: Mapping[Expr, list[_Write]], until: int
) -> Iterator[tuple[int, Planned]]:
    """Yield every instant with effects, with the fluents as they are right before it."""
    state: dict[Expr, Expr] = dict(planned.problem.initial)
    now = replace(planned, problem=replace(planned.problem, initial=state))
    by_time: dict[int, list[tuple[Expr, _Write]]] = {}
    for key, some in writes.items():
        for w in some:
            by_time.setdefault(w.time, []).append((key, w))
    for time in sorted(t for t in by_time if t <= until):
        yield time, now
        later: dict[Expr, Expr] = {}
        for key, w in by_time[time]:
            if kept(now, w.effect.condition) is None:
                continue
            if w.effect.kind == "assign":
                later[key] = w.effect.value
                if w.effect.value[0] not in ("bool", "int", "obj"):
                    later[key] = _constant(now, w.effect.value)
            else:
                old = later.get(key, now.problem.initial_value(key))
                later[key] = _constant(now, (_SIGN[w.effect.kind], old, w.effect.value))
        state.update(later)


_SIGN = {"increase": "plus", "decrease": "minus"}


def _constant(now: Planned, e: Expr) -> Expr:
    """Return what an expression is worth, as a constant."""
    value = MISSING
    if e[0] not in ("plus", "minus", "times", "time"):
        value = now.value(e)
    elif (form := now.linear(e)) is not None:
        value = form.constant + sum(k * now.time(p) for p, k in form.coefficients.items())
    if value is MISSING:
        raise UnsupportedError(f"'{show(e)}' has no value, but an effect needs one")
    return constant(value)


def _sequence(now: Planned, key: Expr, groups: Groups) -> Groups:
    """Return groups of writes, each to come before the next (none: any order does)."""
    amounts: list[int] = []
    for group in groups:
        total = 0
        for w in group:
            kind = _SIGN.get(w.effect.kind)  # where one assigns no other one happens
            if kind is not None and kept(now, w.effect.condition) is not None:
                total += int(_constant(now, (kind, ("int", 0), w.effect.value))[1])
        amounts.append(total)
    type_ = now.problem.fluents[key[1]].type
    low, high = (type_[1], type_[2]) if type_[0] == "int" else (None, None)
    here = int(_constant(now, key)[1]) if type_[0] == "int" else 0
    up, down = sum(a for a in amounts if a > 0), sum(a for a in amounts if a < 0)
    fits_up, fits_down = high is None or here + up <= high, low is None or here + down >= low
    hangs = _depends(key, groups)
    if fits_up and fits_down and not hangs:
        return []
    order = None if hangs else _within(here, amounts, low, high)
    if order is None:
        everybody = [w for group in groups for w in group]
        return [everybody, everybody]  # each waits for the other
    blocks = [
        [w for k in run for w in groups[k]]
        for _, run in itertools.groupby(order, key=lambda k: amounts[k] > 0)
    ]
    return blocks


def _depends(key: Expr, groups: Groups) -> bool:
    """Return whether one of the changes hangs on the value that the others change."""
    return any(
        sub[:2] == key[:2]
        for group in groups
        for w in group
        for e in (w.effect.condition, w.effect.value)
        for sub in subexpressions(e)
    )


def _within(here: int, amounts: list[int], low: int | None, high: int | None) -> list[int] | None:
    """Return an order of amounts in which all sums are within bounds, with few turns from giving to
    taking (``None``: there is none).
    """
    dead: set[frozenset[int]] = set()

    def rest(value: int, left: frozenset[int], rising: bool) -> list[int] | None:
        if not left:
            return []
        if left in dead:
            return None
        for k in sorted(left, key=lambda k: ((amounts[k] > 0) != rising, -abs(amounts[k]), k)):
            then = value + amounts[k]
            if (low is None or then >= low) and (high is None or then <= high):
                found = rest(then, left - {k}, amounts[k] > 0)
                if found is not None:
                    return [k, *found]
        dead.add(left)
        return None

    return rest(here, frozenset(range(len(amounts))), rising=True)


def _capacity(planned: Planned, key: Expr, writes: list[_Write]) -> int | None:
    """Return how much there is of a resource that activities take at their start and give back at
    their end (``None``: the fluent is something else).
    """
    type_ = planned.problem.fluents[key[1]].type
    if type_[0] != "int" or amounts_taken(w.effect for w in writes) is None:
        return None
    initial = planned.value(planned.problem.initial_value(key))
    return int(initial - (type_[1] if type_[1] is not None else 0))


def _for_no_time(key: Expr, users: list[str]) -> Iterator[OrderConstraint]:
    """Uses of a resource that last no time go on to: they take nothing from anybody."""
    for name in users:
        need = Difference(("end", name), ("start", name), 0)
        yield OrderConstraint(need, "duration", f"{name} takes {show(key)} for no time")


def _chained(
    planned: Planned, key: Expr, writes: list[_Write], capacity: int
) -> Iterator[OrderConstraint]:
    """Whose units an activity takes over (chaining: Policella et al. 2004)."""
    amount: dict[str, int] = {}
    for w in writes:
        if w.point[0] == "start" and w.owner is not None:
            amount[w.owner] = amount.get(w.owner, 0) + w.effect.value[1]
    # a use that lasts no time takes nothing
    users = sorted(
        (n for n in amount if planned.times[n][0] < planned.times[n][1]),
        key=lambda n: (planned.times[n], n),
    )
    yield from _for_no_time(key, sorted(amount.keys() - set(users)))
    if not users:
        return
    sizes = sorted(amount[n] for n in users)
    alone = sizes[-1] <= capacity < sum(sizes[:2])
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
