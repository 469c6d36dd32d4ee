"""Constraints as differences between two points in time, chosen so that the plan keeps them; and
the earliest times under such differences.

A disjunction is kept by keeping one of its parts that the plan makes true (as a partial-order
schedule does, Policella et al., "Generating robust schedules through temporal flexibility", ICAPS
2004). Absent activities stay absent: what speaks of them has no value (Kleene), and a constraint
is broken only where it is false.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.constraints import Linear, linear
from up_samp.scheduling.compilers.plain import (
    Expr,
    PlainProblem,
    folded,
    rewrite,
    show,
    subexpressions,
)

Point = tuple[str, str]
"""``("start" | "end", activity)``; ``ZERO`` is the plan's start."""

ZERO: Point = ("zero", "")
HORIZON: Point = ("horizon", "")
"""The plan's end (``GlobalEnd``)."""


MOST_WAYS = 8
"""A constraint that can be kept in more ways is no choice of two orders."""


MISSING: Any = object()
"""The value of what has none."""


@dataclass(frozen=True)
class Difference:
    """``then`` is at least ``lag`` units after ``first`` (``strict``: more than that)."""

    first: Point
    then: Point
    lag: int
    strict: bool = False


@dataclass(frozen=True)
class Planned:
    """A problem under a plan: ``times`` (start, end; units) of present activities, ``values`` of
    parameters and variables.
    """

    problem: PlainProblem
    times: Mapping[str, tuple[int, int]]
    values: Mapping[str, Any]

    @property
    def makespan(self) -> int:
        """The latest end."""
        return max((end for _, end in self.times.values()), default=0)

    def there(self, owner: str | None) -> bool:
        """Return whether an activity is present (None: the problem itself always is)."""
        return owner is None or owner in self.times

    def time(self, point: Point) -> int:
        """Return when a point in time is, as planned (units)."""
        anchor, name = point
        if anchor == "zero":
            return 0
        if anchor == "horizon":
            return self.makespan
        return self.times[name][0 if anchor == "start" else 1]

    def point(self, expression: Expr) -> tuple[Point, int] | None:
        """Return the point and the delay of a ``time`` expression (``None``: it is absent)."""
        _, anchor, name, delay = expression
        if anchor in ("start", "end") and name not in self.times:
            return None
        return (anchor, name or ""), delay

    def linear(self, e: Expr) -> Linear | None:
        """Return an arithmetic expression over points in time (``None``: it has no value)."""
        lost = False

        def put(part: Expr) -> Expr | None:
            nonlocal lost
            if part[0] == "time":
                lost = lost or self.point(part) is None
            elif part[0] in ("par", "flu"):
                value = self.value(part)
                lost = lost or value is MISSING
                return ("int", value)
            return None

        told = rewrite(e, put)
        if lost:
            return None
        form = linear(told)
        points = {(anchor, name or ""): k for (_, anchor, name, _), k in form.coefficients.items()}
        return Linear(points, form.constant)

    def value(self, e: Expr) -> Any:
        """Return the value of an expression without points in time, else ``MISSING``."""
        kind = e[0]
        if kind in ("bool", "int", "obj"):
            return e[1]
        if kind == "par":
            return self.values.get(e[1], MISSING)
        if kind == "pres":
            return e[1] in self.times
        if kind == "flu":
            key = self.ground(e)
            if key is None:
                return MISSING
            return self.value(self.problem.initial_value(key))
        raise UnsupportedError(f"'{show(e)}' in a constraint")

    def ground(self, e: Expr) -> Expr | None:
        """Return a fluent expression with its arguments put in (``None``: one is missing)."""
        arguments = []
        for argument in e[2:]:
            value = self.value(argument)
            if value is MISSING:
                return None
            arguments.append(constant(value))
        return ("flu", e[1], *arguments)


def constant(value: Any) -> Expr:
    """Return a truth value (which equals 0 or 1, too), a number or a name as an expression."""
    if isinstance(value, bool):
        return ("bool", value)
    return ("int", value) if isinstance(value, int) else ("obj", value)


def kept(planned: Planned, e: Expr, positive: bool = True) -> list[Difference] | None:
    """Return differences that the plan keeps and that keep ``e`` from being false (from being true
    if not ``positive``); ``None`` where the plan itself breaks it.
    """

    def every(parts: Iterable[list[Difference] | None]) -> list[Difference] | None:
        found: list[Difference] = []
        for part in parts:
            if part is None:
                return None
            found += part
        return found

    def some(parts: Iterable[list[Difference] | None]) -> list[Difference] | None:
        known = (p for p in parts if p is not None)
        return min(known, key=lambda p: _cost(planned, p), default=None)

    def leaf(part: Expr, sign: bool) -> list[Difference] | None:
        pair = _two_ways(planned, part)
        return _kept_leaf(planned, part, sign) if pair is None else fold(pair, sign)

    def fold(part: Expr, sign: bool) -> list[Difference] | None:
        return folded(part, leaf, every, some, sign)

    return fold(e, positive)


