"""Disjunctions between activities: alternatives of which only one can be there, and pairs that do
not overlap, however they are written; stated as NoOverlaps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity

from up_samp.model import check_time
from up_samp.scheduling.cpsat.encode.forms import (
    Cmp,
    Form,
    Lin,
    Literal,
    ModelStore,
    difference_told,
    disjunction,
    indicator_sum,
    parts_of,
)
from up_samp.scheduling.cpsat.encode.recognition import Unary
from up_samp.scheduling.cpsat.encode.terms import INFINITE, ActivityVars, constant_bounds
from up_samp.scheduling.cpsat.normal import Additions, Decisions, NormalForm, decided, told_together
from up_samp.upio.expressions import end_before_start, walk

Alternatives = tuple[str, ...]
"""Activities of one fixed duration, one of which is present (an optional activity that must be
there is a group of one)."""


def find_groups(form: NormalForm) -> list[Alternatives]:
    """Return disjoint groups of alternatives among the parts of a normal form.

    Assumes: all pairs of a group exclude each other, all last one fixed time, and that one is there
    is said without a condition.
    """
    members = _Members(form)
    exclusive: set[frozenset[str]] = set()
    named: dict[tuple[str, ...], None] = {}
    wanted: dict[tuple[str, ...], None] = {}
    for clause in form.clauses:
        names, signs = tuple(name for name, _ in clause), {sign for _, sign in clause}
        if signs == {True}:
            named.update(dict.fromkeys(members.named(names)))
            wanted.update(dict.fromkeys(members.in_parallel(names)))
        elif signs == {False} and len(names) == 2:
            exclusive |= members.products(names)
    groups, taken = [], set[str]()
    for names in named | wanted:
        apart = all(
            frozenset(pair) in exclusive or members.differ(*pair)
            for pair in itertools.combinations(names, 2)
        )
        same = set(map(members.length, names))
        if apart and len(same) == 1 and None not in same and not taken.intersection(names):
            taken.update(names)
            groups.append(names)
    return groups


class _Members:
    """Which activities are decided about together, by any of their names."""

    def __init__(self, form: NormalForm) -> None:
        parts, presences = form.parts, form.presences
        optional = {a.name for a in parts.activities if a.optional}
        self._presences = presences
        self._of: dict[str, list[str]] = {leader: [] for leader in presences.values()}
        for name, leader in presences.items():
            self._of[leader] += [name] if name in optional else []
        together = {name for names in self._of.values() if len(names) > 1 for name in names}
        self._asked: dict[str, dict[FNode, object]] = {}
        for name, variable, value in _asked_values(parts):
            self._asked.setdefault(presences.get(name, name), {})[variable] = value
        self._lengths = {a.name: _length(a) for a in parts.activities if a.optional}
        self._constants = _constants(parts, together)
        self._own = _own_decisions(form.clauses, optional)

    def of(self, name: str) -> list[str]:
        """Return the activities that are there exactly when ``name`` is."""
        leader = self._presences.get(name, name)
        return self._of.get(leader, [name])

    def differ(self, one: str, other: str) -> bool:
        """Return whether two are never there together, for one variable has a value of each."""
        a, b = (self._asked.get(self._presences.get(name, name), {}) for name in (one, other))
        return any(a[variable] != b[variable] for variable in a.keys() & b.keys())

    def named(self, names: tuple[str, ...]) -> list[tuple[str, ...]]:
        """Return the tuple of activities that ``names`` are meant to decide about, if any is."""
        own = [self._own.get(name) for name in names]
        return [] if None in own else [tuple(name for name in own if name)]

    def in_parallel(self, names: tuple[str, ...]) -> list[tuple[str, ...]]:
        """Return the tuples of activities of which one is there because one of ``names`` is: those
        of one kind, the first ones of all, the second ones, and so on; of those that are left,
        the only ones of one length.
        """
        lists = [self.of(name) for name in names]
        told = self._constants
        spoken = [frozenset().union(*(told.get(n, ()) for n in some)) for some in lists]
        # who does it is no part of what it is like
        shared = frozenset.intersection(*spoken)

        def kind(name: str) -> tuple[int | None, frozenset[str]]:
            return self.length(name), shared.intersection(told.get(name, ()))

        found: list[tuple[str, ...]] = []
        for like in dict.fromkeys(map(kind, lists[0])):
            alike = ([n for n in some if kind(n) == like] for some in lists)
            found += zip(*alike, strict=False)
        lengths = dict.fromkeys(map(self.length, lists[0]))
        done = {name for some in found for name in some}
        for length in lengths.keys() - {None}:
            left = [
                [n for n in some if n not in done and self.length(n) == length] for some in lists
            ]
            if all(len(some) == 1 for some in left):
                found.append(tuple(name for (name,) in left))
        return found

    def length(self, name: str) -> int | None:
        """Return the one duration of an activity (``None``: it has others, or has to be there)."""
        return self._lengths.get(name)

    def products(self, pair: tuple[str, ...]) -> set[frozenset[str]]:
        """Return the pairs of activities that exclude each other because ``pair`` does."""
        one, other = (self.of(name) for name in pair)
        return {frozenset((a, b)) for a, b in itertools.product(one, other) if a != b}


def _asked_values(parts: Additions) -> Iterator[tuple[str, FNode, object]]:
    """Yield (activity or bool variable, variable, value) where the one, if it is there, asks for
    that value of the other, which is the problem's own: what is chosen for an activity that is not
    there says nothing.
    """
    own = {v.environment.expression_manager.ParameterExp(v) for v in parts.variables}
    for node, scope, _ in parts.constraints:
        when = list(scope)
        if node.is_implies():
            node, when = node.arg(1), [*when, node.arg(0)]
        names = [decided(asked) for asked in when if not asked.is_true()]
        if node.is_equals() and len(names) == 1 and names[0] is not None:
            for variable, value in (node.args, node.args[::-1]):
                if variable in own and value.is_constant():
                    yield names[0], variable, value.constant_value()  # 1, be it whole or real


def _constants(parts: Additions, names: set[str]) -> dict[str, set[str]]:
    """Return activity -> all constants that its conditions, effects and own constraints speak of:
    what it is like, whoever does it.
    """
    found: dict[str, set[str]] = {name: set() for name in names}
    nodes = [(c, owner) for _, c, owner in parts.conditions]
    nodes += [(e.value, owner) for _, e, owner in parts.effects]
    nodes += [(c, owner) for c, _, owner in parts.constraints]
    for node, owner in nodes:
        if owner is not None and owner.name in names:
            found[owner.name].update(str(x) for x in walk(node) if x.is_constant())
    return found


def _own_decisions(clauses: list[Decisions], optional: set[str]) -> dict[str, str]:
    """Return activity or bool variable -> the one activity that it decides about, as written."""
    found = {name: {name} for name in optional}
    for names in told_together(clauses):
        for one, other in (names, names[::-1]):
            if other in optional and one not in optional:
                found.setdefault(one, set()).add(other)
    return {name: next(iter(some)) for name, some in found.items() if len(some) == 1}


def _length(activity: Activity) -> int | None:
    """Return the duration if it is fixed."""
    lower, upper = constant_bounds(activity.duration)
    return lower if lower == upper else None


# -- what is said of every member --------------------------------------------------------------
def merge_forms(forms: list[Form], groups: dict[Literal, tuple[Literal, ...]]) -> list[Form]:
    """Return ``forms`` with those that are said of every member of groups said once.

    Assumes: the same is said of every member of an exact group, whose members have the same times.

    :param groups: presence of each member of a group of which exactly one is present -> presences
        of the whole group. A comparison that must hold whichever members are there must hold.
    """
    places: dict[tuple[object, ...], set[frozenset[Literal]]] = {}
    read = [_read(form, groups) for form in forms]
    for key, members in read:
        if members:
            places.setdefault(key, set()).add(members)
    whole = {
        key: found
        for key, combinations in places.items()
        for found in [_products(combinations, groups)]
        if found
    }
    merged: list[Form] = []
    done = set()
    for form, (key, members) in zip(forms, read, strict=True):
        if not members or members not in whole.get(key, ()):
            merged.append(form)
        elif (key, whole[key][members]) not in done:
            done.add((key, whole[key][members]))
            merged.append(_rebuild(key))
    return merged


def _read(
    form: Form, groups: dict[Literal, tuple[Literal, ...]]
) -> tuple[tuple[object, ...], frozenset[Literal]]:
    """Split a form into what it says and for which members of groups it says it."""
    parts = parts_of("|", form)
    comparisons = [p for p in parts if p.__class__ is Cmp]
    if not comparisons or any(p.__class__ not in (int, Cmp) for p in parts):
        return (form,), frozenset()
    literals = {p for p in parts if p.__class__ is int}
    members = {p for p in (~x for x in literals) if p in groups}
    said = []
    for comparison in comparisons:
        # a comparison says nothing when what it needs is absent, wherever it stands
        members |= {p for p in comparison.needs if p in groups}
        rest = tuple(p for p in comparison.needs if p not in groups)
        said.append(comparison._replace(needs=rest))
    others = tuple(sorted(x for x in literals if ~x not in members))
    return (others, tuple(said)), frozenset(members)


def _products(
    combinations: set[frozenset[Literal]], groups: dict[Literal, tuple[Literal, ...]]
) -> dict[frozenset[Literal], frozenset[tuple[Literal, ...]]]:
    """Return the combinations that belong to a whole product of groups, with that product."""
    counts: dict[frozenset[tuple[Literal, ...]], list[frozenset[Literal]]] = {}
    for members in combinations:
        product = frozenset(groups[m] for m in members)
        if len(product) == len(members):
            counts.setdefault(product, []).append(members)
    return {
        members: product
        for product, found in counts.items()
        if len(found) == math.prod(len(g) for g in product)
        for members in found
    }


def _rebuild(key: tuple[object, ...]) -> Form:
    others, said = key
    return disjunction([*others, *said])  # type: ignore[misc]


# ------------------ Disjunctions between pairs of activities


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
        """Return how far apart two activities (indices) are when both are there; -1 if they may
        overlap.
        """
        pair = _ordered(a, b)
        return INFINITE if pair in self.exclusive else self.gaps.get(pair, -1)

    def take_alternatives(
        self, groups: list[Alternatives], activities: dict[str, ActivityVars], store: ModelStore
    ) -> dict[int, tuple[int, ...]]:
        """Tell who is never there together; return presence -> presences of its exact group."""
        exact: dict[int, tuple[int, ...]] = {}
        for group in groups:
            members = [activities[name] for name in group]
            indices = sorted(a.index for a in members)
            self.exclusive.update(itertools.combinations(indices, 2))
            store.at_most_one([a.present for a in members])
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
        first, second = map(end_before_start, constraint.args)
        if first is None or second is None or first != (second[1], second[0], second[2]):
            return False
        if first[2] not in (0, 1):
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

    def add_unary(self, unary: Unary) -> None:
        """Remember that no two members of a unary resource overlap."""
        self.unary.append((unary.gap, set(unary.members)))
        for a, b in itertools.combinations(unary.members, 2):
            if (a, b) not in self.exclusive:
                self._note(a, b, unary.gap)

    def _note(self, a: int, b: int, gap: int) -> None:
        key = _ordered(a, b)
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

    def emit_loads(self, store: ModelStore, makespan: Lin) -> None:
        """State that what one clique does fits into the makespan.

        It follows from the NoOverlap, but only so does the linear relaxation see it: without it
        the lower bound of a routing problem stays at nothing.
        """
        for gap, members in self.cliques:
            if len(members) > 2:
                load = indicator_sum([(a.present, a.least + gap) for a in members]).shift(-gap)
                store.enforce(load.le(makespan))

    def emit(self, store: ModelStore) -> None:
        """State every pair: cliques of three and more as NoOverlap, the others one by one."""
        by_gap: dict[int, list[tuple[int, int]]] = {}
        for pair, gap in self.gaps.items():
            by_gap.setdefault(gap, []).append(pair)
        for gap, pairs in sorted(by_gap.items()):
            wider = [pair for pair, other in self.gaps.items() if other > gap]
            for clique in clique_cover(graph_of([*pairs, *wider]), wider):
                members = [self._activities[i] for i in clique]
                self.cliques.append((gap, members))
                self.members.append(frozenset(clique))
                store.model.add_no_overlap([_interval(store, a, gap) for a in members])


def _ordered(a: int, b: int) -> tuple[int, int]:
    return (min(a, b), max(a, b))


def _interval(store: ModelStore, activity: ActivityVars, gap: int) -> object:
    """Return the interval [start, end + gap) of an activity."""
    return store.interval(
        activity.start, activity.size.shift(gap), activity.end.shift(gap), activity.present
    )


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
    told = difference_told(cmp)
    if told is None:
        return None
    a, b = _owner(told[0], ends, cmp), _owner(told[1], starts, cmp)
    if a is None or b is None or a is b:
        return None
    return a, b, told[2] - a.end.const + b.start.const


def _owner(var: int, owners: Owners, cmp: Cmp) -> ActivityVars | None:
    """Return whose time ``var`` is: of several alternatives, the one that ``cmp`` needs."""
    found = owners.get(var, [])
    if len(found) > 1:
        found = [a for a in found if a.present in cmp.needs]
    return found[0] if len(found) == 1 else None


# ------------------ "One at a time", found in what is said pair by pair


Graph = dict[int, set[int]]


def graph_of(edges: Iterable[tuple[int, int]]) -> Graph:
    """Return adjacency sets."""
    graph: Graph = {}
    for a, b in edges:
        graph.setdefault(a, set()).add(b)
        graph.setdefault(b, set()).add(a)
    return graph


def clique_cover(graph: Graph, spare: Iterable[tuple[int, int]] = ()) -> list[list[int]]:
    """Return cliques that together contain every edge (greedy, deterministic).

    Edges in ``spare`` need not be in any. Each clique is grown from an edge that is not covered
    yet, first by vertices that cover many uncovered edges; that finds the intended sets of unary
    resources at once.
    """
    uncovered = {v: set(others) for v, others in graph.items()}
    for a, b in spare:
        uncovered[a].discard(b)
        uncovered[b].discard(a)
    cliques = []
    for v in sorted(graph, key=lambda x: (-len(graph[x]), x)):
        while uncovered[v]:
            w = max(uncovered[v], key=lambda x: (len(graph[x] & graph[v]), -x))
            clique = _grow(graph, uncovered, v, w)
            for a in clique:
                uncovered[a].difference_update(clique)
            cliques.append(sorted(clique))
    return cliques


def _grow(graph: Graph, uncovered: Graph, v: int, w: int) -> set[int]:
    clique = {v, w}
    candidates = graph[v] & graph[w]
    gains = {x: len(uncovered[x] & clique) for x in candidates}
    while candidates:
        check_time()
        best = max(candidates, key=lambda x: (gains[x], len(graph[x]), -x))
        clique.add(best)
        candidates = candidates & graph[best]
        for x in candidates & uncovered[best]:
            gains[x] += 1
    return clique
