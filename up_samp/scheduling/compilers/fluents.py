"""Fluents and types that engines take: ground fluents, without arguments, or precedences in place
of fluents; user types that something has, none below others; numbers with a least and a greatest
value.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.plain import (
    FALSE,
    TRUE,
    Activity,
    Compiled,
    Condition,
    Effect,
    Expr,
    Fluent,
    PlainProblem,
    Type,
    conjunction,
    conjuncts,
    disjunction,
    evaluate,
    fluents_in,
    fresh,
    integer,
    later,
    names_in_use,
    negation,
    put,
    rewrite,
    show,
    values_of,
)


def compile_instances(problem: PlainProblem) -> Compiled:
    """Expand conditions and effects over the parameters in arguments of fluents."""
    conditions: list[Condition] = []
    for condition in problem.conditions:
        for guard, values in _choices(problem, [condition.expression]):
            # who chooses one fluent leaves the others alone: they are not even read
            given = rewrite(condition.expression, values.get)
            one = replace(condition, expression=evaluate(given), chosen=guard)
            conditions += [*_still(one, given, problem.fluents), one]
    effects: list[Effect] = []
    for effect in problem.effects:
        parts = [effect.fluent, effect.value, effect.condition]
        for guard, values in _choices(problem, parts):
            fluent, value, told = (put(e, values) for e in parts)
            changed = replace(effect, fluent=fluent, value=value, condition=told)
            written = [rewrite(e, values.get) for e in parts[1:]]
            conditions += _beside(changed, written, problem.fluents, guard)
            effects.append(replace(changed, condition=conjunction([guard, told])))
    for constraint in problem.constraints:
        if any(len(f) > 2 for f in fluents_in(constraint)):
            raise UnsupportedError(f"the constraint over fluents {show(constraint)}")
    return Compiled(replace(problem, conditions=tuple(conditions), effects=tuple(effects)))


def _choices(
    problem: PlainProblem, expressions: list[Expr]
) -> Iterator[tuple[Expr, dict[Expr, Expr]]]:
    """Yield each choice of values for the parameters in arguments of fluents: a guard that says
    it is taken, and these values.
    """
    types = problem.parameter_types
    open_parameters: dict[Expr, None] = {}
    for expression in expressions:
        for fluent in fluents_in(expression):
            for argument in fluent[2:]:
                if argument[0] == "par":
                    open_parameters[argument] = None
                elif argument[0] not in ("obj", "int", "bool"):
                    raise UnsupportedError(f"the nested fluent {show(fluent)}")
    domains = [values_of(problem, types[p[1]]) for p in open_parameters]
    for choice in itertools.product(*domains):
        values = dict(zip(open_parameters, choice, strict=True))
        yield conjunction(itertools.starmap(equals, values.items())), values


def equals(variable: Expr, value: Expr) -> Expr:
    """Return ``variable = value`` for a constant value."""
    if value[0] == "bool":
        return variable if value[1] else negation(variable)
    return ("eq", variable, value)


def compile_ground(problem: PlainProblem) -> Compiled:
    """Return the problem over ground fluents where all arguments are constants, without fluents
    that never change.

    Raises:
        UnsupportedError: a duration that reads a fluent which effects change, or one of parameters.
    """
    fluents = _fluent_expressions(problem)
    open_names = {e[1] for e in fluents if any(a[0] not in ("obj", "int", "bool") for a in e[2:])}
    changed = {e.fluent[1] if e.fluent[1] in open_names else e.fluent for e in problem.effects}
    taken = names_in_use(problem)
    replaced: dict[Expr, Expr] = {}
    ground: dict[str, Fluent] = {n: problem.fluents[n] for n in sorted(open_names)}
    for fluent in fluents:
        if fluent[1] in open_names:
            continue
        if fluent not in changed:
            replaced[fluent] = problem.initial_value(fluent)
        elif len(fluent) == 2:
            ground[fluent[1]] = replace(
                problem.fluents[fluent[1]], default=problem.initial_value(fluent)
            )
        else:
            name = fresh(show(fluent), taken)
            replaced[fluent] = ("flu", name)
            declared = problem.fluents[fluent[1]]
            ground[name] = Fluent(declared.type, (), problem.initial_value(fluent))
    compiled = _grounded(problem, replaced, ground, open_names)
    for activity in compiled.activities:
        _refuse_fluents(activity, {e.fluent[1] for e in problem.effects})
    return Compiled(compiled)


def _refuse_fluents(activity: Activity, changed: set[str]) -> None:
    """Raise ``UnsupportedError`` if the duration reads a fluent (those of constants that effects
    never change have been replaced).
    """
    for bound in (activity.lower, activity.upper):
        for fluent in fluents_in(bound):
            what = f"the duration of {activity.name} reads the fluent {show(fluent)}"
            why = "which effects change" if fluent[1] in changed else "with its parameters"
            raise UnsupportedError(f"{what}, {why}")


def _fluent_expressions(problem: PlainProblem) -> list[Expr]:
    """Return every fluent expression of the problem once, in order of appearance."""
    places = (*problem.read(), *(e.fluent for e in problem.effects))
    return list(dict.fromkeys(f for place in places for f in fluents_in(place)))


def _grounded(
    problem: PlainProblem, replaced: dict[Expr, Expr], fluents: dict[str, Fluent], kept: set[str]
) -> PlainProblem:
    conditions: list[Condition] = []
    found = problem.mapped(lambda e: put(e, replaced))
    constraints = list(found.constraints)
    # in conditions the plan's end comes after all effects, also those that do not happen
    to_end = any("horizon" in (c.low[1], c.high[1]) for c in problem.conditions)
    for given, condition in zip(problem.conditions, found.conditions, strict=True):
        conditions += _still(condition, rewrite(given.expression, replaced.get), fluents)
        if fluents_in(condition.expression):
            conditions.append(condition)
        else:
            ways = asks_nothing(problem, condition)
            constraints.append(disjunction([condition.expression, *ways]))
    for written, effect in zip(problem.effects, found.effects, strict=True):
        parts = [rewrite(e, replaced.get) for e in (written.value, written.condition)]
        conditions += _beside(effect, parts, fluents)
    return replace(
        found,
        constraints=tuple(c for c in constraints if c != TRUE),
        conditions=tuple(conditions),
        effects=tuple(e for e in found.effects if to_end or e.condition != FALSE),
        fluents=fluents,
        initial={k: v for k, v in problem.initial.items() if k[1] in kept},
    )


def _still(condition: Condition, given: Expr, fluents: Mapping[str, Fluent]) -> list[Condition]:
    """Return what keeps others' effects away from what a condition reads, as it was ``given``, and
    what decides nothing in it any more.
    """
    idle = (f for f in fluents_in(given) if f not in fluents_in(condition.expression))
    same = (("iff" if fluents[f[1]].type[0] == "bool" else "eq", f, f) for f in idle)
    return [replace(condition, expression=e) for e in same]


def _beside(
    effect: Effect, given: list[Expr], fluents: Mapping[str, Fluent], chosen: Expr = TRUE
) -> list[Condition]:
    """Return what keeps others' effects away from what an effect's value and condition read, as
    ``given``, and what decides nothing in them any more; not from what it changes itself.
    """
    own = effect.fluent
    sets_any = own[1] if any(e[0] == "par" for e in own[2:]) else None
    left = FALSE if effect.condition == FALSE else ("and", effect.value, effect.condition)
    at = Condition(effect.time, effect.time, left, effect.owner, chosen=chosen)
    some = _still(at, ("and", *given), fluents) if effect.owner is not None else []
    return [c for c in some if c.expression[1] != own and c.expression[1][1] != sets_any]


def asks_nothing(problem: PlainProblem, condition: Condition) -> list[Expr]:
    """Return the ways in which a condition asks nothing: its owner or who has its times is absent,
    or its interval empty.
    """
    ways = problem.missing(condition)
    return ways if never_empty(problem, condition) else [*ways, empty(problem, condition)]


def never_empty(problem: PlainProblem, condition: Condition) -> bool:
    """Return whether the condition's interval is certain to hold an instant."""
    low, high = condition.low, condition.high
    if high[1] == "horizon" and low[1] != "horizon":
        high = later(high, 1)  # in conditions the plan's end comes after all ends and effects
    gap = least(problem, low, high)
    return gap is not None and gap >= 0


