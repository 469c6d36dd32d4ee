"""Values of types and of constant expressions."""

from __future__ import annotations

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.expressions import (
    FALSE,
    TRUE,
    Expr,
    Type,
    conjunction,
    disjunction,
    integer,
)
from up_samp.scheduling.compilers.plain import PlainProblem


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


def _constant(operator: str, values: list[int]) -> Expr:
    if operator == "not":
        return ("bool", not values[0])
    if operator == "implies":
        return ("bool", not values[0] or bool(values[1]))
    if operator in ("iff", "eq"):
        return ("bool", values[0] == values[1])
    if operator in ("le", "lt"):
        return ("bool", values[0] <= values[1] if operator == "le" else values[0] < values[1])
    if operator == "plus":
        return integer(sum(values))
    if operator == "minus":
        return integer(values[0] - values[1])
    if operator == "times":
        return integer(values[0] * values[1])
    raise UnsupportedError(f"operator {operator} in a condition")
