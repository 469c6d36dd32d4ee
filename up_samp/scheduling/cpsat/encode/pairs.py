"""Disjunctions between pairs of activities: recognised, and stated as NoOverlaps."""

from __future__ import annotations

import itertools
from dataclasses import replace

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.timing import TimepointKind

from up_samp.scheduling.cpsat.encode.alternatives import Alternatives
from up_samp.scheduling.cpsat.encode.cliques import clique_cover, graph_of
from up_samp.scheduling.cpsat.encode.forms import TRUE, Cmp, Form, Lin, indicator_sum
from up_samp.scheduling.cpsat.encode.limits import LIMITS
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.store import Store
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.unary import Unary

Owners = dict[int, list[ActivityVars]]
"""Time variable -> the activities that have it (alternatives share theirs)."""


class Disjunctions:
    """Which pairs of activities never overlap, and by how much they are apart."""

    def __init__(self) -> None:
        self.gaps: dict[tuple[int, int], int] = {}
        self.cliques: list[tuple[int, list[ActivityVars]]] = []
        self.members: list[frozenset[int]] = []
        self.unary: list[tuple[int, set[int]]] = []
        """Unary resources: gap and activities (indices), alternatives of each other included."""
        self.groups: list[list[ActivityVars]] = []
        """Alternatives: of each list one is present, all with the same times."""
        self.exclusive: set[tuple[int, int]] = set()
        """Pairs (a, b), a < b, that are never both present."""
        self._activities: list[ActivityVars] = []
        self._timepoints: dict[FNode, tuple[TimepointKind, str] | None] = {}

    def apart(self, activities: frozenset[int]) -> bool:
        """Return whether no two of these activities (indices) ever overlap."""
        if any(activities <= members for members in self.members):
            return True
        order = sorted(activities)
        pairs = itertools.combinations(order, 2)
        return all(pair in self.gaps or pair in self.exclusive for pair in pairs)

    def sets(self) -> list[tuple[int, set[int]]]:
        """Return all sets of activities (indices) that are done one at a time, with their gaps."""
        return [*((gap, {a.index for a in some}) for gap, some in self.cliques), *self.unary]

    def gap(self, a: int, b: int) -> int:
        """Return how far apart two activities (indices) are when both are there; -1 if not."""
        pair = (min(a, b), max(a, b))
        return LIMITS.never if pair in self.exclusive else self.gaps.get(pair, -1)

    def take_alternatives(
        self, groups: list[Alternatives], activities: dict[str, ActivityVars], store: Store
    ) -> dict[int, tuple[int, ...]]:
        """Tell who is never there together; return presence -> presences of its exact group."""
        exact: dict[int, tuple[int, ...]] = {}
        for group in groups:
            members = [activities[name] for name in group.names]
            indices = sorted(a.index for a in members)
            self.exclusive.update(itertools.combinations(indices, 2))
            store.at_most_one([a.present for a in members])
            if group.exact:
                self.groups.append(members)
                exact.update({a.present: tuple(m.present for m in members) for a in members})
        return exact

    def add_written(
        self, constraint: FNode, scope: list[FNode], activities: dict[str, ActivityVars]
    ) -> bool:
        """Remember a constraint that is written as the disjunction of a pair (a short cut for
        the many that there may be); return whether it is one.
        """
        if constraint.node_type is not Op.OR or len(constraint.args) != 2:
            return False
        first, second = self._written(constraint.arg(0)), self._written(constraint.arg(1))
        if first is None or second is None or first != (second[1], second[0], second[2]):
            return False
        a, b = activities.get(first[0]), activities.get(first[1])
        if a is None or b is None or a is b:
            return False
        for node in scope:
            if node.node_type is Op.PRESENT_EXP:
                if node.presence().container not in first:
                    return False
            elif not node.is_true():
                return False
        self._note(a.index, b.index, first[2])
        return True

    def _written(self, node: FNode) -> tuple[str, str, int] | None:
        """Return (a, b, gap) if ``node`` is ``a.end < b.start`` (gap 1) or ``<=`` (gap 0)."""
        kind = node.node_type
        if kind is not Op.LT and kind is not Op.LE:
            return None
        left, right = node.args
        end, start = self._timepoint(left), self._timepoint(right)
        if end is None or start is None:
            return None
        if end[0] is not TimepointKind.END or start[0] is not TimepointKind.START:
            return None
        return end[1], start[1], 1 if kind is Op.LT else 0

    def _timepoint(self, node: FNode) -> tuple[TimepointKind, str] | None:
        """Return which end of which activity ``node`` is, if it is just that."""
        if node.node_type is not Op.TIMING_EXP:
            return None
        if node not in self._timepoints:
            timing = node.timing()
            name = timing.timepoint.container
            plain = timing.delay == 0 and name is not None
            self._timepoints[node] = (timing.timepoint.kind, name) if plain else None
        return self._timepoints[node]

    def add_unary(self, unary: Unary) -> None:
        """Remember that no two members of a unary resource overlap."""
        self.unary.append((unary.gap, set(unary.members)))
        for a, b in itertools.combinations(unary.members, 2):
            if (a, b) not in self.exclusive:
                self._note(a, b, unary.gap)

    def _note(self, a: int, b: int, gap: int) -> None:
        key = (min(a, b), max(a, b))
        self.gaps[key] = max(gap, self.gaps.get(key, 0))

    def take(self, forms: list[Form], activities: list[ActivityVars]) -> list[Form]:
        """Remember the pair disjunctions among ``forms``; return the other forms."""
        self._activities = activities
        starts: Owners = {}
        ends: Owners = {}
        for activity in activities:
            starts.setdefault(activity.start.terms[0][0], []).append(activity)
            ends.setdefault(activity.end.terms[0][0], []).append(activity)
        rest = []
        for form in forms:
            found = _pair(form, starts, ends)
            if found is None:
                rest.append(form)
            else:
                a, b, gap = found
                self._note(a, b, gap)
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
        """State every pair: cliques of three and more as NoOverlap, the others one by one.

        Alternatives that are all kept apart from others are one interval.
        """
        by_gap: dict[int, list[tuple[int, int]]] = {}
        for pair, gap in self.gaps.items():
            by_gap.setdefault(gap, []).append(pair)
        for gap, pairs in sorted(by_gap.items()):
            wider = [pair for pair, other in self.gaps.items() if other > gap]
            done = self._emit_groups(store, gap, {*pairs, *wider})
            for clique in clique_cover(graph_of([*pairs, *wider]), done, wider):
                members = [self._activities[i] for i in clique]
                self.cliques.append((gap, members))
                self.members.append(frozenset(clique))
                store.model.add_no_overlap([_interval(store, a, gap) for a in members])

    def _emit_groups(self, store: Store, gap: int, pairs: set[tuple[int, int]]) -> list[set[int]]:
        """State what holds between whole groups (and what is present anyway); return the sets of
        activities that are kept apart by that.
        """
        single = [[a] for a in self._activities if a.present == TRUE]
        groups = [*self.groups, *single] if self.groups else []
        edges = [
            (i, j)
            for (i, some), (j, others) in itertools.combinations(enumerate(groups), 2)
            if (some[0].present != TRUE or others[0].present != TRUE)
            and all(_ordered(a, b) in pairs for a in some for b in others)
        ]
        done = []
        for clique in clique_cover(graph_of(edges)):
            members = [a for i in clique for a in groups[i]]
            self.cliques.append((gap, members))
            done.append({a.index for a in members})
            heads = [replace(groups[i][0], present=TRUE) for i in clique]
            store.model.add_no_overlap([_interval(store, a, gap) for a in heads])
        return done