def least(problem: PlainProblem, early: Expr, late: Expr) -> int | None:
    """Return a lower bound on ``late - early`` (``None``: nothing is known)."""
    (_, first, a, before), (_, second, b, after) = early, late
    gap = int(after - before)
    if (first, a) == (second, b) or first == "zero":
        return gap
    if second == "horizon" and a is not None:
        return gap + (_lower(problem, a) if first == "start" else 0)
    if a is None or a != b:
        return None
    if first == "start":
        return gap + _lower(problem, a)
    upper = problem.activity(a).upper
    return gap - int(upper[1]) if upper[0] == "int" else None


def _lower(problem: PlainProblem, activity: str) -> int:
    lower = problem.activity(activity).lower
    return int(lower[1]) if lower[0] == "int" else 0


def empty(problem: PlainProblem, condition: Condition) -> Expr:
    """Return the constraint that the condition's interval holds no instant."""
    low, high = condition.low, condition.high
    if high[1] == "horizon":
        return comes_after(problem, low, high)
    return comes_before(problem, high, low)


def comes_before(problem: PlainProblem, time: Expr, until: Expr) -> Expr:
    """State that a time comes before an end of a condition."""
    if until[1] == "horizon" != time[1]:
        return negation(reaches_end(problem, int(until[3]), time))
    return ("le", later(time, 1), until)


