"""Constraints as differences between two points in time, chosen so that the plan keeps them.

A disjunction is kept by keeping one of its parts that the plan makes true (as a partial-order
schedule does, Policella et al., "Generating robust schedules through temporal flexibility", ICAPS
2004). Absent activities stay absent: what speaks of them has no value (Kleene), and a constraint
is broken only where it is false.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.plain import Expr, PlainProblem, show

Point = tuple[str, str]
"""``("start" | "end", activity)``; ``ZERO`` is the plan's start."""

ZERO: Point = ("zero", "")
HORIZON: Point = ("horizon", "")
"""The plan's end (``GlobalEnd``)."""


MOST_WAYS = 8
"""A constraint that can be kept in more ways is no choice of two orders."""


class _MissingValue:
    def __repr__(self) -> str:
        return "MISSING"


MISSING = _MissingValue()


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

    def linear(self, e: Expr) -> tuple[dict[Point, int], int] | _MissingValue:
        """Return an arithmetic expression as coefficients of points in time and a constant."""
        kind = e[0]
        if kind == "int":
            return {}, e[1]
        if kind == "time":
            found = self.point(e)
            return MISSING if found is None else ({found[0]: 1}, found[1])
        if kind in ("par", "flu"):
            value = self.value(e)
            return MISSING if value is MISSING else ({}, value)
        if kind in ("plus", "minus", "times"):
            parts = [self.linear(x) for x in e[1:]]
            if any(isinstance(p, _MissingValue) for p in parts):
                return MISSING
            return _combined(kind, parts, e)
        raise UnsupportedError(f"'{show(e)}' in a constraint over times")

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


def _combined(kind: str, parts: list[Any], e: Expr) -> tuple[dict[Point, int], int]:
    if kind == "times":
        constants = [c for terms, c in parts if not terms]
        others = [p for p in parts if p[0]]
        if len(others) > 1:
            raise UnsupportedError(f"the product '{show(e)}' of two times")
        factor = 1
        for c in constants:
            factor *= c
        terms, constant = others[0] if others else ({}, 1)
        return {p: factor * k for p, k in terms.items()}, factor * constant
    total: dict[Point, int] = {}
    sum_ = 0
    for i, (terms, constant) in enumerate(parts):
        sign = -1 if kind == "minus" and i > 0 else 1
        sum_ += sign * constant
        for p, k in terms.items():
            total[p] = total.get(p, 0) + sign * k
    return {p: k for p, k in total.items() if k}, sum_


def kept(planned: Planned, e: Expr, positive: bool = True) -> list[Difference] | None:
    """Return differences that the plan keeps and that keep ``e`` from being false (from being true
    if not ``positive``); ``None`` where the plan itself breaks it.
    """
    kind = e[0]
    if kind in ("and", "or"):
        parts = e[1:]
        return (_all if (kind == "and") == positive else _any)(planned, parts, positive)
    if kind == "not":
        return kept(planned, e[1], not positive)
    if kind == "implies":
        return kept(planned, ("or", ("not", e[1]), e[2]), positive)
    if kind == "iff":
        both = ("and", ("implies", e[1], e[2]), ("implies", e[2], e[1]))
        return kept(planned, both, positive)
    if kind in ("le", "lt", "eq"):
        return _relation(planned, e, positive)
    value = planned.value(e)
    return [] if value is MISSING or value == positive else None


def _all(planned: Planned, parts: Any, positive: bool) -> list[Difference] | None:
    found: list[Difference] = []
    for part in parts:
        needs = kept(planned, part, positive)
        if needs is None:
            return None
        found += needs
    return found


def _any(planned: Planned, parts: Any, positive: bool) -> list[Difference] | None:
    options = [kept(planned, part, positive) for part in parts]
    good = [o for o in options if o is not None]
    if not good:
        return None
    return min(good, key=lambda o: _cost(planned, o))


def _cost(planned: Planned, needs: list[Difference]) -> tuple[int, int, float]:
    """Prefer what asks for nothing, then what can be enforced, then what leaves most room."""
    loose = sum(planned.time(d.then) < planned.time(d.first) for d in needs)
    room = min((planned.time(d.then) - planned.time(d.first) - d.lag for d in needs), default=0)
    return loose, len(needs), -room


