"""What UP expressions speak of, as several rooms ask it."""

from __future__ import annotations

from collections.abc import Iterator

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.timing import TimepointKind


def walk(node: FNode) -> Iterator[FNode]:
    """Yield ``node`` and everything below it, in order of appearance."""
    stack = [node]
    while stack:
        item = stack.pop()
        yield item
        stack += item.args[::-1]


def conjuncts(node: FNode) -> list[FNode]:
    """Return the parts of a conjunction (the node itself if it is none)."""
    if node.node_type is Op.AND:
        return [part for arg in node.args for part in conjuncts(arg)]
    return [node]


def fluent_told(node: FNode) -> tuple[FNode, FNode] | None:
    """Return (fluent, value) if ``node`` says that a fluent equals something."""
    if node.node_type is not Op.EQUALS:
        return None
    left, right = node.args
    if right.node_type is Op.FLUENT_EXP:
        left, right = right, left
    return (left, right) if left.node_type is Op.FLUENT_EXP else None


def activity_named(node: FNode) -> str | None:
    """Return the activity whose start, end, presence or parameter ``node`` itself is."""
    if node.node_type is Op.TIMING_EXP:
        name = node.timing().timepoint.container
    elif node.node_type is Op.PRESENT_EXP:
        name = node.presence().container
    elif node.node_type is Op.PARAM_EXP:
        name = node.parameter().name.rpartition(".")[0]
    else:
        return None
    return str(name) if name else None


def activities_in(node: FNode) -> set[str]:
    """Return the activities that an expression speaks of."""
    return {name for item in walk(node) if (name := activity_named(item)) is not None}


def end_before_start(node: FNode) -> tuple[str, str, int] | None:
    """Return (a, b, units) if ``node`` says ``a.end + units <= b.start``, and nothing else."""
    if node.node_type not in (Op.LE, Op.LT):
        return None
    left, right = node.args
    if not left.node_type is right.node_type is Op.TIMING_EXP:
        return None
    end, start = left.timing(), right.timing()
    first, then = end.timepoint, start.timepoint
    if first.kind is not TimepointKind.END or then.kind is not TimepointKind.START:
        return None
    units = end.delay - start.delay + (node.node_type is Op.LT)
    if first.container is None or then.container is None or not isinstance(units, int):
        return None
    return first.container, then.container, units
