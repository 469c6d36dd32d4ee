"""Activities of which only one can be there: they may share their times.

``exactly_one`` of several optional activities of one duration is one thing to be done in one of
several ways (by one of several robots); a switch that is never set back is set at most once. The
times of an absent activity mean nothing, so all members of such a group get the same start
variable, and what is said of every member is said once. Nothing is lost by either.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimepointKind

from up_samp.scheduling.cpsat.encode.store import Cmp, Form, Literal, disjunction
from up_samp.scheduling.cpsat.problem import Additions


@dataclass(frozen=True)
class Group:
    """Activities of one fixed duration, at most one of them present; ``exact``: one is.

    An optional activity that must be there is an exact group of one.
    """

    names: tuple[str, ...]
    exact: bool


def find_groups(parts: Additions) -> list[Group]:
    """Return disjoint groups of alternatives among what is written."""
    lengths = {a.name: _length(a) for a in parts.activities if a.optional}
    exclusive: set[frozenset[str]] = set()
    wanted: dict[tuple[str, ...], None] = {}
    for constraint, scope, _ in parts.constraints:
        if any(not s.is_true() for s in scope):
            continue
        if constraint.node_type is Op.PRESENT_EXP:
            wanted[(str(constraint.presence().container),)] = None
        if constraint.node_type is not Op.OR:
            continue
        names = _all_present(constraint.args)
        if names is not None:
            wanted[names] = None
        elif len(constraint.args) == 2 and all(a.node_type is Op.NOT for a in constraint.args):
            pair = _all_present([a.arg(0) for a in constraint.args])
            if pair is not None:
                exclusive.add(frozenset(pair))
    candidates = [(names, True) for names in wanted]
    candidates += [(names, False) for names in _switched_once(parts)]
    groups, taken = [], set[str]()
    for names, exact in candidates:
        apart = not exact or all(
            frozenset(pair) in exclusive for pair in itertools.combinations(names, 2)
        )
        same = {lengths.get(n) for n in names}
        alike = len(same) == 1 and None not in same
        if (exact or len(names) > 1) and apart and alike and not taken.intersection(names):
            taken.update(names)
            groups.append(Group(names, exact))
    return groups


def _all_present(nodes: Iterable[FNode]) -> tuple[str, ...] | None:
    """Return whose presences ``nodes`` are; ``None`` if they are anything else."""
    names = []
    for node in nodes:
        if node.node_type is not Op.PRESENT_EXP:
            return None
        names.append(str(node.presence().container))
    return tuple(names) if len(set(names)) == len(names) else None


def _length(activity: Activity) -> int | None:
    """Return the duration if it is a fixed integer."""
    duration = activity.duration
    lower, upper = duration.lower, duration.upper
    if duration.is_left_open() or duration.is_right_open():
        return None
    if not (lower.is_int_constant() and upper.is_int_constant()):
        return None
    value = int(lower.constant_value())
    return value if value == int(upper.constant_value()) else None


# -- switches ----------------------------------------------------------------------------------
def _switched_once(parts: Additions) -> list[tuple[str, ...]]:
    """Return, for every fluent that is changed once at most, the activities that can do it.

    Each of them needs the fluent to have a value right before its effect that no effect ever gives
    it back; after the first effect no other one can come.
    """
    by_fluent: dict[FNode, list[tuple[Timing, Effect, Activity | None]]] = {}
    vague = set()
    for timing, effect, owner in parts.effects:
        if not all(a.is_constant() for a in effect.fluent.args):
            vague.add(effect.fluent.fluent().name)
        by_fluent.setdefault(effect.fluent, []).append((timing, effect, owner))
    needs = _needs(parts)
    found = []
    for fluent, effects in by_fluent.items():
        owners = [owner for _, _, owner in effects if owner is not None and owner.optional]
        if fluent.fluent().name in vague or len(owners) < len(effects):
            continue
        if len({o.name for o in owners}) < len(owners):
            continue
        before = {needs.get((o.name, fluent)) for o in owners}
        given = {e.value if _plain(t, e, o) else None for t, e, o in effects}
        if len(before) == 1 and None not in before | given and not before & given:
            found.append(tuple(o.name for o in owners))
    return found


def _plain(timing: Timing, effect: Effect, owner: Activity | None) -> bool:
    """Return whether an effect assigns a constant at its activity's end, whatever else holds."""
    return (
        owner is not None
        and timing == Timing(0, owner.end)
        and effect.is_assignment()
        and not effect.forall
        and effect.condition.is_true()
        and effect.value.is_constant()
    )


def _needs(parts: Additions) -> dict[tuple[str, FNode], FNode]:
    """Return (activity, fluent) -> value that it needs within a unit of time of its end."""
    found = {}
    for span, condition, owner in parts.conditions:
        length = None if owner is None else _length(owner)
        if owner is None or length is None or condition.node_type is not Op.EQUALS:
            continue
        fluent, value = condition.args
        if not fluent.is_fluent_exp():
            fluent, value = value, fluent
        if fluent.is_fluent_exp() and value.is_constant() and _until_end(span, owner, length):
            found[owner.name, fluent] = value
    return found


def _until_end(span: TimeInterval, owner: Activity, length: int) -> bool:
    """Return whether a span's last instant is the activity's end or the one before."""
    upper = span.upper
    if span.is_left_open() or span.is_right_open() or upper.timepoint.container != owner.name:
        return False
    offset = math.inf
    if upper.timepoint.kind is TimepointKind.START:
        offset = upper.delay
    elif upper.timepoint.kind is TimepointKind.END:
        offset = length + upper.delay
    if not 0 <= length - offset <= 1:
        return False
    # from the start on there may be no instant at all, and then nothing is needed
    return span.lower == upper or (span.lower == Timing(0, owner.start) and offset >= 0)


# -- what is said of every member --------------------------------------------------------------
def merge_forms(forms: list[Form], groups: dict[Literal, tuple[Literal, ...]]) -> list[Form]:
    """Return ``forms`` with those that are said of every member of groups said once.

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
    parts = form[1:] if form.__class__ is tuple and form[0] == "|" else (form,)
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
