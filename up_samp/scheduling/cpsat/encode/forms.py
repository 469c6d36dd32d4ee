"""Linear expressions and forms: what the CP-SAT model says; and a thin layer over the model itself,
of integer variables, literals and half-reified constraints.

A *literal* is an integer: ``i >= 0`` is Boolean variable ``i``, ``~i`` its negation; ``TRUE`` and
``FALSE`` are constants. A *form* is what a Boolean expression becomes in negation normal form: a
literal, a :class:`Cmp`, or a tuple ``("&" | "|", forms...)``. Forms are enforced one way only (a
literal implies its form), which is all that constraints in positive position need.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from ortools.sat.python import cp_model

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


def conditional(form: Form) -> tuple[frozenset[Literal], Cmp] | None:
    """Return (literals, comparison) if a form says that the one holds if all of the others do."""
    parts = parts_of("|", form)
    stated = [part for part in parts if part.__class__ is not int]
    if len(stated) != 1 or stated[0].__class__ is not Cmp:
        return None
    asked = {~part for part in parts if part.__class__ is int} | {*stated[0].needs}
    return frozenset(asked), stated[0]


def least_told(form: Form) -> tuple[int, int] | None:
    """Return (v, k) if a form says ``v >= k`` of one variable, and nothing else."""
    if form.__class__ is Cmp and form.op == "<=" and [c for _, c in form.terms] == [-1]:
        return form.terms[0][0], form.const
    return None


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


# ------------------ The CP-SAT model under construction


class ModelStore:
    """The CP-SAT model under construction."""

    def __init__(self) -> None:
        self.model = cp_model.CpModel()
        self.bounds: list[tuple[int, int]] = [(1, 1)]
        self._sure: set[Literal] = set()
        self._made: dict[int, Any] = {0: self.model.new_constant(1)}
        self._negated: dict[int, Any] = {}
        self._literals: dict[Form, Literal] = {}
        self._is_value: dict[tuple[int, int], Literal] = {}

    @cached_property
    def _copy(self) -> cp_model.CpModel:
        return cp_model.CpModel()

    def copy(self) -> Any:
        """Return a copy of the model, which holds until the next one is asked for: to fill it again
        takes a fifth of the time of a new one, which would also be kept, with all that it says,
        until garbage is looked for (OR-Tools' models refer to themselves).
        """
        self._copy.proto.copy_from(self.model.proto)
        self._copy.rebuild_constant_map()
        return self._copy

    # -- variables ---------------------------------------------------------------------------
    def integer(self, low: int, high: int) -> int:
        """Return a new integer variable in [low, high].

        It is made in the model when it is first used; until then :meth:`rebound` may change it.
        """
        self.bounds.append((low, high))
        return len(self.bounds) - 1

    def rebound(self, var: int, high: int) -> None:
        """Let a variable be 0 to ``high``, unless a constraint uses it already."""
        if var not in self._made:
            self.bounds[var] = (0, high)

    def var(self, index: int) -> Any:
        """Return the OR-Tools variable."""
        made = self._made.get(index)
        if made is None:
            low, high = self.bounds[index]
            made = self._made[index] = self.model.new_int_var(low, high, "")
        return made

    def position(self, index: int) -> int:
        """Return the variable's index in the CP-SAT model (and in its solutions)."""
        return self.var(index).index  # type: ignore[no-any-return]

    def positions(self) -> list[tuple[int, int]]:
        """Return (variable, its index in CP-SAT's model) for every variable in use."""
        return [(var, made.index) for var, made in self._made.items()]

    def member(self, values: Sequence[int]) -> int:
        """Return a new integer variable with one of ``values``."""
        self.bounds.append((min(values), max(values)))
        index = len(self.bounds) - 1
        if len(set(values)) <= max(values) - min(values):
            domain = cp_model.Domain.from_values(list(values))
            self._made[index] = self.model.new_int_var_from_domain(domain, "")
        return index

    def boolean(self) -> Literal:
        """Return a new Boolean variable."""
        self.bounds.append((0, 1))
        return len(self.bounds) - 1

    def raw(self, literal: Literal) -> Any:
        """Return the OR-Tools object of a literal."""
        if literal >= 0:
            return self.var(literal)
        found = self._negated.get(literal)
        if found is None:
            found = self._negated[literal] = self.var(~literal).negated()
        return found

    def positive(self, literal: Literal) -> Literal:
        """Return a literal without a negation that is worth the same."""
        if literal >= 0:
            return literal
        found = self.boolean()
        self.clause([~found, literal])
        self.clause([found, ~literal])
        return found

    def expression(self, lin: Lin) -> Any:
        """Return the OR-Tools expression of ``lin``."""
        if not lin.terms:
            return lin.const
        if len(lin.terms) == 1 and lin.terms[0][1] == 1:
            var = self.var(lin.terms[0][0])
            return var + lin.const if lin.const else var
        total = cp_model.LinearExpr.weighted_sum(
            [self.var(v) for v, _ in lin.terms], [c for _, c in lin.terms]
        )
        return total + lin.const

    def affine(self, lin: Lin) -> Any:
        """Return ``lin`` as an expression in at most one variable (for intervals)."""
        if len(lin.terms) <= 1:
            return self.expression(lin)
        return self.var(self.variable(lin))

    def variable(self, lin: Lin) -> int:
        """Return a variable that is worth ``lin``, whatever that needs."""
        if len(lin.terms) == 1 and lin.terms[0][1] == 1 and lin.const == 0:
            return lin.terms[0][0]
        var = self.integer(*self.range(lin))
        self.enforce(compare(lin.plus(Lin(((var, 1),)), -1)._replace(needs=()), "=="))
        return var

    def interval(self, start: Lin, size: Lin, end: Lin, present: Literal) -> Any:
        """Return an interval that is there if ``present`` is true."""
        times = self.affine(start), self.affine(size), self.affine(end)
        if present == TRUE:
            return self.model.new_interval_var(*times, "")
        return self.model.new_optional_interval_var(*times, self.raw(present), "")

    def range(self, lin: Lin) -> tuple[int, int]:
        """Return bounds of ``lin`` by the variables' initial domains."""
        low = high = lin.const
        for var, coef in lin.terms:
            a, b = self.bounds[var]
            low += min(coef * a, coef * b)
            high += max(coef * a, coef * b)
        return low, high

    # -- constraints -------------------------------------------------------------------------
    def clause(self, literals: Iterable[Literal]) -> None:
        """At least one of ``literals`` is true."""
        some = [x for x in literals if x != FALSE]
        if TRUE not in some:
            self.model.add_bool_or([self.raw(x) for x in some])
            if len(some) == 1:
                self._sure.add(some[0])

    def never(self, literal: Literal) -> bool:
        """Return whether it was stated, as it is, that ``literal`` is false."""
        return literal == FALSE or ~literal in self._sure

    def attain(self, value: Lin, times: Iterable[tuple[Literal, Lin]]) -> None:
        """``value`` is at most one of the ``times`` whose literals are true."""
        attained = []
        for active, time in times:
            literal = self.boolean()
            attained.append(literal)
            self.clause([~literal, active])
            self.enforce(value.le(time), (literal,))
        self.clause(attained)

    def at_most_one(self, literals: Sequence[Literal]) -> None:
        """At most one of ``literals`` is true."""
        if len(literals) > 1:
            self.model.add_at_most_one([self.raw(x) for x in literals])

    def enforce(self, form: Form, when: tuple[Literal, ...] = ()) -> None:
        """Demand ``form`` whenever all literals of ``when`` are true."""
        if FALSE in when or (form.__class__ is int and form == TRUE):
            return
        if form.__class__ is int:
            self.clause([form, *(~w for w in when)])
        elif form.__class__ is Cmp:
            self._linear(form, when)
        elif form[0] == "&":
            for part in form[1:]:
                self.enforce(part, when)
        else:
            self.clause([*(self.literal(part) for part in form[1:]), *(~w for w in when)])

    def _linear(self, cmp: Cmp, when: tuple[Literal, ...]) -> None:
        needed = {*when, *cmp.needs} if cmp.needs else when
        if FALSE in needed:
            return
        total = cp_model.LinearExpr.weighted_sum(
            [self.var(v) for v, _ in cmp.terms], [c for _, c in cmp.terms]
        )
        if cmp.op == "<=":
            constraint = self.model.add_linear_constraint(total, cp_model.INT_MIN, -cmp.const)
        elif cmp.op == "==":
            constraint = self.model.add_linear_constraint(total, -cmp.const, -cmp.const)
        else:
            constraint = self.model.add(total != -cmp.const)
        enforcement = [self.raw(x) for x in needed if x != TRUE]
        if enforcement:
            constraint.only_enforce_if(enforcement)

    def literal(self, form: Form) -> Literal:
        """Return a literal that implies ``form`` (the same one for the same form)."""
        if form.__class__ is int:
            return form  # type: ignore[no-any-return]
        found = self._literals.get(form)
        if found is None:
            found = self._literals[form] = self.boolean()
            self.enforce(form, (found,))
        return found

    def equivalent(self, form: Form, opposite: Form) -> Literal:
        """Return a literal that is true exactly if ``form`` holds; ``opposite`` is its negation."""
        if form.__class__ is int:
            return form  # type: ignore[no-any-return]
        key = ("=", form)
        found = self._literals.get(key)
        if found is None:
            found = self._literals[key] = self.literal(form)
            self.enforce(opposite, (~found,))
        return found

    def all_of(self, literals: Iterable[Literal]) -> Literal:
        """Return a literal equivalent to the conjunction of ``literals``."""
        some = tuple(sorted({x for x in literals if x != TRUE}))
        if FALSE in some or any(~x in some for x in some):
            return FALSE
        if len(some) <= 1:
            return some[0] if some else TRUE
        key = ("all", some)
        found = self._literals.get(key)
        if found is None:
            found = self._literals[key] = self.boolean()
            self.clause([found, *(~x for x in some)])
            for x in some:
                self.clause([x, ~found])
        return found

    def any_of(self, literals: Iterable[Literal]) -> Literal:
        """Return a literal equivalent to the disjunction of ``literals``."""
        return ~self.all_of(~x for x in literals)

    def is_value(self, var: int, value: int) -> Literal:
        """Return a literal equivalent to ``var == value``."""
        low, high = self.bounds[var]
        if low == high:
            return TRUE if value == low else FALSE
        if not low <= value <= high:
            return FALSE
        if (low, high) == (0, 1):
            return var if value == 1 else ~var
        found = self._is_value.get((var, value))
        if found is None:
            found = self._is_value[var, value] = self.boolean()
            self.enforce(Cmp(((var, 1),), -value, "=="), (found,))
            self.enforce(Cmp(((var, 1),), -value, "!="), (~found,))
        return found
