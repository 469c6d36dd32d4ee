"""Fluents to precedence constraints, for engines without assignments to fluents.

The paper's helpers and deleters in general (Tosello et al., section on problems without fluents):
a condition on a state variable over ``[low, high]`` holds if an effect that gives a right value
(the helper), or the initial value, comes before ``low``, and no other effect (a deleter) comes
between that one and ``high``. Written out, that is cubic; here an integer variable ``since`` stands
for the time from which the supporting value is there, so that two quadratic families remain:

- some helper ``h`` is present with ``h.time + 1 = since <= low``, or the initial value is right
  and ``since = 0``;
- every effect ``x`` is absent, or ``x.time + 1 <= since``, or after ``high`` (at ``high`` already,
  for an effect of the condition's own activity, or where either belongs to the problem itself).

Two effects on a state variable are never at the same instant.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import replace
from functools import partial

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.fluents import asks_nothing, equals, reaches_end
from up_samp.scheduling.compilers.intervals import conjuncts
from up_samp.scheduling.compilers.plain import (
    FALSE,
    TRUE,
    Compiled,
    Condition,
    Effect,
    Expr,
    PlainProblem,
    conjunction,
    disjunction,
    evaluate,
    fluents_in,
    fresh,
    integer,
    later,
    names_in_use,
    negation,
    rewrite,
    show,
    values_of,
)


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
            holds = self._holds(condition, condition.expression)
            ways = asks_nothing(self.problem, condition)
            self.constraints.append(disjunction([*ways, holds]))
        counted = {f[1] for f in self.counted}
        compiled = replace(
            self.problem,
            constraints=(*self.problem.constraints, *self.constraints),
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

    def _by_value(self, condition: Condition, fluent: Expr, expression: Expr) -> Expr:
        """State that a relation of fluents holds at an instant, for each value of one of them."""
        cases = []
        for value in values_of(self.problem, self.problem.fluents[fluent[1]].type):
            rest = evaluate(rewrite(expression, {fluent: value}.get))
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
        return evaluate(rewrite(expression, {fluent: value}.get))
    cases = ((v, _when_right(problem, fluent, expression, v)) for v in values_of(problem, tpe))
    return disjunction(conjunction([equals(value, v), right]) for v, right in cases)
