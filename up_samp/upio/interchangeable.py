"""Activities that are the same but for their names: which of them is used is no decision.

Authors who name goals by parameters write as many copies of an activity as may be needed. To
exchange two copies in a plan makes another plan that is as good; so some best plan uses the first
ones first, in their order. Two activities are interchangeable if the problem is the same after all
that is said of the one is said of the other, and the other way round.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.model import check_time
from up_samp.upio.expressions import activity_named
from up_samp.upio.objective import only_makespan
from up_samp.upio.relaxation import Relaxation

_UNORDERED = frozenset((Op.AND, Op.OR, Op.EQUALS, Op.IFF, Op.PLUS, Op.TIMES))
_SELF = "#"
Names = Mapping[str, str]
"""Activity -> what it is called instead."""


def interchangeable(relaxation: Relaxation) -> list[tuple[str, ...]]:
    """Return the sets of optional activities of which any two are interchangeable, in order.

    Looks at the relaxation as it is: ask before anything is learned of single activities.
    """
    problem = relaxation.problem
    if not only_makespan(problem):
        return []
    keys = _Keys(relaxation.problem)
    alike: dict[Any, list[Activity]] = {}
    for activity in problem.activities:
        check_time()
        if activity.optional:
            alike.setdefault(_rough(activity), []).append(activity)
    groups = [some for rough in alike.values() for some in _same(relaxation, rough, keys)]
    names = {a.name for some in groups for a in some}
    if not names:
        return []
    said = _Said(relaxation, names, keys)
    found = []
    for some in groups:
        chain = [some[0].name]
        for one, other in itertools.pairwise(some):
            if not said.exchangeable(one.name, other.name):
                found.append(tuple(chain))
                chain = []
            chain.append(other.name)
        found.append(tuple(chain))
    return [chain for chain in found if len(chain) > 1]


def _rough(activity: Activity) -> Any:
    """Return a key that activities which are the same have in common, at little cost."""
    bounds = activity.duration
    return (
        bounds.lower.node_id,
        bounds.upper.node_id,
        tuple(p.type for p in activity.parameters),
        sum(map(len, activity.conditions.values())),
        sum(map(len, activity.effects.values())),
        len(activity._constraints),
    )


def _same(relaxation: Relaxation, some: list[Activity], keys: _Keys) -> Iterator[list[Activity]]:
    """Yield those that are the same in themselves, but for what constraints say of them."""
    groups: dict[Any, list[Activity]] = {}
    for activity in some if len(some) > 1 else ():
        check_time()
        groups.setdefault(_own(relaxation, activity, keys), []).append(activity)
    yield from (group for group in groups.values() if len(group) > 1)


def _own(relaxation: Relaxation, activity: Activity, keys: _Keys) -> Any:
    me = keys.renamed({activity.name: _SELF})
    bounds, snapshot = activity.duration, relaxation.snapshot
    conditions = Counter(
        (*me.span(span), me(node)) for span, nodes in activity.conditions.items() for node in nodes
    )
    effects = Counter(
        (me.timing(timing), e.kind, *map(me, _nodes(e)))
        for timing, some in activity.effects.items()
        for e in some
    )
    motions = [
        (t.index, t.object, t.static, t.dynamic, t.map, _terms(t.terms, activity, keys))
        for t in snapshot.tasks_of(activity.name)
        if not t.rides
    ]
    changes = [
        (c.object, _terms((c.term,), activity, keys))
        for c in snapshot.changes
        if c.activity == activity.name
    ]
    every = (e for some in activity.effects.values() for e in some)
    whole = len(motions) == len(snapshot.tasks_of(activity.name)) and not any(
        e.forall for e in every
    )
    return (
        (bounds.is_left_open(), bounds.is_right_open()),
        tuple(map(me, (bounds.lower, bounds.upper))),
        tuple(sorted(keys.slots[p.name] for p in activity.parameters)),
        frozenset(conditions.items()),
        frozenset(effects.items()),
        tuple(motions),
        tuple(changes),
        None if whole else activity.name,  # what is not looked at is like nothing else
    )


def _terms(terms: Iterable[Any], activity: Activity, keys: _Keys) -> tuple[Any, ...]:
    own = {p.name for p in activity.parameters}
    return tuple((t.kind, keys.slots[t.name] if t.name in own else t.name) for t in terms)


class _Said:
    """What constraints say of some activities, and whether anything else speaks of them."""

    def __init__(self, relaxation: Relaxation, names: set[str], keys: _Keys) -> None:
        self._keys = keys
        self._by_name: dict[str, list[tuple[str, FNode, list[FNode]]]] = {n: [] for n in names}
        self._elsewhere: set[str] = set()
        problem = relaxation.problem
        for owner in (problem._base, *problem.activities):
            check_time()
            me = owner.name if isinstance(owner, Activity) else ""
            for node, scope in owner._constraints:
                spoken = keys.names(node).union(*map(keys.names, scope), (me,))
                for name in spoken & names:
                    self._by_name[name].append((me, node, scope))
            for node in _others(owner):
                self._elsewhere |= (keys.names(node) - {me}) & names
            told = {timing.timepoint.container for timing in _timings(owner)}
            self._elsewhere |= (told - {me}) & names

    def exchangeable(self, one: str, other: str) -> bool:
        """Return whether constraints say the same after two activities have been exchanged."""
        check_time()
        if self._elsewhere & {one, other}:
            return False
        both = {
            (me, node.node_id, tuple(s.node_id for s in scope)): (me, node, scope)
            for name in (one, other)
            for me, node, scope in self._by_name[name]
        }.values()
        plain, names = self._keys.plain, {one: other, other: one}
        exchanged = self._keys.renamed(names)
        return Counter((me, plain(n), frozenset(map(plain, s))) for me, n, s in both) == Counter(
            (names.get(me, me), exchanged(n), frozenset(map(exchanged, s))) for me, n, s in both
        )


def _others(owner: Any) -> Iterator[FNode]:
    """Yield all expressions of an activity, or of the problem, that are no constraints."""
    for nodes in owner.conditions.values():
        yield from nodes
    for effects in owner.effects.values():
        for effect in effects:
            yield from _nodes(effect)
    if isinstance(owner, Activity):
        yield from (owner.duration.lower, owner.duration.upper)


def _timings(owner: Any) -> Iterator[Timing]:
    """Yield all times at which an activity, or the problem, needs or changes something."""
    for span in owner.conditions:
        yield from (span.lower, span.upper)
    yield from owner.effects


def _nodes(effect: Effect) -> tuple[FNode, FNode, FNode]:
    return effect.fluent, effect.value, effect.condition


class _Keys:
    """Expressions as numbers: the same for those that are built alike, whatever the order of what
    has none.
    """

    def __init__(self, problem: SchedulingProblem) -> None:
        self.slots: dict[str, tuple[str, int]] = {}
        """Which parameter of its activity each one is: its type, and the how manyth of that."""
        for activity in problem.activities:
            count = Counter[str]()
            for parameter in activity.parameters:
                kind = str(parameter.type)
                self.slots[parameter.name] = kind, count[kind]
                count[kind] += 1
        self._names: dict[int, frozenset[str]] = {}
        self._numbers: dict[Any, int] = {}
        self._plain = _Renamed(self, {})

    def names(self, node: FNode) -> frozenset[str]:
        """Return the activities that an expression speaks of."""
        found = self._names.get(node.node_id)
        if found is None:
            found = frozenset[str]().union(*map(self.names, node.args))
            named = activity_named(node)
            found |= set() if named is None else {named}
            self._names[node.node_id] = found
        return found

    def plain(self, node: FNode) -> int:
        """Return the number of an expression as it is."""
        return self._plain(node)

    def renamed(self, names: Names) -> _Renamed:
        """Return what gives the numbers of expressions with activities called otherwise."""
        return _Renamed(self, names)

    def number(self, built: Any) -> int:
        """Return the number of what is built of numbers."""
        return self._numbers.setdefault(built, len(self._numbers))


class _Renamed:
    """The numbers of expressions with some activities renamed; what does not speak of these keeps
    its own.
    """

    def __init__(self, keys: _Keys, names: Names) -> None:
        self._keys, self._names = keys, names
        self._known: dict[int, int] = {}

    def __call__(self, node: FNode) -> int:
        found = self._known.get(node.node_id)
        if found is None:
            if self._names and self._keys.names(node).isdisjoint(self._names):
                found = self._keys.plain(node)
            else:
                found = self._keys.number(self._built(node))
            self._known[node.node_id] = found
        return found

    def _built(self, node: FNode) -> Any:
        kind, names = node.node_type, self._names
        if kind is Op.TIMING_EXP:
            return (kind, *self.timing(node.timing()))
        if kind is Op.PRESENT_EXP:
            name = str(node.presence().container)
            return kind, names.get(name, name)
        if kind is Op.PARAM_EXP:
            full = node.parameter().name
            owner = full.rpartition(".")[0]
            return kind, names.get(owner, owner), self._keys.slots.get(full, full)
        if not node.args and kind is not Op.FLUENT_EXP:
            return node.node_id
        parts = map(self, node.args)
        inside = tuple(sorted(parts)) if kind in _UNORDERED else tuple(parts)
        if kind is Op.FLUENT_EXP:
            return kind, node.fluent().name, inside
        if kind in (Op.EXISTS, Op.FORALL):
            return kind, tuple(node.variables()), inside
        return kind, "", inside

    def timing(self, timing: Timing) -> tuple[Any, ...]:
        """Return a timing as a value."""
        point = timing.timepoint
        return point.kind, self._names.get(point.container or "", point.container), timing.delay

    def span(self, span: TimeInterval) -> tuple[Any, ...]:
        """Return an interval as a value."""
        ends = self.timing(span.lower), self.timing(span.upper)
        return (*ends, span.is_left_open(), span.is_right_open())
