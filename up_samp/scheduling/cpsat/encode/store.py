"""A thin layer over a CP-SAT model: integer variables, literals and half-reified constraints.

What literals and forms are: ``forms.py``. Forms are enforced one way only (a literal implies its
form), which is all that constraints in positive position need.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from typing import Any

from ortools.sat.python import cp_model

from up_samp.scheduling.cpsat.encode.forms import FALSE, TRUE, Cmp, Form, Lin, Literal, compare


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

    def without(self, some: Iterable[int]) -> ModelStore:
        """Return a copy in which nothing constrains some variables any more, so that they are put
        to any value: whatever keeps this model keeps the copy, too. Of intervals that do not
        overlap, or share something, those with such variables are left out, else a constraint is
        dropped as a whole.
        """
        copy = ModelStore()
        copy.model, copy.bounds, copy._sure = self.model.clone(), [*self.bounds], {*self._sure}
        copy._made = {
            var: copy.model.get_int_var_from_proto_index(made.index)
            for var, made in self._made.items()
        }
        gone = {self._made[var].index for var in some if var in self._made}
        intervals = set[int]()
        for number, constraint in enumerate(copy.model.proto.constraints):
            if constraint.has_no_overlap() or constraint.has_cumulative():
                _leave_out(constraint, intervals)
            elif any((v if v >= 0 else ~v) in gone for v in _variables_of(constraint)):
                if constraint.has_interval():
                    intervals.add(number)
                constraint.copy_from(type(constraint)())  # it always holds
        for number in gone:
            domain = copy.model.proto.variables[number].domain
            any_value = domain[0]
            domain.clear()
            domain.extend([any_value, any_value])
        return copy

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

    def value_known(self, var: int, value: int) -> Literal | None:
        """Return the literal of ``var == value`` if something has asked for it before."""
        low, high = self.bounds[var]
        if low == high or (low, high) == (0, 1):
            return self.is_value(var, value)
        return self._is_value.get((var, value))

    def conjunction_known(self, literals: Iterable[Literal]) -> Literal | None:
        """Return the literal of a conjunction if something has asked for it before."""
        some = tuple(sorted({x for x in literals if x != TRUE}))
        if len(some) <= 1:
            return some[0] if some else TRUE
        return self._literals.get(("all", some))

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


_EXPRESSIONS: dict[str, Callable[[Any], list[Any]]] = {
    "interval": lambda c: [c.start, c.size, c.end],
    "reservoir": lambda c: [*c.time_exprs, *c.level_changes],
    "int_prod": lambda c: [c.target, *c.exprs],
}
"""The linear expressions of a kind of constraint."""


def _variables_of(constraint: Any) -> Iterator[int]:
    """Yield the variables (by CP-SAT's indices) of a constraint that is on no intervals, and its
    literals.
    """
    yield from constraint.enforcement_literal
    if constraint.has_linear():
        yield from constraint.linear.vars
    for kind in ("bool_or", "at_most_one", "exactly_one", "circuit"):
        if getattr(constraint, f"has_{kind}")():
            yield from getattr(constraint, kind).literals
    for kind, expressions in _EXPRESSIONS.items():
        if getattr(constraint, f"has_{kind}")():
            for expression in expressions(getattr(constraint, kind)):
                yield from expression.vars
    if constraint.has_reservoir():
        yield from constraint.reservoir.active_literals


def _leave_out(constraint: Any, gone: Set[int]) -> None:
    """Leave intervals (by their numbers) out of what they must not overlap with, or share."""
    some = constraint.no_overlap if constraint.has_no_overlap() else constraint.cumulative
    kept = [n for n, interval in enumerate(some.intervals) if interval not in gone]
    if len(kept) == len(some.intervals):
        return
    intervals = [some.intervals[n] for n in kept]
    if constraint.has_cumulative():
        demands = [some.demands[n].offset for n in kept]
        some.demands.clear()
        for demand in demands:
            some.demands.add().offset = demand
    some.intervals.clear()
    some.intervals.extend(intervals)
