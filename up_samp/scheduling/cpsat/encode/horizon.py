"""How long a schedule may have to be: a bound that loses neither feasibility nor optimality."""

from __future__ import annotations

from collections.abc import Iterable

from unified_planning.model import FNode

from up_samp.scheduling.cpsat.encode.durations import MAGNITUDE
from up_samp.scheduling.cpsat.encode.forms import Cmp, Form, Lin, comparisons
from up_samp.scheduling.cpsat.encode.store import ModelStore
from up_samp.scheduling.cpsat.encode.terms import ActivityVars, Terms, World, int_bounds
from up_samp.scheduling.cpsat.normal import Precondition


class Horizon:
    """Collects weights into timepoints: in the least solution of differences between times, none is
    later than all weights on a longest path.

    ``spread``: a least solution is not enough, as what lies between two times counts. Then longer
    gaps between instants than any single weight are closed to that: all differences get smaller.
    """

    def __init__(self, store: ModelStore) -> None:
        self.store = store
        self.certain = True
        self.spread = False
        self._instants = 2
        self._widest = 1
        self.origin = 1
        self.total = 1
        self._into: dict[int, int] = {}
        self._length: dict[int, int] = {}

    def activity(self, activity: ActivityVars) -> None:
        """Count an activity: its shortest duration, and an effect or condition beside it."""
        self._note(activity.least, 2)
        start = activity.start.terms[0][0]
        if start in self._length:
            return  # an alternative of one that is counted
        fixed = activity.end.terms == activity.start.terms
        self._length[start] = activity.least if fixed else 0
        self._into.setdefault(start, 0)
        if not fixed:
            self._into.setdefault(activity.end.terms[0][0], max(0, activity.least))
        self.total += activity.least if fixed else 0

    def timepoint(self, var: int) -> None:
        """Count a timepoint that is one of the activities' (the makespan)."""
        self._into.setdefault(var, 0)

    def lasting(self, least: FNode, world: World) -> None:
        """Count an activity that lasts ``least``, by what its parameters and fluents may be."""

        def read(node: FNode) -> Lin:
            return Lin(((self.store.integer(*int_bounds(node.fluent().type)), 1),))

        longest = self.store.range(Terms(world, read).linear(least))[1] + 1
        if longest >= MAGNITUDE:
            self.certain = False
        else:
            self.total += max(0, longest)
            self._note(longest)

    def beside(self, delay: int) -> None:
        """Count an effect or a condition with a delay (gaps of 1 + delay may be needed)."""
        self.total += 2 + abs(delay)
        self._note(2 + abs(delay), 2)

    def preconditions(self, preconditions: Iterable[Precondition]) -> None:
        """Count what is said with precedences: gaps before each activity that is named."""
        for precondition in preconditions:
            rivals = [*precondition.helpers.values(), precondition.initially or frozenset()]
            named = frozenset(precondition.helpers).union(*rivals)
            self.total += 2 + precondition.gap * (1 + len(named))
            self._note(2 + precondition.gap)

    def forms(self, forms: Iterable[Form]) -> None:
        """Count constraints."""
        into, length = self._into, self._length
        for form in forms:
            for cmp in comparisons(form):
                times = [(v, c) for v, c in cmp.terms if v in into]
                if not times:
                    continue
                if len(times) > 2 or any(abs(c) != 1 for _, c in times):
                    self.certain = False
                weight = self._weight(cmp, times)
                self._note(max(weight, abs(cmp.const)))
                if len(times) == 1:
                    self.origin = max(self.origin, weight)
                    continue
                for var, coef in times:
                    if coef < 0 or cmp.op != "<=":
                        other = next((v for v, _ in times if v != var), var)
                        short = weight - length.get(other, 0)
                        into[var] = max(into[var], short if short >= 0 else weight)

    def gap(self, gap: int) -> None:
        """Count a gap that is kept between activities."""
        self._note(gap)

    def _note(self, weight: int, instants: int = 0) -> None:
        self._widest = max(self._widest, weight)
        self._instants += instants

    def _weight(self, cmp: Cmp, times: list[tuple[int, int]]) -> int:
        names = {v for v, _ in times}
        weight = abs(cmp.const) if cmp.op != "<=" else cmp.const
        for var, coef in cmp.terms:
            if var not in names:
                low, high = self.store.bounds[var]
                weight += max(coef * low, coef * high, 0)
        return max(0, weight + (cmp.op == "!=")) if cmp.op == "<=" else abs(weight) + 1

    def bound(self) -> int:
        """Return a time by which a schedule can be over, if there is one at all."""
        longest = self.total + self.origin + sum(self._into.values())
        if self.spread:
            longest = max(longest, self._instants * self._widest)
        return longest if self.certain else 3 * longest + 100
