"""What a scheduling problem holds, read once and then by what was appended; and its normal form:
the list of steps from what is written to what is recognised.

Each step says the same in one way, so a model may be built from any of them; what recognition finds
in the form only adds what follows anyway, or replaces what is equivalent.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.model import check_time
from up_samp.upio.expressions import (
    QuantifierRemover,
    conjuncts,
    end_before_start,
    present_told,
    with_timings,
)


@dataclass
class Additions:
    """What is new since the last look. ``activity`` is ``None`` for the problem's own parts."""

    activities: list[Activity] = field(default_factory=list)
    variables: list[Any] = field(default_factory=list)
    parameters: list[tuple[Activity, Any]] = field(default_factory=list)
    constraints: list[tuple[FNode, list[FNode], Activity | None]] = field(default_factory=list)
    conditions: list[tuple[TimeInterval, FNode, Activity | None]] = field(default_factory=list)
    effects: list[tuple[Timing, Effect, Activity | None]] = field(default_factory=list)
    durations: list[Activity] = field(default_factory=list)
    new_objects: bool = False
    rewritten: bool = False
    """Something was taken back or exchanged, not only appended."""


class Watcher:
    """Remembers what of a problem has been seen, and tells what was appended."""

    def __init__(self, problem: SchedulingProblem) -> None:
        self.problem = problem
        self._seen: dict[tuple[Any, ...], list[Any]] = {}
        """By whose it is (``None``: the problem's own), what it is, and when: what was seen."""
        self._durations: dict[str, Any] = {}
        self._activities: list[Activity] = []
        self._state: tuple[Any, ...] = ()
        self._written_out = QuantifierRemover(problem)

    def look(self) -> Additions:
        """Return what was appended since the last call (the first time: everything)."""
        new = Additions()
        known = len(self._activities)
        now = list(self.problem.activities)
        if [id(a) for a in now[:known]] != [id(a) for a in self._activities]:
            new.rewritten = True
        new.activities = now[known:]
        self._activities = now
        self._chronicle(None, self.problem._base, new)
        for activity in now:
            self._chronicle(activity, activity, new)
            self._duration(activity, new)
        state = (
            len(list(self.problem.all_objects)),
            len(self.problem.fluents),
            tuple(
                sorted((str(k), str(v)) for k, v in self.problem.explicit_initial_values.items())
            ),
            tuple(id(m) for m in self.problem.quality_metrics),
        )
        if self._state and state != self._state:
            new.new_objects = state[0] != self._state[0]
            new.rewritten |= state[2:] != self._state[2:]
        self._state = state
        return new

    def _chronicle(self, activity: Activity | None, chronicle: Any, new: Additions) -> None:
        name, put = None if activity is None else activity.name, self._written_out
        for parameter in self._appended((name, "parameters"), chronicle.parameters, new):
            if activity is None:
                new.variables.append(parameter)
            else:
                new.parameters.append((activity, parameter))
        constraints = self._appended((name, "constraints"), chronicle.scoped_constraints, new)
        new.constraints += [(put(c), [put(s) for s in scope], activity) for c, scope in constraints]
        for span, items in self._timed((name, "conditions"), chronicle.conditions, new):
            new.conditions += [(with_timings(span), put(c), activity) for c in items]
        for time, items in self._timed((name, "effects"), chronicle.effects, new):
            new.effects += [(time, each, activity) for e in items for each in put.effects(e)]

    def _timed(
        self, key: tuple[Any, ...], now: dict[Any, list[Any]], new: Additions
    ) -> Iterator[tuple[Any, list[Any]]]:
        """Yield what was appended at each time."""
        new.rewritten |= any(time not in now for time in self._seen.get(key, ()))
        self._seen[key] = list(now)
        for time, items in now.items():
            yield time, self._appended((*key, time), items, new)

    def _appended(self, key: tuple[Any, ...], now: list[Any], new: Additions) -> list[Any]:
        """Return what was appended to a list since it was looked at."""
        old = self._seen.get(key, [])
        new.rewritten |= now[: len(old)] != old
        self._seen[key] = list(now)
        return list(now[len(old) :])

    def _duration(self, activity: Activity, new: Additions) -> None:
        duration = activity.duration
        old = self._durations.get(activity.name)
        if old is not duration:
            if old is not None and old != duration:
                new.durations.append(activity)
            self._durations[activity.name] = duration


Constraint = tuple[FNode, list[FNode], "Activity | None"]


