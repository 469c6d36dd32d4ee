"""What constraints settle at once: activities that must or cannot be present, fixed switches,
times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from up_samp.model import CandidateSchedule
from up_samp.model.schedule import Value
from up_samp.scheduling.compilers.plain import (
    FALSE,
    TRUE,
    Compiled,
    Expr,
    PlainProblem,
    evaluate,
    rewrite,
)

_FOREVER = 10**12


class TimeBounds:
    """Bounds of each start and end, given that the activity is present."""

    def __init__(self, problem: PlainProblem, constraints: list[Expr]):
        self.low: dict[Expr, int] = {}
        self.high: dict[Expr, int] = {}
        for constraint in constraints:
            self._take(_under_presence(constraint))
        for activity in problem.activities:
            begin, finish = ("time", "start", activity.name, 0), ("time", "end", activity.name, 0)
            shortest = activity.lower[1] if activity.lower[0] == "int" else 0
            longest = activity.upper[1] if activity.upper[0] == "int" else _FOREVER
            low, high = self.low.get(begin, 0), self.high.get(begin, _FOREVER)
            self.low[finish] = max(self.low.get(finish, 0), low + shortest)
            self.high[finish] = min(self.high.get(finish, _FOREVER), high + longest)
            self.low[begin] = max(low, self.low[finish] - longest)
            self.high[begin] = min(high, self.high[finish] - shortest)

    def _take(self, atom: Expr | None) -> None:
        if atom is None or atom[0] != "le":
            return
        left, right = atom[1:]
        if left[0] == "time" and right[0] == "int":
            key = (*left[:3], 0)
            self.high[key] = min(self.high.get(key, _FOREVER), right[1] - left[3])
        elif left[0] == "int" and right[0] == "time":
            key = (*right[:3], 0)
            self.low[key] = max(self.low.get(key, 0), left[1] - right[3])

    def _range(self, e: Expr) -> tuple[int, int] | None:
        if e[0] == "int":
            return e[1], e[1]
        key = (*e[:3], 0)
        if e[0] != "time" or key not in self.low:
            return None
        high = self.high[key]
        return self.low[key] + e[3], high if high >= _FOREVER else high + e[3]

    def decide(self, atom: Expr) -> Expr | None:
        """Return a comparison, or its truth value if the bounds decide it (``None``: no such)."""
        if atom[0] != "le":
            return None
        left, right = self._range(atom[1]), self._range(atom[2])
        if left is None or right is None:
            return atom
        if left[0] > right[1]:
            return FALSE
        return TRUE if left[1] <= right[0] else atom


def _under_presence(constraint: Expr) -> Expr | None:
    """Return what holds of an activity if it is present: ``c`` or ``c or not present(a)``."""
    if constraint[0] == "le":
        return constraint
    if constraint[0] == "or" and len(constraint) == 3:
        for guard, atom in (constraint[1:], constraint[:0:-1]):
            if guard[0] == "not" and guard[1][0] == "pres" and atom[0] == "le":
                owners = {e[2] for e in atom[1:] if e[0] == "time"}
                if owners == {guard[1][1]}:
                    return tuple(atom)
    return None


def is_bound(constraint: Expr) -> bool:
    """Return whether a constraint itself is a bound (and so must be kept)."""
    atom = _under_presence(constraint)
    return atom is not None and "int" in (atom[1][0], atom[2][0])


def compile_settled(problem: PlainProblem) -> Compiled:
    """Return the problem without the presences and boolean parameters that are settled."""
    constraints = list(problem.constraints)
    settled: dict[Expr, bool] = {}
    while True:
        bounds = TimeBounds(problem, constraints)
        constraints = _flat(
            c if is_bound(c) else evaluate(rewrite(c, bounds.decide)) for c in constraints
        )
        units = {}
        for constraint in constraints:
            literal, sign = (constraint[1], False) if constraint[0] == "not" else (constraint, True)
            if literal[0] in ("pres", "par"):
                units[literal] = sign
        if not units:
            break
        settled.update(units)
        simplify = _simplified(units)
        constraints = _flat(simplify(c) for c in constraints)
    if FALSE in constraints:
        constraints = [FALSE]
    return _rebuilt(problem, constraints, settled)


def _flat(constraints: Iterable[Expr]) -> list[Expr]:
    """Return the conjuncts, each once."""
    flat: dict[Expr, None] = {}
    for constraint in constraints:
        flat.update(dict.fromkeys(constraint[1:] if constraint[0] == "and" else (constraint,)))
    flat.pop(TRUE, None)
    return list(flat)


def _rebuilt(problem: PlainProblem, constraints: list[Expr], settled: dict[Expr, bool]) -> Compiled:
    gone = {e[1] for e, sign in settled.items() if e[0] == "pres" and not sign}
    certain = {e[1] for e, sign in settled.items() if e[0] == "pres" and sign}
    values: dict[str, Value] = {e[1]: sign for e, sign in settled.items() if e[0] == "par"}
    simplify = _simplified(settled)
    activities = tuple(
        replace(
            a,
            optional=a.optional and a.name not in certain,
            parameters=tuple(p for p in a.parameters if p[0] not in values),
        )
        for a in problem.activities
        if a.name not in gone
    )
    left = replace(problem, activities=(), constraints=()).mapped(simplify)
    compiled = replace(
        problem,
        activities=activities,
        constraints=tuple(constraints),
        conditions=tuple(
            c for c in left.conditions if c.expression != TRUE and c.owner not in gone
        ),
        effects=tuple(e for e in left.effects if e.condition != FALSE and e.owner not in gone),
        variables={n: t for n, t in problem.variables.items() if n not in values},
    )

    def map_back(schedule: CandidateSchedule) -> CandidateSchedule:
        return CandidateSchedule(schedule.times, {**schedule.parameters, **values})

    return Compiled(compiled, map_back)


def _simplified(settled: dict[Expr, bool]) -> Callable[[Expr], Expr]:
    """Return what puts constants for settled literals into expressions."""
    gone = {literal[1] for literal, sign in settled.items() if literal[0] == "pres" and not sign}

    def leaf(e: Expr) -> Expr | None:
        if e in settled:
            return ("bool", settled[e])
        # where such a comparison is not guarded by the absence, it counts with presence only
        broken = e[0] == "le" and any(x[0] == "time" and x[2] in gone for x in e[1:])
        return FALSE if broken else None

    return lambda e: evaluate(rewrite(e, leaf))