def _two_ways(planned: Planned, e: Expr) -> Expr | None:
    """Return an equality of numbers as two comparisons (``None``: it is none)."""
    if e[0] != "eq" or planned.problem.kind(e[1]) != "int":
        return None
    return ("and", ("le", e[1], e[2]), ("le", e[2], e[1]))


def _kept_leaf(planned: Planned, e: Expr, positive: bool) -> list[Difference] | None:
    if e[0] not in ("le", "lt"):
        return [] if _may_be(planned, e, positive) else None
    form, strict = _compared(planned, e, positive)
    if form is None:
        return []
    total = form.constant + sum(k * planned.time(p) for p, k in form.coefficients.items())
    if total > 0 or (strict and total == 0):
        return None
    if not form.coefficients:
        return []
    need = _difference(form, strict)
    if need is None:
        raise UnsupportedError(
            f"'{show(e)}' is no difference of two points in time: no executive could keep it"
        )
    if need.then != HORIZON or need.first == HORIZON:
        return [need]
    if need.lag + need.strict <= 0:
        return []  # everything ends by the plan's end
    last = max(planned.times, key=lambda name: (planned.times[name][1], name))
    return [replace(need, then=("end", last))]


def _may_be(planned: Planned, e: Expr, positive: bool) -> bool:
    """Return whether something without times is what is wanted, or has no value."""
    if e[0] == "eq":
        left, right = map(planned.value, e[1:])
        return MISSING in (left, right) or (left == right) == positive
    value = planned.value(e)
    return bool(value is MISSING or value == positive)


def _cost(planned: Planned, needs: list[Difference]) -> tuple[int, int, float]:
    """Prefer what asks for nothing, then what can be enforced, then what leaves most room."""
    loose = sum(planned.time(d.then) < planned.time(d.first) for d in needs)
    room = min((planned.time(d.then) - planned.time(d.first) - d.lag for d in needs), default=0)
    return loose, len(needs), -room


def _compared(planned: Planned, e: Expr, positive: bool) -> tuple[Linear | None, bool]:
    """Return (form, strict) of a comparison ``form <= 0`` (``strict``: ``< 0``)."""
    kind, x, y = e
    if not positive:  # not x <= y: y < x
        kind, x, y = ("lt" if kind == "le" else "le"), y, x
    left, right = planned.linear(x), planned.linear(y)
    form = None if left is None or right is None else left.add(right, -1)
    return form, kind == "lt"


def _difference(form: Linear, strict: bool) -> Difference | None:
    """Return ``form <= 0`` as a difference of two points, if it is one."""
    plus = [p for p, k in form.coefficients.items() if k == 1]
    minus = [p for p, k in form.coefficients.items() if k == -1]
    if len(plus) + len(minus) != len(form.coefficients) or max(len(plus), len(minus)) > 1:
        return None
    return Difference((plus or [ZERO])[0], (minus or [ZERO])[0], form.constant, strict)


def other_way(planned: Planned, e: Expr, needs: list[Difference]) -> Difference | None:
    """Return the other difference that would keep ``e``, where there are exactly two and the plan
    keeps the one in ``needs``.
    """
    if len(needs) != 1 or any(part[0] in ("iff", "eq") for part in subexpressions(e)):
        return None
    found = folded(e, partial(_ways_of_leaf, planned), _products, _unions)
    if found is None or len(found) != 2 or needs not in found:
        return None
    others = [way for way in found if way != needs]
    return others[0][0] if others and len(others[0]) == 1 else None


Ways = list[list[Difference]] | None
"""All ways to keep something, also those that the plan does not take; ``None`` where there are too
many, or they are no differences of two activities' times."""


def _ways_of_leaf(planned: Planned, e: Expr, positive: bool) -> Ways:
    form, strict = _compared(planned, e, positive) if e[0] in ("le", "lt") else (None, False)
    if form is None or not form.coefficients:
        here = _kept_leaf(planned, e, positive)
        return [] if here is None else [here]
    need = _difference(form, strict)
    return None if need is None or ZERO in (need.first, need.then) else [[need]]


def _known(parts: Iterable[Ways]) -> list[list[list[Difference]]] | None:
    some = list(parts)
    known = [p for p in some if p is not None]
    return known if len(known) == len(some) else None


def _products(parts: Iterable[Ways]) -> Ways:
    known = _known(parts)
    if known is None:
        return None
    every = itertools.islice(itertools.product(*known), MOST_WAYS + 1)
    found = [[d for way in ways for d in way] for ways in every]
    return found if len(found) <= MOST_WAYS else None


