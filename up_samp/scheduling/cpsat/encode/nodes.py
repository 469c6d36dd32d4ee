"""Small questions about UP expressions."""

from __future__ import annotations

from collections.abc import Iterator

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op


def equals_object(node: FNode) -> str | None:
    """Return the object's name if ``node`` says that a fluent equals an object."""
    if node.node_type is not Op.EQUALS:
        return None
    left, right = node.args
    if right.node_type is Op.FLUENT_EXP:
        left, right = right, left
    if left.node_type is Op.FLUENT_EXP and right.node_type is Op.OBJECT_EXP:
        return str(right.object().name)
    return None


def equals_parameter(node: FNode) -> str | None:
    """Return the parameter's name if ``node`` says that a fluent equals an object parameter."""
    if node.node_type is not Op.EQUALS:
        return None
    left, right = node.args
    if right.node_type is Op.FLUENT_EXP:
        left, right = right, left
    if left.node_type is Op.FLUENT_EXP and right.node_type is Op.PARAM_EXP:
        return str(right.parameter().name) if right.type.is_user_type() else None
    return None


def conjuncts(node: FNode) -> list[FNode]:
    """Return the parts of a conjunction (the node itself if it is none)."""
    if node.node_type is Op.AND:
        return [part for arg in node.args for part in conjuncts(arg)]
    return [node]


def walk(node: FNode) -> Iterator[FNode]:
    """Yield ``node`` and everything below it."""
    yield node
    for arg in node.args:
        yield from walk(arg)


def fluents_in(node: FNode) -> dict[FNode, None]:
    """Return the fluent expressions in ``node``, in order of appearance."""
    return dict.fromkeys(n for n in walk(node) if n.node_type is Op.FLUENT_EXP)


def has_decisions(node: FNode) -> bool:
    """Return whether decision variables, times or presences occur."""
    kinds = (Op.PARAM_EXP, Op.TIMING_EXP, Op.PRESENT_EXP)
    return any(n.node_type in kinds for n in walk(node))


def unless_decided(node: FNode) -> tuple[FNode | None, FNode]:
    """Return a disjunction as (what parameters alone decide, what it says of fluents otherwise);
    (``None``, ``node``) if it is not of that kind.
    """
    manager = node.environment.expression_manager
    if node.node_type is Op.IMPLIES:
        node = manager.Or(manager.Not(node.arg(0)), node.arg(1))
    if node.node_type is not Op.OR:
        return None, node
    kinds = (Op.TIMING_EXP, Op.PRESENT_EXP)
    decided = [a for a in node.args if not fluents_in(a)]
    rest = [a for a in node.args if fluents_in(a)]
    if not decided or not rest or any(n.node_type in kinds for a in decided for n in walk(a)):
        return None, node
    return manager.Or(decided), manager.Or(rest)
