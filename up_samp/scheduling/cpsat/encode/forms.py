"""Linear expressions and forms: what the CP-SAT model says, before it is in the model.

A *literal* is an integer: ``i >= 0`` is Boolean variable ``i``, ``~i`` its negation; ``TRUE`` and
``FALSE`` are constants. A *form* is what a Boolean expression becomes in negation normal form: a
literal, a :class:`Cmp`, or a tuple ``("&" | "|", forms...)``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from typing import Any, NamedTuple

TRUE = 0


FALSE = ~0


Literal = int


class Cmp(NamedTuple):
    """``sum(coef * var) + const  op  0`` where ``op`` is ``<=``, ``==`` or ``!=``.

    ``needs`` are the presence literals of the activities whose times or parameters occur: the
    comparison says nothing when one of them is absent (Kleene's *unknown*).
    """

    terms: tuple[tuple[int, int], ...]
    const: int
    op: str
    needs: tuple[Literal, ...] = ()


Form = Any
"""A literal (int), a Cmp, or ("&", form, ...) or ("|", form, ...)."""


class Lin(NamedTuple):
    """A linear expression ``sum(coef * var) + const`` with the presences it needs."""

    terms: tuple[tuple[int, int], ...] = ()
    const: int = 0
    needs: tuple[Literal, ...] = ()

    def plus(self, other: Lin, factor: int = 1) -> Lin:
        """Return ``self + factor * other``."""
        if not other.terms:
            const = self.const + factor * other.const
            return Lin(self.terms, const, join(self.needs, other.needs))
        sums = dict(self.terms)
        for var, coef in other.terms:
            sums[var] = sums.get(var, 0) + factor * coef
        terms = tuple(sorted((v, c) for v, c in sums.items() if c))
        return Lin(terms, self.const + factor * other.const, join(self.needs, other.needs))

    def shift(self, delay: int) -> Lin:
        """Return ``self + delay``."""
        return Lin(self.terms, self.const + delay, self.needs)

    def le(self, other: Lin) -> Form:
        """Return the form ``self <= other``."""
        return compare(self.plus(other, -1), "<=")


def constant(value: int) -> Lin:
    """Return a constant expression."""
    return Lin((), value)


def join(some: tuple[Literal, ...], others: tuple[Literal, ...]) -> tuple[Literal, ...]:
    """Return the union of two sorted tuples of literals."""
    if some == others or not others:
        return some
    return tuple(sorted({*some, *others})) if some else others


def compare(difference: Lin, op: str) -> Form:
    """Return the form ``difference op 0``, folded where it is constant."""
    if not difference.terms:
        value = difference.const
        holds = {"<=": value <= 0, "==": value == 0, "!=": value != 0}[op]
        if holds:
            return TRUE
        return disjunction([~p for p in difference.needs])
    return _in_lowest_terms(Cmp(difference.terms, difference.const, op, difference.needs))


def _in_lowest_terms(cmp: Cmp) -> Form:
    """Return a comparison divided by what its coefficients have in common, to whole numbers.

    Fractions were multiplied out: ``2 * start >= 11`` is ``start >= 6``, a difference again.
    """
    common = math.gcd(*(c for _, c in cmp.terms))
    if common <= 1:
        return cmp
    whole = cmp.const % common == 0
    if cmp.op != "<=" and not whole:
        return TRUE if cmp.op == "!=" else disjunction([~p for p in cmp.needs])
    terms = tuple((v, c // common) for v, c in cmp.terms)
    return cmp._replace(terms=terms, const=-(-cmp.const // common))


def comparisons(form: Form) -> Iterator[Cmp]:
    """Yield the comparisons in ``form``."""
    if form.__class__ is Cmp:
        yield form
    elif form.__class__ is tuple:
        for part in form[1:]:
            yield from comparisons(part)


def variables_in(form: Form) -> frozenset[int]:
    """Return the variables that ``form`` compares."""
    return frozenset(var for cmp in comparisons(form) for var, _ in cmp.terms)


def spoken_of(form: Form) -> frozenset[int]:
    """Return the variables that ``form`` speaks of: compared ones, and those of literals."""
    if form.__class__ is int:
        return frozenset((form if form >= 0 else ~form,))
    if form.__class__ is Cmp:
        return frozenset(var for var, _ in form.terms).union(*map(spoken_of, form.needs))
    return frozenset[int]().union(*map(spoken_of, form[1:]))


def value_told(form: Form, op: str) -> tuple[int, int] | None:
    """Return (variable, value) if a form says that the variable is (``==``), or is not (``!=``),
    that value.
    """
    if form.__class__ is Cmp and form.op == op and len(form.terms) == 1:
        ((var, factor),) = form.terms
        if abs(factor) == 1:
            return var, -form.const * factor
    return None


def difference_told(form: Form) -> tuple[int, int, int] | None:
    """Return (u, v, k) if a form says ``u + k <= v`` of two variables, and nothing else."""
    if form.__class__ is not Cmp or form.op != "<=" or len(form.terms) != 2:
        return None
    (u, one), (v, other) = form.terms
    if (one, other) == (1, -1):
        return u, v, form.const
    return (v, u, form.const) if (one, other) == (-1, 1) else None


def parts_of(op: str, form: Form) -> tuple[Form, ...]:
    """Return the parts of a form that is joined by ``op`` ("&", "|"); itself, if it is not."""
    return form[1:] if form.__class__ is tuple and form[0] == op else (form,)


def conjunction(forms: Iterable[Form]) -> Form:
    """Return the conjunction of ``forms``, flattened and folded."""
    return _combine("&", TRUE, FALSE, forms)


def disjunction(forms: Iterable[Form]) -> Form:
    """Return the disjunction of ``forms``, flattened and folded."""
    return _combine("|", FALSE, TRUE, forms)


def _combine(op: str, neutral: Literal, absorbing: Literal, forms: Iterable[Form]) -> Form:
    seen: dict[Form, None] = {}
    for form in forms:
        if form.__class__ is tuple and form[0] == op:
            seen.update(dict.fromkeys(form[1:]))
        elif form.__class__ is int and form == absorbing:
            return absorbing
        elif form.__class__ is not int or form != neutral:
            seen[form] = None
    if any(f.__class__ is int and ~f in seen for f in seen):
        return absorbing
    if not seen:
        return neutral
    return next(iter(seen)) if len(seen) == 1 else (op, *seen)


def clauses_of(form: Form, absent: Collection[Literal]) -> Iterator[Form]:
    """Yield the clauses of a form: each conjunct by itself, also behind what says just that some
    activities are ``absent`` (their literals).
    """
    kind = form[0] if form.__class__ is tuple else ""
    if kind == "&":
        for part in form[1:]:
            yield from clauses_of(part, absent)
        return
    inner = [p for p in form[1:] if p.__class__ is tuple and p[0] == "&"] if kind == "|" else []
    rest = [p for p in form[1:] if p is not inner[0]] if len(inner) == 1 else []
    if len(inner) == 1 and all(p.__class__ is int and p in absent for p in rest):
        # p or (a and b) is (p or a) and (p or b)
        for part in inner[0][1:]:
            yield from clauses_of(disjunction([*rest, part]), absent)
    elif form.__class__ is not int or form != TRUE:
        yield form


def indicator_sum(weighted: Iterable[tuple[Literal, int]]) -> Lin:
    """Return the sum of the weights of the literals that are true."""
    sums: dict[int, int] = {}
    const = 0
    for literal, weight in weighted:
        if literal == TRUE:
            const += weight
        elif literal >= 0:
            sums[literal] = sums.get(literal, 0) + weight
        elif literal != FALSE:
            sums[~literal] = sums.get(~literal, 0) - weight
            const += weight
    return Lin(tuple(sorted((v, c) for v, c in sums.items() if c)), const)
