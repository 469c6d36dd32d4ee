"""Constraints as scoped clauses: each with the presences it needs in its scope.

``And`` is split, negations are pushed inwards, ``Implies(present, c)`` and ``Or(Not(present), c)``
become scopes, and who cannot be there together is said pair by pair. Each rewritten constraint is
equivalent to what was written, so models may be built from either.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity

from up_samp.model import check_time
from up_samp.upio.expressions import conjuncts

Constraint = tuple[FNode, list[FNode], "Activity | None"]
Known = dict[tuple[int, bool], FNode]
"""(number of a node, whether it is meant as it is, not negated) -> what that is, rewritten."""


def split(constraints: Iterable[Constraint]) -> list[Constraint]:
    """Return ``constraints`` as clauses (idempotent; their order is kept)."""
    clauses: list[Constraint] = []
    known: Known = {}
    for constraint in constraints:
        check_time()
        clauses += _clauses(*constraint, known)
    return clauses


def _clauses(
    node: FNode, scope: list[FNode], owner: Activity | None, known: Known
) -> Iterator[Constraint]:
    if not scope and node.node_type is Op.OR and _is_pair(node):
        yield node, scope, owner  # by far the most frequent ones, as they are
        return
    if node.node_type is Op.OR and _is_order(node) and all(map(_is_presence, scope)):
        yield node, list(dict.fromkeys(scope)), owner  # the same with a scope
        return
    heads = list(dict.fromkeys(h for part in scope for h in conjuncts(part) if not h.is_true()))
    for rest, more in _scoped(_inwards(node, known)):
        every = list(dict.fromkeys([*heads, *more]))
        if rest is None and len(every) <= 2 and all(_is_presence(p) for p in every):
            manager = node.environment.expression_manager
            yield manager.Or([manager.Not(p) for p in every]), [], owner
        elif rest is None:
            yield node.environment.expression_manager.FALSE(), every, owner
        else:
            yield rest, every, owner


def _is_pair(node: FNode) -> bool:
    return all(a.node_type in (Op.LE, Op.LT, Op.PRESENT_EXP) for a in node.args)


def _is_order(node: FNode) -> bool:
    return all(a.node_type in (Op.LE, Op.LT) for a in node.args)


def _is_presence(node: FNode) -> bool:
    return bool(node.node_type is Op.PRESENT_EXP)


def _inwards(node: FNode, known: Known, positive: bool = True) -> FNode:
    """Return ``node`` (or its negation) without ``Implies`` and with ``Not`` on atoms only."""
    # copies of one activity are told apart two by two: most parts of constraints come many times
    key = (node.node_id, positive)
    found = known.get(key)
    if found is None:
        found = known[key] = _rewritten(node, known, positive)
    return found


def _rewritten(node: FNode, known: Known, positive: bool) -> FNode:
    kind, manager = node.node_type, node.environment.expression_manager
    if kind is Op.NOT:
        return _inwards(node.arg(0), known, not positive)
    if kind in (Op.AND, Op.OR):
        parts = [_inwards(a, known, positive) for a in node.args]
        return manager.And(parts) if (kind is Op.AND) == positive else manager.Or(parts)
    if kind is Op.IMPLIES:
        one, other = node.args
        parts = [_inwards(one, known, not positive), _inwards(other, known, positive)]
        return manager.Or(parts) if positive else manager.And(parts)
    if positive:
        return node
    if kind is Op.LE:
        return manager.LT(node.arg(1), node.arg(0))
    if kind is Op.LT:
        return manager.LE(node.arg(1), node.arg(0))
    if kind is Op.BOOL_CONSTANT:
        return manager.Bool(not node.bool_constant_value())
    return manager.Not(node)


def _scoped(node: FNode) -> Iterator[tuple[FNode | None, list[FNode]]]:
    """Yield (what must hold, presences that it needs); ``None`` is never."""
    if node.node_type is Op.AND:
        for part in node.args:
            yield from _scoped(part)
        return
    if node.is_true():
        return
    options = _disjuncts(node)
    absent = [o.arg(0) for o in options if o.node_type is Op.NOT and _is_presence(o.arg(0))]
    rest = [
        o
        for o in options
        if not (o.node_type is Op.NOT and _is_presence(o.arg(0))) and not o.is_false()
    ]
    if not rest:
        yield None, absent
    elif len(rest) == 1 and (rest[0].node_type is Op.AND):
        # p or (a and b) is (p or a) and (p or b)
        for part, more in _scoped(rest[0]):
            yield part, [*absent, *more]
    elif len(rest) == 1 or tuple(rest) == node.args:
        yield (node if len(rest) > 1 else rest[0]), absent
    else:
        yield node.environment.expression_manager.Or(rest), absent


def _disjuncts(node: FNode) -> list[FNode]:
    if node.node_type is Op.OR:
        return [part for arg in node.args for part in _disjuncts(arg)]
    return [node]