def comes_after(problem: PlainProblem, time: Expr, since: Expr) -> Expr:
    """State that a time comes after an end of a condition."""
    if since[1] == "horizon" != time[1]:
        return reaches_end(problem, int(since[3]) + 1, time)
    return ("le", later(since, 1), time)


def reaches_end(problem: PlainProblem, delay: int, time: Expr) -> Expr:
    """State that a time is not before the plan's end, as conditions see it, plus ``delay``: that is
    one after the last of all ends and effects, not the makespan. An effect counts if it has a time,
    also where its condition does not hold.
    """
    late: list[Expr] = [("le", ("time", "horizon", None, 1 + delay), time)]
    for effect in problem.effects:
        absent = (negation(problem.presence(name)) for name in (effect.owner, effect.time[2]))
        late.append(disjunction([*absent, ("le", later(effect.time, 1 + delay), time)]))
    return conjunction(late)


def outside(problem: PlainProblem, condition: Condition, effect: Effect) -> Expr:
    """State that the effect does not happen within the interval (always, if that is empty)."""
    before = comes_before(problem, effect.time, condition.low)
    after = comes_after(problem, effect.time, condition.high)
    return disjunction([*problem.apart(condition, effect), before, after])


# ------------------ User types below others away


def compile_flat_types(problem: PlainProblem) -> Compiled:
    """Return the problem with flat types only."""
    root = partial(_root, problem)

    def flat(tpe: Type) -> Type:
        return ("user", root(tpe[1])) if tpe[0] == "user" else tpe

    def flat_all(parameters: tuple[tuple[str, Type], ...]) -> tuple[tuple[str, Type], ...]:
        return tuple((name, flat(tpe)) for name, tpe in parameters)

    restricted: list[Expr] = []
    for name, tpe in problem.parameter_types.items():
        if tpe[0] == "user" and problem.types[tpe[1]] is not None:
            choices = problem.objects_of(tpe[1])
            restricted.append(disjunction(("eq", ("par", name), ("obj", o)) for o in choices))
    flattened = problem.saying(
        restricted,
        activities=tuple(replace(a, parameters=flat_all(a.parameters)) for a in problem.activities),
        variables={n: flat(t) for n, t in problem.variables.items()},
        types={n: None for n, father in problem.types.items() if father is None},
        objects={o: root(t) for o, t in problem.objects.items()},
        fluents={
            n: Fluent(flat(f.type), flat_all(f.parameters), f.default)
            for n, f in problem.fluents.items()
        },
    )
    return Compiled(flattened)


def _root(problem: PlainProblem, name: str) -> str:
    """Return the type above all others that a type is below of."""
    father = problem.types[name]
    return name if father is None else _root(problem, father)


# ------------------ User types that nothing has