# ------------------ Preconditions that are said with precedences alone
# By helpers, and rivals that may undo them:
# ``Or`` over each helper H: ``And(H.present, H.end <= A.start, and for each rival R:
# Implies(R.present, Or(R.end <= H.start, R.start >= A.end)))``; and, where it holds at first, one
# more alternative: ``And for each R: Implies(R.present, R.start >= A.end)`` (Tosello et al., ICAPS
# 2026). Here they are only read; whether they amount to a state variable depends on who never
# overlaps, see :mod:`up_samp.scheduling.cpsat.encode.recognition`.


Before = tuple[str, str, int]
"""(a, b, gap): ``a.end + gap <= b.start``; gap 1 is written ``a.end < b.start``."""


@dataclass(frozen=True)
class Precondition:
    """``activity`` needs the last of its ``rivals`` and helpers before it to be a helper.

    ``helpers[h]`` are the rivals that must not come between h and the activity; ``initially`` are
    those that must not come before it if no helper does (``None``: a helper has to). ``gap`` is
    the greatest one written anywhere.
    """

    activity: str
    helpers: dict[str, frozenset[str]]
    initially: frozenset[str] | None
    gap: int
    constraint: Constraint


def read_precedences(
    constraints: Iterable[Constraint],
) -> tuple[list[Precondition], list[Constraint]]:
    """Return preconditions, and all constraints but these."""
    preconditions, others = [], []
    before = cache(_before)  # most parts of preconditions come many times
    for constraint in constraints:
        check_time()
        found = _precedence(constraint, before)
        if found is None:
            others.append(constraint)
        else:
            preconditions.append(found)
    return preconditions, others


BeforeOf = Callable[[FNode], "Before | None"]


def _before(node: FNode) -> Before | None:
    found = end_before_start(node)
    return found if found is not None and found[2] in (0, 1) else None


def _precedence(constraint: Constraint, before: BeforeOf) -> Precondition | None:
    node, scope, _ = constraint
    if node.node_type is Op.IMPLIES and not scope:
        node, scope = node.arg(1), [node.arg(0)]
    activity = present_told(scope[0]) if len(scope) == 1 else None
    options = list(node.args) if node.node_type is Op.OR else [node]
    if activity is None or any(o.node_type not in (Op.AND, Op.OR, Op.IMPLIES) for o in options):
        return None
    helpers: dict[str, frozenset[str]] = {}
    initially, gap = None, 0
    for parts in map(conjuncts, options):
        names = [name for name in map(present_told, parts) if name is not None]
        helper = names[0] if len(names) == 1 else None
        rest = [p for p in parts if p.node_type in (Op.OR, Op.IMPLIES)]
        rivals = _rivals(rest, activity, helper, before)
        if helper is None:
            if rivals is None or len(rest) < len(parts) or initially is not None:
                return None
            initially, gap = rivals[0], max(gap, rivals[1])
            continue
        order = [b for b in map(before, parts) if b is not None]
        if len(order) != 1 or len(rest) + 2 != len(parts):
            return None
        if order[0][:2] != (helper, activity) or rivals is None or helper in helpers:
            return None
        helpers[helper] = rivals[0]
        gap = max(gap, order[0][2], rivals[1])
    if not helpers and not initially:
        return None
    return Precondition(activity, helpers, initially, gap, constraint)


def _rivals(
    parts: list[FNode], activity: str, helper: str | None, before: BeforeOf
) -> tuple[frozenset[str], int] | None:
    """Return the rivals that keep away from helper and activity, and the greatest gap."""
    names, gap = set(), 0
    for part in parts:
        absent, order = _order(part, before) or (None, [])
        after = [b[1] for b in order if b[0] == activity]
        if len(after) != 1 or (absent is not None and absent != after[0]):
            return None
        rival = after[0]
        if len(order) != (1 if helper is None else 2):
            return None
        if any(first != activity and (first, then) != (rival, helper) for first, then, _ in order):
            return None
        gap = max(gap, *(more for _, _, more in order))
        names.add(rival)
    return frozenset(names), gap


def _order(part: FNode, before: BeforeOf) -> tuple[str | None, list[Before]] | None:
    """Read "if it is there, one of these comes before the other"; there may be millions."""
    absent, order, agenda = set[str](), list[Before](), [part]
    while agenda:
        node = agenda.pop()
        if node.node_type is Op.OR:
            agenda += node.args
        elif node.node_type in (Op.IMPLIES, Op.NOT):
            name = present_told(node.arg(0))
            if name is None:
                return None
            absent.add(name)
            agenda += node.args[1:]
        elif (found := before(node)) is not None:
            order.append(found)
        else:
            return None
    return (next(iter(absent), None), order) if len(absent) <= 1 else None


# ------------------ Who is there together


Presences = Mapping[str, str]
"""Names of activities and bool variables (:func:`called`) -> the first name of those decided
together (one that is decided alone is not in it)."""