def _relation(planned: Planned, e: Expr, positive: bool) -> list[Difference] | None:
    kind, x, y = e
    if kind == "eq" and not _is_numeric(planned, x) and not _is_numeric(planned, y):
        left, right = planned.value(x), planned.value(y)
        if MISSING in (left, right):
            return []
        return [] if (left == right) == positive else None
    left, right = planned.linear(x), planned.linear(y)
    if isinstance(left, _MissingValue) or isinstance(right, _MissingValue):
        return []
    if kind == "eq":
        return _equal(planned, e, positive)
    if not positive:  # not x <= y: y < x
        return _relation(planned, ("lt" if kind == "le" else "le", y, x), True)
    terms, constant = _combined("minus", [left, right], e)
    return _at_most_zero(planned, terms, constant, kind == "lt", e)


def _is_numeric(planned: Planned, e: Expr) -> bool:
    if e[0] in ("time", "int", "plus", "minus", "times"):
        return True
    if e[0] in ("obj", "bool", "pres"):
        return False
    value = planned.value(e)
    return isinstance(value, int) and not isinstance(value, bool)


def _equal(planned: Planned, e: Expr, positive: bool) -> list[Difference] | None:
    low, high = ("le", e[1], e[2]), ("le", e[2], e[1])
    if positive:
        return _all(planned, (low, high), True)
    return _any(planned, (low, high), False)


def _at_most_zero(
    planned: Planned, terms: dict[Point, int], constant: int, strict: bool, e: Expr
) -> list[Difference] | None:
    """Return what keeps ``terms + constant <= 0`` (``strict``: ``< 0``)."""
    sum_ = sum(k * planned.time(p) for p, k in terms.items()) + constant
    if sum_ > 0 or (strict and sum_ == 0):
        return None
    if not terms:
        return []
    plus = [p for p, k in terms.items() if k == 1]
    minus = [p for p, k in terms.items() if k == -1]
    if len(plus) + len(minus) != len(terms) or len(plus) > 1 or len(minus) > 1:
        raise UnsupportedError(
            f"'{show(e)}' is no difference of two points in time: no executive could keep it"
        )
    first, then = (plus or [ZERO])[0], (minus or [ZERO])[0]
    # first - then + constant <= 0
    if then == HORIZON and first != HORIZON and constant <= 0:
        return []  # everything ends by the plan's end
    return [Difference(first, then, constant, strict)]


def other_way(planned: Planned, e: Expr, needs: list[Difference]) -> Difference | None:
    """Return the other difference that would keep ``e``, where there are exactly two and the plan
    keeps the one in ``needs``.
    """
    found = _alternatives(planned, e, True)
    if found is None or len(needs) != 1 or len(found) != 2 or needs not in found:
        return None
    others = [way for way in found if way != needs]
    return others[0][0] if others and len(others[0]) == 1 else None


def _alternatives(planned: Planned, e: Expr, positive: bool) -> list[list[Difference]] | None:
    """Return all ways to keep ``e`` from being false, also those that the plan does not take;
    ``None`` where there are too many, or they are no simple differences.
    """
    kind = e[0]
    if kind in ("and", "or"):
        parts = [_alternatives(planned, part, positive) for part in e[1:]]
        known = [p for p in parts if p is not None]
        if len(known) < len(parts):
            return None
        if (kind == "and") != positive:
            found = [way for ways in known for way in ways]
            found = [[]] if [] in found else found
        else:
            found = [[d for way in ways for d in way] for ways in _product(known)]
        return found if len(found) <= MOST_WAYS else None
    if kind == "not":
        return _alternatives(planned, e[1], not positive)
    if kind == "implies":
        return _alternatives(planned, ("or", ("not", e[1]), e[2]), positive)
    if kind in ("le", "lt"):
        return _both_ways(planned, e, positive)
    if kind in ("iff", "eq"):
        return None
    value = planned.value(e)
    return [[]] if value is MISSING or value == positive else []


def _product(parts: list[list[list[Difference]]]) -> list[tuple[list[Difference], ...]]:
    """Return all combinations, no more than can be of use."""
    return list(itertools.islice(itertools.product(*parts), MOST_WAYS + 1))


def _both_ways(planned: Planned, e: Expr, positive: bool) -> list[list[Difference]] | None:
    kind, x, y = e
    if not positive:  # not x <= y: y < x
        kind, x, y = ("lt" if kind == "le" else "le"), y, x
    left, right = planned.linear(x), planned.linear(y)
    if isinstance(left, _MissingValue) or isinstance(right, _MissingValue):
        return [[]]
    terms, constant = _combined("minus", [left, right], e)
    if not terms:
        return [[]] if constant < 0 or (constant == 0 and kind == "le") else []
    plus = [p for p, k in terms.items() if k == 1]
    minus = [p for p, k in terms.items() if k == -1]
    if len(plus) != 1 or len(minus) != 1 or len(terms) != 2:
        return None
    return [[Difference(plus[0], minus[0], constant, kind == "lt")]]