def compile_unused(problem: PlainProblem) -> Compiled:
    """Drop types that no variable, fluent or fluent's parameter has, nor a relative of one."""
    needed: set[Type] = set(problem.parameter_types.values())
    for fluent in problem.fluents.values():
        needed |= {fluent.type, *(tpe for _, tpe in fluent.parameters)}
    roots = {_root(problem, tpe[1]) for tpe in needed if tpe[0] == "user"}
    kept = {name: father for name, father in problem.types.items() if _root(problem, name) in roots}
    objects = {name: tpe for name, tpe in problem.objects.items() if tpe in kept}
    return Compiled(replace(problem, types=kept, objects=objects))


# ------------------ Numbers without a least or a greatest value


def compile_least(problem: PlainProblem) -> Compiled:
    """Give every number a least value (cpse 0.1.0 takes 0 where there is none): a fluent the least
    that its effects can make of it. The result is not exact where a parameter has none.
    """
    return _closed(problem, 1, -1)


def compile_greatest(problem: PlainProblem) -> Compiled:
    """Give every number a greatest value, likewise (aries 0.5.0 knows no half-open ranges)."""
    return _closed(problem, 2, 1)


def _closed(problem: PlainProblem, end: int, sign: int, far: int = 10**8) -> Compiled:
    """Give numbers an end (1: the least value, 2: the greatest); parameters may go ``far``."""

    def is_open(tpe: Type) -> bool:
        return tpe[0] == "int" and tpe[end] is None

    def close(tpe: Type, value: int = sign * far) -> Type:
        return (*tpe[:end], value, *tpe[end + 1 :]) if is_open(tpe) else tpe

    exact = not any(map(is_open, problem.parameter_types.values()))
    closed = replace(
        problem,
        activities=tuple(
            replace(a, parameters=tuple((n, close(t)) for n, t in a.parameters))
            for a in problem.activities
        ),
        variables={n: close(t) for n, t in problem.variables.items()},
    )
    fluents = {
        name: replace(f, type=close(f.type, _furthest(closed, name, sign)))
        if is_open(f.type)
        else f
        for name, f in problem.fluents.items()
    }
    return Compiled(replace(closed, fluents=fluents), exact=exact)


def _furthest(problem: PlainProblem, name: str, sign: int) -> int:
    """Return a value that a fluent cannot fall below (``sign`` -1) or rise above, 0 at most or at
    least: cpse takes no others.

    Raises:
        UnsupportedError: it is changed by what is neither a constant nor a parameter.
    """
    values = [sign * v[1] for f, v in problem.initial.items() if f[1] == name]
    default, total = problem.fluents[name].default, 0
    values += [] if default is None else [sign * default[1]]
    for effect in problem.effects:
        if effect.fluent[1] != name:
            continue
        value = evaluate(effect.value)
        if value[0] not in ("int", "par"):
            raise UnsupportedError(f"{name}, a number without an end, changed by {show(value)}")
        some = (value[1],) if value[0] == "int" else problem.parameter_types[value[1]][1:]
        if effect.kind == "assign":
            values.append(max(sign * n for n in some))
        else:
            way = sign if effect.kind == "increase" else -sign
            total += max(0, *(way * n for n in some))
    return sign * max(0, max(values, default=0) + total)


# ------------------ Fluents to precedence constraints, for engines without assignments to fluents
# The paper's helpers and deleters in general (Tosello et al., section on problems without fluents):
# a condition on a state variable over ``[low, high]`` holds if an effect that gives a right value
# (the helper), or the initial value, comes before ``low``, and no other effect (a deleter) comes
# between that one and ``high``. Written out, that is cubic; here an integer variable ``since``
# stands for the time from which the supporting value is there, so that two quadratic families
# remain:
#
# - some helper ``h`` is present with ``h.time + 1 = since <= low``, or the initial value is right
#   and ``since = 0``;
# - every effect ``x`` is absent, or ``x.time + 1 <= since``, or after ``high`` (at ``high``, for an
#   effect of the condition's own activity, or where either belongs to the problem itself).
#
# Two effects on a state variable are never at the same instant.


def compile_precedences(problem: PlainProblem) -> Compiled:
    """Replace ground fluents that effects assign to (and conditions on them) by constraints.

    Fluents that are only increased and decreased, and on which there are no conditions, stay.

    Raises:
        UnsupportedError: a fluent that is both assigned and increased or decreased, one that
            is counted and has conditions, a conditional effect on the value of a fluent, an
            unbounded integer fluent.
    """
    return _PrecedenceCompiler(problem).compile()