def _ordered(a: ActivityVars, b: ActivityVars) -> tuple[int, int]:
    return (min(a.index, b.index), max(a.index, b.index))


def _interval(store: Store, activity: ActivityVars, gap: int) -> object:
    """Return the interval [start, end + gap) of an activity."""
    start = store.expression(activity.start)
    size = store.expression(activity.size.shift(gap))
    end = store.expression(activity.end.shift(gap))
    if activity.present == TRUE:
        return store.model.new_interval_var(start, size, end, "")
    present = store.raw(activity.present)
    return store.model.new_optional_interval_var(start, size, end, present, "")


def _pair(form: Form, starts: Owners, ends: Owners) -> tuple[int, int, int] | None:
    """Return (a, b, gap) if ``form`` says that a and b are ``gap`` or more apart.

    Assumes: both orders are said, with one gap, and nothing else but that one is absent.
    """
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
    cmp: Cmp, starts: Owners, ends: Owners
) -> tuple[ActivityVars, ActivityVars, int] | None:
    """Return (a, b, gap) for ``a.end + gap <= b.start``."""
    if cmp.op != "<=" or len(cmp.terms) != 2:
        return None
    (u, cu), (v, cv) = cmp.terms
    if (cu, cv) == (-1, 1):
        u, v = v, u
    elif (cu, cv) != (1, -1):
        return None
    a, b = _owner(u, ends, cmp), _owner(v, starts, cmp)
    if a is None or b is None or a is b:
        return None
    return a, b, cmp.const - a.end.const + b.start.const


def _owner(var: int, owners: Owners, cmp: Cmp) -> ActivityVars | None:
    """Return whose time ``var`` is: of several alternatives, the one that ``cmp`` needs."""
    found = owners.get(var, [])
    if len(found) > 1:
        found = [a for a in found if a.present in cmp.needs]
    return found[0] if len(found) == 1 else None
