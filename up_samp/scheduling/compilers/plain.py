"""Scheduling problems as plain values: what compilers work on. Expressions are nested tuples."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

from up_samp.model import UnsupportedError, check_time
from up_samp.model.graphs import reached

# ------------------ Expressions as nested tuples
# ``("bool", b)``, ``("int", n)``, ``("obj", name)``: constants;
# ``("par", name)``: a decision variable (``activity.parameter`` or a global one);
# ``("pres", activity)``: the activity is present;
# ``("time", anchor, activity, k)``: ``anchor + k``; anchor is one of ``start``, ``end`` (of the
# activity), ``zero``, ``horizon`` (activity ``None``); ``("flu", name, *arguments)``: a fluent;
# ``("and"|"or", *operands)``, ``("not", x)``, ``("implies"|"iff", a, b)``,
# ``("eq"|"le"|"lt", a, b)``, ``("plus"|"times", *operands)``, ``("minus"|"div", a, b)``.
#
# Types are ``("bool",)``, ``("int", low, high)`` (``None``: open) and ``("user", name)``. Times
# are integers (schedule units).


Expr = tuple[Any, ...]
Type = tuple[Any, ...]
TRUE: Expr = ("bool", True)
FALSE: Expr = ("bool", False)
_LEAVES = ("bool", "int", "obj", "par", "pres", "time")


def start(activity: str, delay: int = 0) -> Expr:
    """Return the start of ``activity`` plus ``delay``."""
    return ("time", "start", activity, delay)


def end(activity: str, delay: int = 0) -> Expr:
    """Return the end of ``activity`` plus ``delay``."""
    return ("time", "end", activity, delay)


def integer(n: int) -> Expr:
    """Return an integer constant."""
    return ("int", n)


def later(time: Expr, delay: int) -> Expr:
    """Return a time expression moved by ``delay``."""
    return (*time[:3], time[3] + delay)


def conjunction(operands: Iterable[Expr]) -> Expr:
    """Return the flattened, simplified conjunction."""
    return _nary("and", operands, TRUE, FALSE)


def disjunction(operands: Iterable[Expr]) -> Expr:
    """Return the flattened, simplified disjunction."""
    return _nary("or", operands, FALSE, TRUE)


def _nary(operator: str, operands: Iterable[Expr], neutral: Expr, absorbing: Expr) -> Expr:
    check_time()  # most of what compilers make of large problems is made here
    flat: dict[Expr, None] = {}
    for operand in operands:
        if operand == absorbing:
            return absorbing
        if operand[0] == operator:
            flat.update(dict.fromkeys(operand[1:]))
        elif operand != neutral:
            flat[operand] = None
    if not flat:
        return neutral
    return next(iter(flat)) if len(flat) == 1 else (operator, *flat)


def negation(expression: Expr) -> Expr:
    """Return the simplified negation."""
    if expression[0] == "bool":
        return ("bool", not expression[1])
    return expression[1] if expression[0] == "not" else ("not", expression)


def implies(condition: Expr, consequence: Expr) -> Expr:
    """Return the simplified implication."""
    if TRUE in (condition, consequence):
        return consequence
    if condition == FALSE:
        return TRUE
    return ("implies", condition, consequence)


def subexpressions(expression: Expr) -> Iterator[Expr]:
    """Yield the expression and everything below it."""
    yield expression
    if expression[0] == "flu":
        for argument in expression[2:]:
            yield from subexpressions(argument)
    elif expression[0] not in _LEAVES:
        for operand in expression[1:]:
            yield from subexpressions(operand)


def fluents_in(expression: Expr) -> list[Expr]:
    """Return the fluent expressions in it, each once, in order of appearance."""
    return list(dict.fromkeys(e for e in subexpressions(expression) if e[0] == "flu"))


def rewrite(expression: Expr, leaf: Callable[[Expr], Expr | None]) -> Expr:
    """Return ``expression`` with every node replaced for which ``leaf`` returns one (top-down)."""
    replaced = leaf(expression)
    if replaced is not None:
        return replaced
    operator = expression[0]
    if operator in _LEAVES:
        return expression
    keep = 2 if operator == "flu" else 1
    return (*expression[:keep], *(rewrite(e, leaf) for e in expression[keep:]))


def parts_of(
    expression: Expr, positive: bool = True
) -> tuple[bool, list[tuple[Expr, bool]]] | None:
    """Return a formula (or its negation) as formulas that all hold (else: some of which do), each
    with whether it is to hold; ``None`` where nothing joins truth values.
    """
    operator, operands = expression[0], expression[1:]
    if operator == "not":
        return True, [(operands[0], not positive)]
    if operator in ("and", "or"):
        return (operator == "and") == positive, [(e, positive) for e in operands]
    if operator == "implies":
        return not positive, [(operands[0], not positive), (operands[1], positive)]
    if operator == "iff" and positive:
        return True, [(("implies", *operands), True), (("implies", *operands[::-1]), True)]
    if operator == "iff":
        return True, [(("or", *operands), True), (("and", *operands), False)]
    return None


T = TypeVar("T")


def folded(
    expression: Expr,
    leaf: Callable[[Expr, bool], T],
    every: Callable[[Iterable[T]], T],
    some: Callable[[Iterable[T]], T],
    positive: bool = True,
) -> T:
    """Return what ``every`` and ``some`` make of a formula's parts, and ``leaf`` of what joins no
    truth values; of its negation, if not ``positive``.
    """
    joined = parts_of(expression, positive)
    if joined is None:
        return leaf(expression, positive)
    both, parts = joined
    return (every if both else some)(folded(e, leaf, every, some, sign) for e, sign in parts)


def show(expression: Expr) -> str:
    """Return the expression as text for people."""
    operator, rest = expression[0], expression[1:]
    if operator in ("bool", "int", "obj", "par"):
        return str(rest[0])
    if operator == "pres":
        return f"present({rest[0]})"
    if operator == "time":
        anchor, activity, delay = rest
        name = anchor if activity is None else f"{activity}.{anchor}"
        return name if delay == 0 else f"{name} {'+' if delay > 0 else '-'} {abs(delay)}"
    if operator == "flu":
        arguments = ", ".join(show(e) for e in rest[1:])
        return f"{rest[0]}({arguments})" if arguments else str(rest[0])
    return f"{operator}({', '.join(show(e) for e in rest)})"


# ------------------ Scheduling problems as plain values: what the compilers work on
# A ``PlainProblem`` says the same as a UP ``SchedulingProblem`` in tuples and names: it is cheap
# to rewrite, to compare and to send to another process.


@dataclass(frozen=True)
class Activity:
    """An activity; ``lower`` and ``upper`` bound its duration (both included)."""

    name: str
    optional: bool
    lower: Expr
    upper: Expr
    parameters: tuple[tuple[str, Type], ...] = ()


@dataclass(frozen=True)
class Condition:
    """``expression`` holds at every instant of the closed interval ``[low, high]`` (two ``time``
    expressions; nothing is demanded where it is empty), if its ``owner`` is present, and parameters
    are as ``chosen``. ``dense``: and until right before ``high + 1``.
    """

    low: Expr
    high: Expr
    expression: Expr
    owner: str | None = None
    dense: bool = False
    chosen: Expr = TRUE

    def lets(self, effect: Effect) -> bool:
        """Return whether an effect may come within the interval at all: it is of the same activity,
        or one of the two is the problem's own.
        """
        return None in (self.owner, effect.owner) or self.owner == effect.owner


def conjuncts(conditions: Iterable[Condition]) -> Iterator[Condition]:
    """Yield each part of a conjunction as a condition by itself."""
    for condition in conditions:
        whole = condition.expression
        for part in whole[1:] if whole[0] == "and" else (whole,):
            yield replace(condition, expression=part)


@dataclass(frozen=True)
class Effect:
    """At ``time``: ``fluent`` is set to, increased or decreased by ``value`` (``kind`` is
    ``assign``, ``increase`` or ``decrease``) if ``condition`` holds and its ``owner`` is present.
    """

    time: Expr
    kind: str
    fluent: Expr
    value: Expr
    condition: Expr = TRUE
    owner: str | None = None


@dataclass(frozen=True)
class Fluent:
    """A fluent: its type, its parameters ``(name, type)`` and its default initial value."""

    type: Type
    parameters: tuple[tuple[str, Type], ...] = ()
    default: Expr | None = None


@dataclass(frozen=True)
class PlainProblem:
    """A scheduling problem. Constraints carry no scopes: they are written as implications.

    ``types`` maps a user type to its father, ``objects`` an object to its type, ``initial`` a
    ground fluent expression to its value where that is not the fluent's default.
    """

    activities: tuple[Activity, ...]
    constraints: tuple[Expr, ...] = ()
    conditions: tuple[Condition, ...] = ()
    effects: tuple[Effect, ...] = ()
    variables: Mapping[str, Type] = field(default_factory=dict)
    types: Mapping[str, str | None] = field(default_factory=dict)
    objects: Mapping[str, str] = field(default_factory=dict)
    fluents: Mapping[str, Fluent] = field(default_factory=dict)
    initial: Mapping[Expr, Expr] = field(default_factory=dict)
    minimize_makespan: bool = False

    def activity(self, name: str) -> Activity:
        """Return the activity with this name."""
        return self._by_name[name]

    @cached_property
    def _by_name(self) -> dict[str, Activity]:
        return {a.name: a for a in self.activities}

    def presence(self, owner: str | None) -> Expr:
        """Return that ``owner`` is there (true for the problem itself and mandatory activities)."""
        there = owner in self._by_name and self._by_name[owner].optional
        return ("pres", owner) if there else TRUE

    def apart(self, condition: Condition, effect: Effect) -> list[Expr]:
        """Return the ways in which a condition and an effect do not meet, whenever they are: whose
        they are is not there, or the effect's own condition, which reads no fluent, does not hold.
        """
        ways = [negation(self.presence(owner)) for owner in (condition.owner, effect.owner)]
        return ways if fluents_in(effect.condition) else [*ways, negation(effect.condition)]

    def missing(self, condition: Condition) -> list[Expr]:
        """Return the ways in which a condition asks nothing: whose it is, or whose times it names,
        is not there, or something else is chosen.
        """
        whose = dict.fromkeys((condition.owner, condition.low[2], condition.high[2]))
        return [*(negation(self.presence(name)) for name in whose), negation(condition.chosen)]

    def happens(self, effect: Effect) -> Expr:
        """Return that an effect happens: its owner is there, and its condition holds."""
        return conjunction([self.presence(effect.owner), effect.condition])

    def saying(self, constraints: Iterable[Expr], **changes: Any) -> PlainProblem:
        """Return the problem with more constraints, and with changes of other fields."""
        more = (c for c in constraints if c != TRUE)
        return replace(self, constraints=(*self.constraints, *more), **changes)

    def mapped(self, put: Callable[[Expr], Expr]) -> PlainProblem:
        """Return the problem with every expression of it replaced, but for initial values."""
        return replace(
            self,
            activities=tuple(
                replace(a, lower=put(a.lower), upper=put(a.upper)) for a in self.activities
            ),
            constraints=tuple(map(put, self.constraints)),
            conditions=tuple(
                replace(c, low=put(c.low), high=put(c.high), expression=put(c.expression))
                for c in self.conditions
            ),
            effects=tuple(
                replace(
                    e,
                    time=put(e.time),
                    fluent=put(e.fluent),
                    value=put(e.value),
                    condition=put(e.condition),
                )
                for e in self.effects
            ),
        )

    def read(self) -> Iterator[Expr]:
        """Yield every expression that reads fluents: all but what effects change."""
        yield from self.constraints
        for activity in self.activities:
            yield from (activity.lower, activity.upper)
        yield from (c.expression for c in self.conditions)
        for effect in self.effects:
            yield from (effect.value, effect.condition, *effect.fluent[2:])

    @cached_property
    def optional_names(self) -> frozenset[str]:
        """The names of the optional activities."""
        return frozenset(a.name for a in self.activities if a.optional)

    @cached_property
    def parameter_types(self) -> dict[str, Type]:
        """The type of every decision variable, by its full name."""
        types = dict(self.variables)
        for activity in self.activities:
            types.update(activity.parameters)
        return types

    def kind(self, expression: Expr) -> str:
        """Return of which kind of type an expression is: ``bool``, ``int`` or ``user``."""
        operator = expression[0]
        if operator == "par":
            return str(self.parameter_types[expression[1]][0])
        if operator == "flu":
            return str(self.fluents[expression[1]].type[0])
        if operator == "obj":
            return "user"
        number = operator in ("int", "time", "plus", "minus", "times", "div")
        return "int" if number else "bool"

    def objects_of(self, user_type: str) -> list[str]:
        """Return the objects of a user type and of the types below it."""
        fathers = self.types.items()
        below = reached([user_type], lambda above: (t for t, father in fathers if father == above))
        return [name for name, t in self.objects.items() if t in below]

    def initial_value(self, fluent: Expr) -> Expr:
        """Return the initial value of a ground fluent expression."""
        value = self.initial.get(fluent, self.fluents[fluent[1]].default)
        if value is None:
            raise UnsupportedError(f"fluent {show(fluent)} has no initial value")
        return value


@dataclass(frozen=True)
class Compiled:
    """A compiled problem. Activities and parameters that are not the original's are left out of its
    schedules (:func:`..engine_scheduler.restored`).

    ``presence``: activities that are optional in the original and are not here, with the bool
    parameters that say whether they are there.
    ``floor``: schedules of the compiled problem are never shorter than this even where the
    original's are, so an optimum at or below it proves nothing about the original.
    ``exact``: every schedule of the original has one in the compiled problem, of the same makespan
    (or ``floor``); otherwise neither "optimal" nor "unsolvable" carries over.
    """

    problem: PlainProblem
    presence: Mapping[str, str] = field(default_factory=dict)
    floor: int = 0
    exact: bool = True


# ------------------ Values of types and of constant expressions


def values_of(problem: PlainProblem, tpe: Type) -> list[Expr]:
    """Return all values of a type.

    Raises:
        UnsupportedError: an unbounded integer.
    """
    if tpe[0] == "bool":
        return [("bool", False), ("bool", True)]
    if tpe[0] == "user":
        return [("obj", name) for name in problem.objects_of(tpe[1])]
    if tpe[1] is None or tpe[2] is None:
        raise UnsupportedError("an unbounded integer where all values are needed")
    return [integer(n) for n in range(tpe[1], tpe[2] + 1)]


def some_value(problem: PlainProblem, tpe: Type) -> Expr:
    """Return any value of a type."""
    if tpe[0] == "int":
        return integer(min(0, tpe[2] or 0) if tpe[1] is None else tpe[1])
    return values_of(problem, tpe)[0]


def evaluate(expression: Expr) -> Expr:
    """Return the expression with all constant parts evaluated."""
    operator = expression[0]
    if operator in ("bool", "int", "obj", "par", "pres", "time", "flu"):
        return expression
    operands = [evaluate(e) for e in expression[1:]]
    if operator in ("and", "or"):
        return (conjunction if operator == "and" else disjunction)(operands)
    if any(o[0] not in ("bool", "int", "obj") for o in operands):
        return _half_constant(operator, operands)
    return _constant(operator, [o[1] for o in operands])


def _half_constant(operator: str, operands: list[Expr]) -> Expr:
    if operator == "implies":
        if operands[0] == FALSE or operands[1] == TRUE:
            return TRUE
        if operands[0] == TRUE:
            return operands[1]
    return (operator, *operands)


_FOLDED: Mapping[str, tuple[str, Callable[[list[int]], Any]]] = {
    "not": ("bool", lambda v: not v[0]),
    "implies": ("bool", lambda v: not v[0] or bool(v[1])),
    "iff": ("bool", lambda v: v[0] == v[1]),
    "eq": ("bool", lambda v: v[0] == v[1]),
    "le": ("bool", lambda v: v[0] <= v[1]),
    "lt": ("bool", lambda v: v[0] < v[1]),
    "plus": ("int", sum),
    "minus": ("int", lambda v: v[0] - v[1]),
    "times": ("int", math.prod),
}
"""What operators make of constants, and of what kind that is."""


def _constant(operator: str, values: list[int]) -> Expr:
    if operator not in _FOLDED:
        raise UnsupportedError(f"operator {operator} in a condition")
    kind, fold = _FOLDED[operator]
    return (kind, fold(values))


def put(expression: Expr, values: Mapping[Expr, Expr]) -> Expr:
    """Return an expression with what has a value replaced by that, and evaluated."""
    return evaluate(rewrite(expression, values.get))


# ------------------ Names that nothing in a problem has yet


def fresh(base: str, taken: set[str]) -> str:
    """Return a name like ``base`` that is not taken, and take it."""
    name, count = base, 0
    while name in taken:
        count += 1
        name = f"{base}_{count}"
    taken.add(name)
    return name


def names_in_use(problem: PlainProblem) -> set[str]:
    """Return every name of the problem."""
    names = {a.name for a in problem.activities}
    names.update(problem.variables, problem.types, problem.objects, problem.fluents)
    names.update(problem.parameter_types)
    return names