def called(variable: Any) -> str:
    """Return the name of a bool variable among decisions: an activity may have its own."""
    return f"\0{variable.name}"


def decided(node: FNode) -> str | None:
    """Return the name if ``node`` is the presence of an activity or a bool variable."""
    if node.node_type is Op.PRESENT_EXP:
        return str(node.presence().container)
    if node.node_type is Op.PARAM_EXP and node.type.is_bool_type():
        return called(node.parameter())
    return None


Decisions = tuple[tuple[str, bool], ...]
"""A clause over presences and bool variables: one of them is true, or false."""


def decisions(constraint: FNode, scope: Iterable[FNode]) -> list[Decisions]:
    """Return clauses over presences and bool variables that follow from a constraint, where all of
    its scope holds.
    """
    return _either([(constraint, True), *((s, False) for s in scope)])


def _clauses(node: FNode, positive: bool = True) -> list[Decisions]:
    """Return clauses over presences and bool variables that follow from a formula (its negation, if
    not ``positive``): parts that speak of anything else say none.
    """
    kind, name = node.node_type, decided(node)
    if name is not None:
        return [((name, positive),)]
    if kind is Op.NOT:
        return _clauses(node.arg(0), not positive)
    if kind in (Op.IFF, Op.EQUALS):
        one, other = node.args
        halves = (((one, sign), (other, sign is not positive)) for sign in (True, False))
        return [clause for half in halves for clause in _either(half)]
    parts = [(arg, positive) for arg in node.args]
    if kind is Op.IMPLIES:
        parts[0] = (node.arg(0), not positive)
    elif kind not in (Op.AND, Op.OR):
        return [()] if kind is Op.BOOL_CONSTANT and node.is_true() != positive else []
    if (kind is Op.AND) == positive:
        return [clause for part in parts for clause in _clauses(*part)]
    return _either(parts)


def _either(parts: Iterable[tuple[FNode, bool]]) -> list[Decisions]:
    """Return the same of a disjunction; nothing if two of its parts are conjunctions."""
    found: list[Decisions] = [()]
    for part in parts:
        more = _clauses(*part)
        if len(found) > 1 and len(more) > 1:
            return []
        pairs = itertools.product(found, more)
        found = [(*one, *(d for d in other if d not in one)) for one, other in pairs]
        if not found:
            return []
    return [clause for clause in found if len({name for name, _ in clause}) == len(clause)]


def told_together(clauses: Iterable[Decisions]) -> list[tuple[str, str]]:
    """Return the two of each pair of clauses ``not a or b`` and ``not b or a``, of which they are
    the two halves of ``a iff b``.
    """
    pairs = ({sign: name for name, sign in clause} for clause in clauses if len(clause) == 2)
    halves = {(pair[False], pair[True]): None for pair in pairs if len(pair) == 2}
    return [pair for pair in halves if pair[::-1] in halves]


def find_presences(
    clauses: Iterable[Decisions], optional: list[str], variables: list[str]
) -> Presences:
    """Return what ``a iff b`` between presences and bool variables decides together, however it is
    written.

    Assumes: it is said without a condition, of presences and bool variables of the problem itself.

    :param clauses: what constraints say.
    :param optional: names of the optional activities, in order.
    :param variables: names of the problem's own bool variables.
    """
    rank = {name: i for i, name in enumerate([*optional, *variables])}
    together: dict[str, set[str]] = {}
    for one, other in told_together(clauses):
        if one in rank and other in rank:
            names = together.get(one, {one}) | together.get(other, {other})
            together.update(dict.fromkeys(names, names))
    return {name: min(names, key=rank.__getitem__) for name, names in together.items()}


# ------------------ The normal form of a problem


@dataclass(frozen=True)
class NormalForm:
    """A problem's parts in one style, the ``clauses`` over presences and bool variables among them,
    who is there together, and what is said with precedences.

    ``preconditions`` are not among the constraints of ``parts`` any more.
    """

    parts: Additions
    clauses: list[Decisions] = field(default_factory=list)
    presences: Presences = field(default_factory=dict)
    preconditions: list[Precondition] = field(default_factory=list)


def normal_form(parts: Additions) -> NormalForm:
    """Return the normal form of all parts of a problem (not of what is appended later)."""
    preconditions, others = read_precedences(parts.constraints)
    parts = replace(parts, constraints=others)
    clauses = [c for constraint, scope, _ in others for c in decisions(constraint, scope)]
    presences = find_presences(
        clauses,
        [a.name for a in parts.activities if a.optional],
        [called(v) for v in parts.variables if v.type.is_bool_type()],
    )
    return NormalForm(parts, clauses, presences, preconditions)
