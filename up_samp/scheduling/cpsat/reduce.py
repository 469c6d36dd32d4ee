"""A problem without some of its activities, and without whatever speaks of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.scheduling.cpsat.problem import Additions


def without(parts: Additions, removed: set[str]) -> Additions:
    """Return ``parts`` without the activities in ``removed`` and whatever speaks of them."""
    broken, broken_names = _broken(parts, removed)
    memo: dict[FNode, bool] = {}

    def clean(node: FNode) -> bool:
        known = memo.get(node)
        if known is None:
            known = _clean(node, removed, broken, broken_names, clean)
            memo[node] = known
        return known

    kept = Additions()
    kept.activities = [a for a in parts.activities if a.name not in removed]
    kept.variables = parts.variables
    kept.parameters = [p for p in parts.parameters if p[0].name not in removed]
    kept.constraints = [
        c for c in parts.constraints if _keeps(c[2], removed) and all(map(clean, (c[0], *c[1])))
    ]
    kept.conditions = [
        c
        for c in parts.conditions
        if _keeps(c[2], removed)
        and clean(c[1])
        and _timings_clean((c[0].lower, c[0].upper), removed)
    ]
    kept.effects = [
        e
        for e in parts.effects
        if _keeps(e[2], removed)
        and clean(e[1].fluent)
        and clean(e[1].value)
        and clean(e[1].condition)
        and _timings_clean((e[0],), removed)
    ]
    return kept


def _keeps(owner: Any, removed: set[str]) -> bool:
    return owner is None or owner.name not in removed


def _timings_clean(timings: tuple[Any, ...], removed: set[str]) -> bool:
    return all(t.timepoint.container not in removed for t in timings)


def _broken(parts: Additions, removed: set[str]) -> tuple[set[FNode], set[str]]:
    """Return the ground fluents, and the names of fluents, that removed activities change."""
    nodes, names = set(), set()
    for _, effect, owner in parts.effects:
        if owner is not None and owner.name in removed:
            if all(a.is_constant() for a in effect.fluent.args):
                nodes.add(effect.fluent)
            else:
                names.add(effect.fluent.fluent().name)
    return nodes, names


def _clean(
    node: FNode,
    removed: set[str],
    broken: set[FNode],
    names: set[str],
    recur: Callable[[FNode], bool],
) -> bool:
    kind = node.node_type
    if kind is Op.TIMING_EXP:
        return node.timing().timepoint.container not in removed
    if kind is Op.PRESENT_EXP:
        return node.presence().container not in removed
    if kind is Op.PARAM_EXP:
        return node.parameter().name.rsplit(".", 1)[0] not in removed
    if kind is Op.FLUENT_EXP:
        fluent = node.fluent().name
        if node in broken or fluent in names:
            return False
        touched = any(b.fluent().name == fluent for b in broken)
        if touched and not all(a.is_constant() for a in node.args):
            return False
    return all(recur(a) for a in node.args)
