"""Disjunctions between pairs of activities: recognised, and stated as NoOverlaps."""

from __future__ import annotations

from up_samp.scheduling.cpsat.cliques import clique_cover, graph_of
from up_samp.scheduling.cpsat.states import States
from up_samp.scheduling.cpsat.store import TRUE, Cmp, Form, Lin, Store, indicator_sum
from up_samp.scheduling.cpsat.terms import ActivityVars


class Disjunctions:
    """Which pairs of activities never overlap, and by how much they are apart."""

    def __init__(self) -> None:
        self.gaps: dict[tuple[int, int], int] = {}
        self.cliques: list[tuple[int, list[ActivityVars]]] = []
        self._activities: list[ActivityVars] = []

    def apart(self, a: int, b: int) -> bool:
        """Return whether activities ``a`` and ``b`` (indices) never overlap."""
        return a == b or (min(a, b), max(a, b)) in self.gaps

    def take(self, forms: list[Form], activities: list[ActivityVars]) -> list[Form]:
        """Remember the pair disjunctions among ``forms``; return the other forms."""
        self._activities = activities
        starts = {a.start.terms[0][0]: a for a in activities}
        ends = {a.end.terms[0][0]: a for a in activities}
        rest = []
        for form in forms:
            found = _pair(form, starts, ends)
            if found is None:
                rest.append(form)
            else:
                a, b, gap = found
                key = (min(a, b), max(a, b))
                self.gaps[key] = max(gap, self.gaps.get(key, 0))
        return rest

    def emit_loads(self, store: Store, makespan: Lin) -> None:
        """State that what one clique does fits into the makespan.

        It follows from the NoOverlap, but only so does the linear relaxation see it: without it
        the lower bound of a routing problem stays at nothing.
        """
        for gap, members in self.cliques:
            if len(members) > 2:
                load = indicator_sum([(a.present, a.least + gap) for a in members]).shift(-gap)
                store.enforce(load.le(makespan))

    def emit(self, store: Store, states: States) -> None:
        """State every pair: cliques of three and more as NoOverlap, the others one by one."""
        by_gap: dict[int, list[tuple[int, int]]] = {}
        for pair, gap in self.gaps.items():
            by_gap.setdefault(gap, []).append(pair)
        for gap, pairs in sorted(by_gap.items()):
            for clique in clique_cover(graph_of(pairs)):
                members = [self._activities[i] for i in clique]
                self.cliques.append((gap, members))
                store.model.add_no_overlap([_interval(store, a, gap) for a in members])


def _interval(store: Store, activity: ActivityVars, gap: int) -> object:
    """Return the interval [start, end + gap) of an activity."""
    start = store.expression(activity.start)
    size = store.expression(activity.size.shift(gap))
    end = store.expression(activity.end.shift(gap))
    if activity.present == TRUE:
        return store.model.new_interval_var(start, size, end, "")
    present = store.raw(activity.present)
    return store.model.new_optional_interval_var(start, size, end, present, "")


def _pair(
    form: Form, starts: dict[int, ActivityVars], ends: dict[int, ActivityVars]
) -> tuple[int, int, int] | None:
    """Return (a, b, gap) if ``form`` says that a and b are ``gap`` or more apart."""
    if form.__class__ is not tuple or form[0] != "|":
        return None
    comparisons = [f for f in form[1:] if f.__class__ is Cmp]
    if len(comparisons) != 2:
        return None
    first, second = (_precedence(c, starts, ends) for c in comparisons)
    if first is None or second is None or first[:2] != (second[1], second[0]):
        return None
    a, b, gap = first
    if gap != second[2] or gap < 0:
        return None
    absent = {~a.present, ~b.present}
    if any(f.__class__ is not Cmp and f not in absent for f in form[1:]):
        return None
    return a.index, b.index, gap


def _precedence(
    cmp: Cmp, starts: dict[int, ActivityVars], ends: dict[int, ActivityVars]
) -> tuple[ActivityVars, ActivityVars, int] | None:
    """Return (a, b, gap) for ``a.end + gap <= b.start``."""
    if cmp.op != "<=" or len(cmp.terms) != 2:
        return None
    (u, cu), (v, cv) = cmp.terms
    if (cu, cv) == (-1, 1):
        u, v = v, u
    elif (cu, cv) != (1, -1):
        return None
    a, b = ends.get(u), starts.get(v)
    if a is None or b is None or a is b:
        return None
    return a, b, cmp.const - a.end.const + b.start.const