def _unions(parts: Iterable[Ways]) -> Ways:
    known = _known(parts)
    if known is None:
        return None
    found = [way for ways in known for way in ways]
    found = [[]] if [] in found else found
    return found if len(found) <= MOST_WAYS else None


# ------------------ Earliest times of points, as some of them become known later than expected
# A simple temporal network (Dechter, Meiri and Pearl, 1991) that is only ever pushed forward: its
# points start at their earliest times, and whoever raises one raises what depends on it.


class Earliest:
    """Earliest integer times of the starts and ends of ``names`` under ``differences``.

    ``feasible`` is false where no times keep them all. Its own ``differences`` are these, but the
    plan's end, and that nothing ends before it starts, nor after the plan.
    """

    def __init__(self, names: Iterable[str], differences: Iterable[Difference]) -> None:
        self.times: dict[Point, int] = {ZERO: 0, HORIZON: 0}
        self.differences = [d for d in differences if d.then != HORIZON]
        for name in names:
            start, end = ("start", name), ("end", name)
            self.times[start] = self.times[end] = 0
            self.differences += (Difference(start, end, 0), Difference(end, HORIZON, 0))
        self._after: dict[Point, list[tuple[Point, int]]] = {point: [] for point in self.times}
        self._pinned: set[Point] = {ZERO}
        for d in self.differences:
            self._after[d.first].append((d.then, d.lag + d.strict))
        self.feasible = self._push(list(self.times)) is not None

    def after(self, point: Point) -> list[Point]:
        """Return the points that may not come before a point."""
        return [then for then, lag in self._after[point] if lag >= 0]

    def released(self) -> set[Point]:
        """Return the points that come no later than when they are released."""
        return {then for then, lag in self._after[ZERO] if 0 < lag == self.times[then]}

    def slack(self, name: str) -> int:
        """Return by how much an activity may end later with nothing else any later, but the plan's
        end and its own start.
        """
        end = "end", name
        free = {("start", name), HORIZON}
        some = (self.times[p] - lag for p, lag in self._after[end] if p not in free)
        return min(some, default=self.times[end]) - self.times[end]

    def latest(self) -> dict[Point, float]:
        """Return when each point may be at the latest, with all others free (inf: any time)."""
        before: dict[Point, list[tuple[Point, int]]] = {point: [] for point in self._after}
        for first, then in self._after.items():
            for point, lag in then:
                before[point].append((first, lag))
        found = dict.fromkeys(self._after, math.inf)
        found[ZERO] = 0.0
        todo = deque([ZERO])
        while todo:
            point = todo.popleft()
            for first, lag in before[point]:
                if found[point] - lag < found[first]:
                    found[first] = found[point] - lag
                    todo.append(first)
        return found

    def raised(self, wanted: dict[Point, int], *, pin: bool = False) -> bool:
        """Let points come no sooner than ``wanted``, and with ``pin`` exactly then, for good.

        Return false, with nothing changed, where the differences or pinned points forbid that.
        """
        before = {p: self.times[p] for p in wanted}
        if any(p in self._pinned and t != before[p] for p, t in wanted.items()):
            return False
        if pin and any(t < before[p] for p, t in wanted.items()):
            return False
        self.times.update({p: max(t, before[p]) for p, t in wanted.items()})
        added = wanted.keys() - self._pinned if pin else set()
        self._pinned |= added
        changed = self._push(list(wanted))
        if changed is None:
            self._pinned -= added
            self.times.update(before)
            return False
        return True

    def state(self) -> tuple[dict[Point, int], set[Point]]:
        """Return all times, and which of them are pinned, to go back to (:meth:`restore`)."""
        return dict(self.times), set(self._pinned)

    def restore(self, state: tuple[dict[Point, int], set[Point]]) -> None:
        """Go back to a state that was before."""
        times, pinned = state
        self.times, self._pinned = dict(times), set(pinned)

    def _push(self, since: list[Point]) -> dict[Point, int] | None:
        """Raise what depends on some points; return what was changed, or None (and nothing is) if
        that has no end or moves what is pinned.
        """
        old: dict[Point, int] = {}
        count: dict[Point, int] = {}
        queue, waiting = deque(since), set(since)
        while queue:
            point = queue.popleft()
            waiting.discard(point)
            time = self.times[point]
            for then, lag in self._after[point]:
                if self.times[then] >= time + lag:
                    continue
                count[then] = count.get(then, 0) + 1
                if then in self._pinned or count[then] > len(self.times):
                    self.times.update(old)
                    return None
                old.setdefault(then, self.times[then])
                self.times[then] = time + lag
                if then not in waiting:
                    waiting.add(then)
                    queue.append(then)
        return old
