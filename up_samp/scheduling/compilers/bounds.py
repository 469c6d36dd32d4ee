"""Earliest and latest times that constraints on single timepoints give."""

from __future__ import annotations

from up_samp.scheduling.compilers.expressions import FALSE, TRUE, Expr
from up_samp.scheduling.compilers.plain import PlainProblem

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

    def decide(self, atom: Expr) -> Expr:
        """Return the comparison, or its truth value if the bounds decide it."""
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