class _PrecedenceCompiler:
    def __init__(self, problem: PlainProblem):
        self.problem = problem
        self.taken = names_in_use(problem)
        self.variables = dict(problem.variables)
        self.constraints: list[Expr] = []
        self.changes: dict[Expr, list[Effect]] = defaultdict(list)
        """By fluent; what each is conditional on includes that its owner is there."""
        self.counted: set[Expr] = {e.fluent for e in problem.effects if e.kind != "assign"}

    def compile(self) -> Compiled:
        kept = []
        for effect in self.problem.effects:
            if effect.fluent in self.counted:
                if effect.kind == "assign":
                    name = show(effect.fluent)
                    raise UnsupportedError(f"fluent {name}, both assigned and counted")
                if fluents_in(effect.condition):
                    name = show(effect.fluent)
                    raise UnsupportedError(f"a change of {name} that depends on fluents")
                kept.append(effect)
            else:
                self.changes[effect.fluent].append(self._change(effect))
        for fluent, changes in self.changes.items():
            self._bounds(fluent, changes)
            for a, b in itertools.combinations(changes, 2):
                self._apart(a, b)
        for condition in conjuncts(self.problem.conditions):
            ways = asks_nothing(self.problem, condition)
            for part in (self._holds(condition, condition.expression), *self._still(condition)):
                self.constraints.append(disjunction([*ways, part]))
        counted = {f[1] for f in self.counted}
        compiled = self.problem.saying(
            self.constraints,
            conditions=(),
            effects=tuple(kept),
            variables=self.variables,
            fluents={n: f for n, f in self.problem.fluents.items() if n in counted},
            initial={k: v for k, v in self.problem.initial.items() if k[1] in counted},
        )
        return Compiled(compiled)

    def _change(self, effect: Effect) -> Effect:
        for part in (effect.value, effect.condition):
            if fluents_in(part):
                raise UnsupportedError(
                    f"the effect of {effect.owner} on {show(effect.fluent)} that depends on fluents"
                )
        if effect.time[1] == "horizon":
            raise UnsupportedError(f"the effect on {show(effect.fluent)} at the plan's end")
        return replace(effect, condition=self.problem.happens(effect))

    def _bounds(self, fluent: Expr, changes: list[Effect]) -> None:
        """Values from parameters must be values of the fluent."""
        tpe = self.problem.fluents[fluent[1]].type
        for change in changes:
            if tpe[0] == "int" and change.value[0] != "bool":
                low, high = tpe[1:]
                inside = [] if low is None else [("le", integer(low), change.value)]
                inside += [] if high is None else [("le", change.value, integer(high))]
                inside = [c for c in (evaluate(c) for c in inside) if c != TRUE]
                if inside:
                    right = conjunction(inside)
                    self.constraints.append(disjunction([negation(change.condition), right]))

    def _apart(self, a: Effect, b: Effect) -> None:
        if a.time[:3] == b.time[:3] and a.time[3] != b.time[3]:
            return
        self.constraints.append(
            disjunction(
                [
                    negation(a.condition),
                    negation(b.condition),
                    ("lt", a.time, b.time),
                    ("lt", b.time, a.time),
                ]
            )
        )

    def _holds(self, condition: Condition, expression: Expr) -> Expr:
        """State that ``expression`` holds throughout the condition's interval."""
        fluents = fluents_in(expression)
        if not fluents:
            return expression
        if len(fluents) == 1:
            return self._single(condition, fluents[0], expression)
        if expression[0] == "and":
            return conjunction(self._holds(condition, e) for e in expression[1:])
        if expression[0] == "or":
            timeless = [e for e in expression[1:] if not fluents_in(e)]
            timed = [e for e in expression[1:] if e not in timeless]
            if len(timed) == 1 or condition.low == condition.high:
                return disjunction([*timeless, *(self._holds(condition, e) for e in timed)])
        if condition.low == condition.high:
            return self._by_value(condition, fluents[0], expression)
        return self._change_by_change(condition, fluents, expression)

    def _still(self, condition: Condition) -> Iterator[Expr]:
        """State that others change nothing that is read beside one fluent, whether or not it is
        that by which the condition holds.
        """
        fluents = fluents_in(condition.expression)
        for change in (c for f in fluents if len(fluents) > 1 for c in self.changes[f]):
            if not condition.lets(change):
                yield outside(self.problem, condition, change)

    def _by_value(self, condition: Condition, fluent: Expr, expression: Expr) -> Expr:
        """State that a relation of fluents holds at an instant, for each value of one of them."""
        cases = []
        for value in values_of(self.problem, self.problem.fluents[fluent[1]].type):
            rest = put(expression, {fluent: value})
            if rest != FALSE:
                here = self._single(condition, fluent, equals(fluent, value))
                cases.append(conjunction([here, self._holds(condition, rest)]))
        return disjunction(cases)

    def _change_by_change(
        self, condition: Condition, fluents: list[Expr], expression: Expr
    ) -> Expr:
        """State that a relation of fluents holds at the interval's start and after each change of
        its own within; others' changes keep out.
        """
        said = [self._holds(replace(condition, high=condition.low), expression)]
        for change in (c for f in fluents for c in self.changes[f]):
            ways = [negation(change.condition), self._before(change.time, condition.low)]
            ways += self._behind(condition, change)
            if condition.lets(change):
                then = later(change.time, 1)
                ways.append(self._holds(replace(condition, low=then, high=then), expression))
            said.append(disjunction(ways))
        return conjunction(said)

    def _single(self, condition: Condition, fluent: Expr, expression: Expr) -> Expr:
        """State that a condition on one fluent holds: a supporter, and no threat."""
        if fluent in self.counted:
            raise UnsupportedError(f"the condition on {show(fluent)}, which is counted")
        right = partial(_when_right, self.problem, fluent, expression)
        low = condition.low
        since = fresh("since", self.taken)
        self.variables[since] = ("int", 0, None)
        variable: Expr = ("par", since)
        ways = []
        initially = right(self.problem.initial_value(fluent))
        if initially != FALSE:
            ways.append(conjunction([("le", variable, integer(0)), initially]))
        undisturbed = []
        for change in self.changes[fluent]:
            visible = later(change.time, 1)
            value_right = right(change.value)
            undisturbed.append(self._no_threat(condition, change, variable, value_right))
            if value_right == FALSE:
                continue
            timely = [self._before(change.time, low)]
            equal = [("le", visible, variable), ("le", variable, visible)]
            ways.append(conjunction([change.condition, value_right, *equal, *timely]))
        return conjunction([disjunction(ways), *undisturbed])

    def _no_threat(
        self, condition: Condition, change: Effect, since: Expr, value_right: Expr
    ) -> Expr:
        """State that a change does not come between the supporter and the interval's end."""
        ways = [negation(change.condition), ("le", later(change.time, 1), since)]
        if condition.lets(change):
            ways.append(value_right)  # another supporter, from there on
        return disjunction([*ways, *self._behind(condition, change)])

    def _behind(self, condition: Condition, change: Effect) -> list[Expr]:
        """Return the ways in which a change comes after the interval (none: it cannot)."""
        high, time, own = condition.high, change.time, condition.lets(change)
        if high[1] != "horizon":
            return [("le", high, later(time, 0 if own else -1))]
        return [reaches_end(self.problem, int(high[3]) + (not own), time)] if high[3] < 0 else []

    def _before(self, time: Expr, low: Expr) -> Expr:
        """State that an effect at ``time`` has its value at ``low``."""
        if low[1] != "horizon":
            return ("lt", time, low)
        return TRUE if low[3] >= 0 else negation(reaches_end(self.problem, int(low[3]), time))


def _when_right(problem: PlainProblem, fluent: Expr, expression: Expr, value: Expr) -> Expr:
    """Return when an expression over a fluent (and parameters) holds if the fluent has ``value``: a
    constant, or a formula over parameters.
    """
    tpe = problem.fluents[fluent[1]].type
    if value[0] in ("bool", "int", "obj") or tpe[0] == "int":
        return put(expression, {fluent: value})
    cases = ((v, _when_right(problem, fluent, expression, v)) for v in values_of(problem, tpe))
    return disjunction(conjunction([equals(value, v), right]) for v, right in cases)
