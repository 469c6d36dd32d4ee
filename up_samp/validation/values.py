"""Values of UP expressions under a plan: Kleene's logic for what absent activities leave open."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, Final

from unified_planning.model import OperatorKind as Op
from unified_planning.model import Timepoint, TimepointKind

from up_samp.model import UnsupportedError

MISSING: Final = object()
"""The value of a start, end or parameter of an absent activity, and of all that depends on it."""

Value = Any
"""``bool``, ``int``, ``Fraction``, an object's name, or ``MISSING``."""

Key = tuple[str, tuple[Value, ...]]
"""A ground fluent: its name and the values of its arguments."""


@dataclass(frozen=True)
class Decisions:
    """What a plan decides: ``times[name] = (start, end)`` of present activities only, values of
    the parameters that have one (by their full name), and the makespan.
    """

    times: Mapping[str, tuple[Value, Value]]
    parameters: Mapping[str, Value]
    objects: Mapping[str, tuple[str, ...]]
    """Names of the objects of each user type, subtypes included."""
    instant: Value = 1
    """How far apart two instants are (units): what was executed has times between the units."""

    @cached_property
    def makespan(self) -> int:
        """Latest end of a present activity (every timing asks for it)."""
        return max((end for _, end in self.times.values()), default=0)

    def timepoint(self, point: Any, owner: str | None, global_end: int) -> Value:
        """Return the time of a UP ``Timepoint``; one without a container belongs to ``owner``."""
        if point.kind == TimepointKind.GLOBAL_START:
            return 0
        if point.kind == TimepointKind.GLOBAL_END:
            return global_end
        name = point.container if point.container is not None else owner
        if name is None or name not in self.times:
            return MISSING
        return self.times[name][0 if point.kind == TimepointKind.START else 1]

    def timing(self, timing: Any, owner: str | None, global_end: int) -> Value:
        """Return the time of a UP ``Timing`` (a timepoint and a delay), or of a bare timepoint, as
        scripts write it in intervals.
        """
        if isinstance(timing, Timepoint):
            return self.timepoint(timing, owner, global_end)
        base = self.timepoint(timing.timepoint, owner, global_end)
        return MISSING if base is MISSING else plain(base + timing.delay)


@dataclass
class Reader:
    """Evaluates expressions. ``fluent`` gives the value of a ground fluent (at the instant that
    the caller has in mind); ``reads`` collects the ground fluents that were looked at. ``hasty``
    readers leave out what cannot change a disjunction or conjunction, and do not collect all.
    """

    decisions: Decisions
    fluent: Callable[[Key], Value]
    owner: str | None = None
    bindings: Mapping[str, Value] = field(default_factory=dict)
    reads: set[Key] = field(default_factory=set)
    hasty: bool = False

    def value(self, node: Any) -> Value:
        """Return the value of a UP expression."""
        kind = node.node_type
        if kind in _LEAVES:
            return _LEAVES[kind](self, node)
        if kind in (Op.OR, Op.AND) and self.hasty:
            return _joined(map(self.value, node.args), kind == Op.OR)
        if kind in _OPERATORS:
            return _OPERATORS[kind]([self.value(a) for a in node.args])
        raise UnsupportedError(f"the validator does not know the operator {kind.name} in '{node}'")

    def key(self, node: Any) -> Key | None:
        """Return the ground fluent that a fluent expression means (None: unknown arguments)."""
        arguments = tuple(self.value(a) for a in node.args)
        return None if MISSING in arguments else (node.fluent().name, arguments)

    def told(self, node: Any) -> Value:
        """Return the value of a fluent expression, and note that it was read."""
        key = self.key(node)
        if key is None:
            return MISSING
        self.reads.add(key)
        return self.fluent(key)

    def quantified(self, node: Any) -> Value:
        """Return the value of an expression about all, or some, values of variables."""
        values = []
        for bindings in combinations(node.variables(), self.decisions.objects):
            inner = Reader(
                self.decisions,
                self.fluent,
                self.owner,
                {**self.bindings, **bindings},
                self.reads,
                self.hasty,
            )
            values.append(inner.value(node.args[0]))
        return _joined(values, node.node_type == Op.EXISTS)


def chronicles(problem: Any, decisions: Decisions) -> list[tuple[Any, str | None]]:
    """Return what says something in a plan: the problem, and its present activities by name."""
    present = [(a, a.name) for a in problem.activities if a.name in decisions.times]
    return [(problem._base, None), *present]


