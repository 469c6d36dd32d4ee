"""Constraints to negation-free combinations of differences ``A + k <= B``, without products with
constants; rules about effects that UP's meaning has and engines do not always keep; who cannot be
at work at once.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

from up_samp.model import UnsupportedError, check_time
from up_samp.model.graphs import grouped
from up_samp.scheduling.compilers.plain import (
    FALSE,
    TRUE,
    Activity,
    Compiled,
    Effect,
    Expr,
    PlainProblem,
    conjunction,
    disjunction,
    end,
    fluents_in,
    folded,
    integer,
    later,
    negation,
    parts_of,
    rewrite,
    show,
    start,
    subexpressions,
)


def compile_products(problem: PlainProblem) -> Compiled:
    """Return the problem without products.

    Raises:
        UnsupportedError: a product of two things that are not constants, or with one above 100.
    """
    return Compiled(problem.mapped(_sums))


def _sums(expression: Expr) -> Expr:
    return rewrite(expression, _sum)


def _sum(expression: Expr) -> Expr | None:
    """Return a product as a sum; ``None`` if it is none."""
    if expression[0] != "times":
        return None
    constant, others = 1, []
    for factor in map(_sums, expression[1:]):
        if factor[0] == "int":
            constant *= factor[1]
        else:
            others.append(factor)
    if constant == 0 or not others:
        return integer(constant)
    if len(others) > 1 or abs(constant) > 100:
        raise UnsupportedError(f"the product {show(expression)}")
    total = others[0] if abs(constant) == 1 else ("plus", *others * abs(constant))
    return total if constant > 0 else ("minus", integer(0), total)


# ------------------ Rules about effects that UP's meaning has and engines do not always keep
# Said as constraints. No effect comes before time 0. Two effects of one owner on one state variable
# at the same instant clash (unless both count up or down): they cannot both happen.


def compile_rules(problem: PlainProblem) -> Compiled:
    """Add the rules as constraints, as far as effects can break them."""
    constraints: list[Expr] = []
    for effect in problem.effects:
        if effect.time[3] < 0:
            absent = negation(problem.presence(effect.owner))
            constraints.append(disjunction([absent, ("le", integer(0), effect.time)]))
    for effects in grouped(problem.effects, attrgetter("time", "fluent")).values():
        for a, b in itertools.combinations(effects, 2):
            counted = a.kind != "assign" and b.kind != "assign"
            certain = not (fluents_in(a.condition) or fluents_in(b.condition))
            if certain and not counted and a.owner == b.owner:
                constraints.append(disjunction(negation(problem.happens(e)) for e in (a, b)))
    return Compiled(problem.saying(constraints))


def compile_differences(problem: PlainProblem) -> Compiled:
    """Rewrite every constraint, and every condition so that only atoms are negated in it (aries
    knows no negated conjunction there); effects stay as they are.
    """
    normal = DifferenceForm(problem)
    constraints: dict[Expr, None] = {}
    for constraint in problem.constraints:
        check_time()
        constraints.update(dict.fromkeys(p for p in _parts(normal(constraint)) if p != TRUE))
    conditions = (
        replace(c, expression=folded(c.expression, _atom, conjunction, disjunction))
        for c in problem.conditions
    )
    return Compiled(replace(problem, constraints=tuple(constraints), conditions=tuple(conditions)))


def _atom(expression: Expr, positive: bool) -> Expr:
    return expression if positive else negation(expression)


def _parts(constraint: Expr) -> list[Expr]:
    """Return the conjuncts of a constraint: ``a or (b and c)`` has ``a or b`` and ``a or c``."""
    if constraint[0] == "and":
        return [part for conjunct in constraint[1:] for part in _parts(conjunct)]
    if constraint[0] == "or":
        inner = [e for e in constraint[1:] if e[0] == "and"]
        if len(inner) == 1:
            rest = [e for e in constraint[1:] if e is not inner[0]]
            return [p for e in inner[0][1:] for p in _parts(disjunction([*rest, e]))]
    return [constraint]


@dataclass
class Linear:
    """``sum(coefficients) + constant``; variables are ``time`` (without delay) or other leaves."""

    coefficients: dict[Expr, int]
    constant: int

    def add(self, other: Linear, factor: int) -> Linear:
        """Return ``self + factor * other``."""
        sums = dict(self.coefficients)
        for variable, coefficient in other.coefficients.items():
            sums[variable] = sums.get(variable, 0) + factor * coefficient
        return Linear({v: c for v, c in sums.items() if c}, self.constant + factor * other.constant)


def linear(expression: Expr) -> Linear:
    """Return a numeric expression as a linear form.

    Raises:
        UnsupportedError: a product of variables or a division.
    """
    operator = expression[0]
    if operator == "int":
        return Linear({}, expression[1])
    if operator == "time":
        if expression[1] == "zero":
            return Linear({}, expression[3])
        return Linear({(*expression[:3], 0): 1}, expression[3])
    if operator in ("par", "flu"):
        return Linear({expression: 1}, 0)
    if operator == "plus":
        total = Linear({}, 0)
        for operand in expression[1:]:
            total = total.add(linear(operand), 1)
        return total
    if operator == "minus":
        return linear(expression[1]).add(linear(expression[2]), -1)
    if operator == "times":
        return _product(expression)
    raise UnsupportedError(f"{show(expression)} in a linear constraint")


def _product(expression: Expr) -> Linear:
    result = Linear({}, 1)
    for factor in (linear(e) for e in expression[1:]):
        if not factor.coefficients:
            result = Linear({}, 0).add(result, factor.constant)
        elif not result.coefficients:
            result = Linear({}, 0).add(factor, result.constant)
        else:
            raise UnsupportedError(f"the product of variables {show(expression)}")
    return result


def less_equal_zero(form: Linear) -> Expr:
    """Return ``form <= 0`` in the shape ``A + k <= B`` (every ``k`` is on the side where it is
    positive).
    """
    left = [(v, c) for v, c in form.coefficients.items() if c > 0]
    right = [(v, -c) for v, c in form.coefficients.items() if c < 0]
    constant = form.constant
    if not left and not right:
        return TRUE if constant <= 0 else FALSE
    if not right and constant > 0 and all(v[0] == "time" for v, _ in left):
        return FALSE  # times are not negative
    if not left and constant <= 0 and all(v[0] == "time" for v, _ in right):
        return TRUE
    return ("le", _side(left, max(constant, 0)), _side(right, max(-constant, 0)))


def _side(terms: list[tuple[Expr, int]], constant: int) -> Expr:
    if not terms:
        return integer(constant)
    if len(terms) == 1 and terms[0][1] == 1 and terms[0][0][0] == "time":
        return later(terms[0][0], constant)
    total: Expr | None = None
    for variable, coefficient in terms:
        term = variable if coefficient == 1 else ("times", integer(coefficient), variable)
        term = _sums(term) if variable[0] == "time" else term  # UP knows no products of times
        total = term if total is None else ("plus", total, term)
    assert total is not None
    return ("plus", total, integer(constant)) if constant else total


class DifferenceForm:
    """Negation normal form over differences (memoised per polarity)."""

    def __init__(self, problem: PlainProblem):
        self._kind = problem.kind
        self._optional = problem.optional_names
        self._activities = [a.name for a in problem.activities]
        self._fixed = {
            a.name: a.lower[1]
            for a in problem.activities
            if a.lower == a.upper and a.lower[0] == "int"
        }
        self._owners = {n: a.name for a in problem.activities for n, _ in a.parameters}
        self._memo: dict[tuple[Expr, bool], Expr] = {}

    def __call__(self, expression: Expr, positive: bool = True) -> Expr:
        """Return ``expression`` (or its negation) in normal form."""
        key = (expression, positive)
        done = self._memo.get(key)
        if done is None:
            done = self._memo[key] = self._normal(expression, positive)
        return done

    def _normal(self, expression: Expr, positive: bool) -> Expr:
        operator = expression[0]
        if operator == "bool":
            return ("bool", expression[1] == positive)
        joined = parts_of(expression, positive)
        if joined is not None:
            join = conjunction if joined[0] else disjunction
            return join(list(itertools.starmap(self, joined[1])))
        if operator in ("le", "lt"):
            a, b = expression[1:]
            if positive:
                return self._at_most(expression, a, b, 1 if operator == "lt" else 0)
            return self._at_most(expression, b, a, 0 if operator == "lt" else 1)
        if operator == "eq":
            return self._equal(expression, positive)
        if operator == "pres":
            return expression if positive else ("not", expression)
        if operator in ("par", "flu"):
            return self._guarded(expression, expression if positive else ("not", expression))
        raise UnsupportedError(f"constraint {show(expression)}")

    def _at_most(self, original: Expr, left: Expr, right: Expr, slack: int) -> Expr:
        """Return ``left + slack <= right``, where ``original`` has values at all.

        The plan's end is written out: it is the latest end of those that are present.
        """
        form = linear(left).add(linear(right), -1).add(Linear({}, slack), 1)
        form = self._within_activities(form)
        horizon = ("time", "horizon", None, 0)
        factor = form.coefficients.pop(horizon, 0)
        if factor == 0:
            return self._guarded(original, less_equal_zero(form))
        if factor not in (1, -1):
            raise UnsupportedError(f"constraint {show(original)}")
        ways = [less_equal_zero(form)]  # with nothing there, the end is 0
        for name in self._activities:
            with_end = less_equal_zero(form.add(Linear({end(name): 1}, 0), factor))
            present = ("pres", name) if name in self._optional else TRUE
            if factor > 0:
                ways.append(disjunction([negation(present), with_end]))
            else:
                ways.append(conjunction([present, with_end]))
        whole = conjunction(ways) if factor > 0 else disjunction(ways)
        return self._guarded(original, whole)

    def _within_activities(self, form: Linear) -> Linear:
        """Put in the duration where start and end of an activity of fixed duration meet (in aries
        0.5.0 they may be one variable, and a difference between the two crashes its server).
        """
        for name in {v[2] for v in form.coefficients if v[0] == "time"} & self._fixed.keys():
            if start(name) in form.coefficients and end(name) in form.coefficients:
                factor = form.coefficients[end(name)]
                same = Linear({start(name): 1, end(name): -1}, self._fixed[name])
                form = form.add(same, factor)
        return form

    def _guarded(self, original: Expr, atom: Expr) -> Expr:
        """Return ``atom``, or that one of the activities is absent that ``original`` mentions."""
        absent = []
        for e in subexpressions(original):
            owner = e[2] if e[0] == "time" else self._owners.get(e[1]) if e[0] == "par" else None
            if owner in self._optional:
                absent.append(("not", ("pres", owner)))
        return disjunction([*absent, atom])

    def _equal(self, expression: Expr, positive: bool) -> Expr:
        _, a, b = expression
        kind = self._kind(a)
        if kind == "bool":
            return self(("iff", a, b), positive)
        if kind == "int":
            if positive:
                return conjunction(
                    [self._at_most(expression, a, b, 0), self._at_most(expression, b, a, 0)]
                )
            return disjunction(
                [self._at_most(expression, a, b, 1), self._at_most(expression, b, a, 1)]
            )
        if a[0] == "obj" and b[0] == "obj":
            return ("bool", (a == b) == positive)
        equal = ("eq", b, a) if a[0] == "obj" else expression
        return self._guarded(expression, equal if positive else ("not", equal))


# ------------------ Who cannot be at work at once
# ``uses`` as constraints on the order of users, for engines that count resources wrongly when
# durations vary. A resource is a fluent that activities only take from at their start and give back
# to at their end (the same amount). Activities that together take too much must not all overlap. As
# intervals have Helly's property (pairwise overlapping ones share an instant), it is enough that of
# each minimal set that takes too much some two are apart. A use without duration takes nothing.


def compile_resources(problem: PlainProblem, most: int = 5000) -> Compiled:
    """Replace resources by constraints on the order of their users.

    Where there are too many sets of users that take too much together, the resource stays if no
    duration of a user can vary: then engines count rightly.

    Raises:
        UnsupportedError: more than ``most`` such sets of users of a resource, some of whose
            durations vary, or that may be absent.
    """
    constraints: list[Expr] = []
    gone: set[Expr] = set()
    for fluent, capacity, amounts in _resources(problem):
        sets = list(itertools.islice(_minimal_sets(amounts, capacity), most + 1))
        if len(sets) <= most:
            gone.add(fluent)
            constraints += [_not_all_at_once(problem, users) for users in sets]
        elif not all(_fixed(problem.activity(name)) for name in amounts):
            raise UnsupportedError(
                f"resource {show(fluent)}: too many sets of activities take more "
                f"than {capacity} together"
            )
    names = {f[1] for f in gone}
    return Compiled(
        problem.saying(
            constraints,
            effects=tuple(e for e in problem.effects if e.fluent not in gone),
            fluents={n: f for n, f in problem.fluents.items() if n not in names},
            initial={k: v for k, v in problem.initial.items() if k[1] not in names},
        )
    )


def _fixed(activity: Activity) -> bool:
    """Return whether the activity takes place, with a certain positive duration."""
    lower = activity.lower
    return not activity.optional and lower == activity.upper and lower[0] == "int" and lower[1] > 0


def _resources(problem: PlainProblem) -> Iterator[tuple[Expr, int, dict[str, int]]]:
    """Yield the fluents (without arguments) that are resources: how much there is, and how much
    each activity takes.
    """
    read = {f for expression in problem.read() for f in fluents_in(expression)}
    for fluent, changes in grouped(problem.effects, attrgetter("fluent")).items():
        if fluent in read or len(fluent) > 2:
            continue
        amounts = amounts_taken(changes)
        tpe, initial = problem.fluents[fluent[1]].type, problem.initial_value(fluent)
        if amounts is None or initial[0] != "int" or tpe[1] is None:
            continue
        if tpe[2] is None or initial[1] <= tpe[2]:
            yield fluent, initial[1] - tpe[1], amounts


def amounts_taken(effects: Iterable[Effect]) -> dict[str, int] | None:
    """Return who takes how much, if all effects are the two halves of ``uses``."""
    taken: dict[str, int] = defaultdict(int)
    given: dict[str, int] = defaultdict(int)
    for effect in effects:
        owner = effect.owner
        if owner is None or effect.condition != TRUE or effect.value[0] != "int":
            return None
        if effect.kind == "decrease" and effect.time == start(owner):
            taken[owner] += effect.value[1]
        elif effect.kind == "increase" and effect.time == end(owner):
            given[owner] += effect.value[1]
        else:
            return None
    return dict(taken) if taken == given and all(a > 0 for a in taken.values()) else None


def _minimal_sets(amounts: dict[str, int], capacity: int) -> Iterator[tuple[str, ...]]:
    """Yield the sets of users that take too much, of which no proper subset does."""
    users = sorted(amounts, key=lambda n: -amounts[n])

    def extend(chosen: tuple[str, ...], total: int, rest: int) -> Iterator[tuple[str, ...]]:
        for i in range(rest, len(users)):
            amount = amounts[users[i]]
            # users come by falling amounts: the last one is the smallest of the set
            if total + amount > capacity:
                yield (*chosen, users[i])
            else:
                yield from extend((*chosen, users[i]), total + amount, i + 1)

    yield from extend((), 0, 0)


def _not_all_at_once(problem: PlainProblem, users: tuple[str, ...]) -> Expr:
    ways = [negation(problem.presence(name)) for name in users]
    for name in users:
        lower = problem.activity(name).lower
        if lower[0] != "int" or lower[1] < 1:
            ways.append(("le", end(name), start(name)))
    ways += [("le", end(a), start(b)) for a, b in itertools.permutations(users, 2)]
    return disjunction(ways)
