"""Expressions as nested tuples: conditions, constraints and durations of plain problems.

====================================  ===========================================================
``("bool", b)``, ``("int", n)``       constants
``("obj", name)``                     an object
``("par", name)``                     a decision variable (``activity.parameter`` or a global one)
``("pres", activity)``                the activity is present
``("time", anchor, activity, k)``     ``anchor + k``; anchor is one of ``start``, ``end`` (of
                                      the activity), ``zero``, ``horizon`` (activity ``None``)
``("flu", name, *arguments)``         a fluent
``("and"|"or", *operands)``           n-ary; ``("not", x)``, ``("implies"|"iff", a, b)``
``("eq"|"le"|"lt", a, b)``            comparisons
``("plus"|"times", *operands)``       n-ary; ``("minus"|"div", a, b)``
====================================  ===========================================================

Types are ``("bool",)``, ``("int", low, high)`` (``None``: open) and ``("user", name)``.
Times are integers (schedule units).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from up_samp.model import check_time

Expr = tuple[Any, ...]


Type = tuple[Any, ...]


TRUE: Expr = ("bool", True)


FALSE: Expr = ("bool", False)


_LEAVES = ("bool", "int", "obj", "par", "pres", "time", "var")


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
    if condition == TRUE or consequence == TRUE:
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