def parts_of(node: Any) -> Iterator[Any]:
    """Yield an expression and all that it is made of."""
    stack = [node]
    while stack:
        item = stack.pop()
        stack += item.args
        yield item


def plain(number: Any) -> Value:
    """Return an integral ``Fraction`` as ``int``, anything else unchanged."""
    if number.__class__ is int:  # the most common, and asking for Fraction is slow
        return number
    if isinstance(number, Fraction) and number.denominator == 1:
        return int(number)
    return number


def domain(type_: Any, objects: Mapping[str, tuple[str, ...]]) -> list[Value]:
    """Return all values of a finite UP type."""
    if type_.is_bool_type():
        return [False, True]
    if type_.is_user_type():
        return list(objects.get(type_.name, ()))
    if type_.is_int_type() and type_.lower_bound is not None and type_.upper_bound is not None:
        return list(range(type_.lower_bound, type_.upper_bound + 1))
    raise UnsupportedError(f"the validator cannot quantify over the infinite type {type_}")


def combinations(variables: Any, objects: Mapping[str, tuple[str, ...]]) -> list[dict[str, Value]]:
    """Return all ways to bind quantified UP variables to values of their types."""
    found: list[dict[str, Value]] = [{}]
    for variable in variables:
        values = domain(variable.type, objects)
        found = [{**old, variable.name: value} for old in found for value in values]
    return found


def _joined(values: Iterable[Value], decides: bool) -> Value:
    """Return the value of a disjunction (``decides``: true) or conjunction (false); what comes
    after a value that decides it is not asked for.
    """
    result: Value = not decides
    for value in values:
        if value is decides:
            return decides
        if value is MISSING:
            result = MISSING
    return result


def _not(value: Value) -> Value:
    return MISSING if value is MISSING else not value


def _strict(function: Callable[..., Value]) -> Callable[[list[Value]], Value]:
    """Return ``function`` of all values, missing as soon as one of them is."""
    return lambda values: MISSING if MISSING in values else plain(function(*values))


_LEAVES: dict[Any, Callable[[Reader, Any], Value]] = {
    **dict.fromkeys(
        (Op.BOOL_CONSTANT, Op.INT_CONSTANT, Op.REAL_CONSTANT),
        lambda _, node: plain(node.constant_value()),
    ),
    Op.OBJECT_EXP: lambda _, node: node.object().name,
    Op.PARAM_EXP: lambda r, node: r.decisions.parameters.get(node.parameter().name, MISSING),
    Op.VARIABLE_EXP: lambda r, node: r.bindings[node.variable().name],
    Op.PRESENT_EXP: lambda r, node: node.presence().container in r.decisions.times,
    Op.TIMING_EXP: lambda r, n: r.decisions.timing(n.timing(), r.owner, r.decisions.makespan),
    Op.FLUENT_EXP: Reader.told,
    Op.EXISTS: Reader.quantified,
    Op.FORALL: Reader.quantified,
}
"""What is read by itself, not from the values of its parts."""

_OPERATORS: dict[Any, Callable[[list[Value]], Value]] = {
    Op.AND: lambda v: _joined(v, False),
    Op.OR: lambda v: _joined(v, True),
    Op.NOT: lambda v: _not(v[0]),
    Op.IMPLIES: lambda v: _joined([_not(v[0]), v[1]], True),
    Op.IFF: _strict(lambda a, b: a == b),
    Op.EQUALS: _strict(lambda a, b: a == b),
    Op.LE: _strict(lambda a, b: a <= b),
    Op.LT: _strict(lambda a, b: a < b),
    Op.PLUS: _strict(lambda *v: sum(v)),
    Op.MINUS: _strict(lambda a, b: a - b),
    Op.TIMES: _strict(lambda *v: math.prod(v)),
    Op.DIV: _strict(lambda a, b: Fraction(a) / Fraction(b)),
}


def telling(given: Any, item: Any) -> Any:
    """Return the expression for a listed obstacle: ``at`` means ``at(item)`` (rule 19)."""
    if getattr(given, "arity", 0) == 1 and given.signature[0].type.is_compatible(item.type):
        return given(item)
    return item.environment.expression_manager.auto_promote(given)[0]
