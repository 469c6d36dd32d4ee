"""A problem without some of its activities, and without whatever speaks of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimepointKind

from up_samp.scheduling.cpsat.problem import Additions

TimedEffect = tuple[Timing, Effect, Activity | None]


def without(parts: Additions, removed: set[str]) -> Additions:
    """Return ``parts`` without the activities in ``removed`` and whatever speaks of them.

    Every schedule of the whole, but for these activities, is one of what is left.
    """
    clean, effects = _lasting(parts, removed)
    kept = Additions(whole=False)
    kept.activities = [a for a in parts.activities if a.name not in removed]
    kept.vague = frozenset(
        a.name for a in kept.activities if not (clean(a.duration.lower) and clean(a.duration.upper))
    )
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
        and not _before_end(c[0])
    ]
    kept.effects = effects
    return kept


def _lasting(
    parts: Additions, removed: set[str]
) -> tuple[Callable[[FNode], bool], list[TimedEffect]]:
    """Return what tells whether an expression means the same without ``removed``, and the effects
    that are left.

    Where one effect on a fluent goes, all do, with all that reads it, and so on.
    """
    nodes, names = set[FNode](), set[str]()
    while True:
        clean = _cleaner(removed, set(nodes), set(names))
        kept = [
            (timing, effect, owner)
            for timing, effect, owner in parts.effects
            if _keeps(owner, removed)
            and clean(effect.fluent)
            and clean(effect.value)
            and clean(effect.condition)
            and _timings_clean((timing,), removed)
        ]
        known = len(nodes) + len(names)
        left = {id(effect) for _, effect, _ in kept}
        for _, effect, _ in parts.effects:
            if id(effect) in left:
                continue
            if all(a.is_constant() for a in effect.fluent.args):
                nodes.add(effect.fluent)
            else:
                names.add(effect.fluent.fluent().name)
        if len(nodes) + len(names) == known:
            return clean, kept


def _before_end(span: TimeInterval) -> bool:
    """Return whether a span begins before the global end by a time counted from it: nobody knows
    when that is without what was taken out.
    """
    lower, upper = (t.timepoint.kind is TimepointKind.GLOBAL_END for t in (span.lower, span.upper))
    return lower and not (upper and span.lower.delay >= 0)


def _cleaner(removed: set[str], nodes: set[FNode], names: set[str]) -> Callable[[FNode], bool]:
    memo: dict[FNode, bool] = {}

    def clean(node: FNode) -> bool:
        known = memo.get(node)
        if known is None:
            known = memo[node] = _clean(node, removed, nodes, names, clean)
        return known

    return clean


def _keeps(owner: Any, removed: set[str]) -> bool:
    return owner is None or owner.name not in removed


def _timings_clean(timings: tuple[Any, ...], removed: set[str]) -> bool:
    return all(t.timepoint.container not in removed for t in timings)


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
