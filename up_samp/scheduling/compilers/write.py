"""From a :class:`PlainProblem` back to a UP ``SchedulingProblem``."""

from __future__ import annotations

from itertools import starmap
from typing import Any

from unified_planning.environment import Environment, get_environment
from unified_planning.model import (
    Fluent as UpFluent,
)
from unified_planning.model import (
    FNode,
    Object,
    Parameter,
    Presence,
    Timepoint,
    TimepointKind,
    Timing,
)
from unified_planning.model.effect import Effect as UpEffect
from unified_planning.model.effect import EffectKind
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.scheduling import Activity as UpActivity
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.timing import TimeInterval

from up_samp.scheduling.compilers.plain import Activity, Effect, Expr, PlainProblem, Type

EFFECT_KINDS = {
    "assign": EffectKind.ASSIGN,
    "increase": EffectKind.INCREASE,
    "decrease": EffectKind.DECREASE,
}
POINTS = {
    "start": TimepointKind.START,
    "end": TimepointKind.END,
    "zero": TimepointKind.GLOBAL_START,
    "horizon": TimepointKind.GLOBAL_END,
}


def write_problem(
    problem: PlainProblem, environment: Environment | None = None
) -> SchedulingProblem:
    """Return ``problem`` as a UP problem (in the global environment if none is given)."""
    return _ProblemWriter(problem, environment or get_environment()).write()


class _ProblemWriter:
    def __init__(self, problem: PlainProblem, environment: Environment):
        self.plain = problem
        self.environment = environment
        self.manager = environment.expression_manager
        self.up = SchedulingProblem(problem.name, environment)
        self._memo: dict[Expr, FNode] = {}
        self._types: dict[str, Any] = {}
        self._parameters: dict[str, Parameter] = {}
        self._activities: dict[str, UpActivity] = {}

    def write(self) -> SchedulingProblem:
        plain, problem = self.plain, self.up
        for name in plain.types:
            problem._add_user_type(self.type(("user", name)))
        for name, user_type in plain.objects.items():
            problem.add_object(Object(name, self.type(("user", user_type)), self.environment))
        for name, fluent in plain.fluents.items():
            signature = list(starmap(self._parameter, fluent.parameters))
            problem.add_fluent(
                UpFluent(name, self.type(fluent.type), signature, environment=self.environment),
                default_initial_value=None
                if fluent.default is None
                else self.expression(fluent.default),
            )
        for fluent_expression, value in plain.initial.items():
            problem.set_initial_value(self.expression(fluent_expression), self.expression(value))
        for name, tpe in plain.variables.items():
            self._parameters[name] = self._parameter(name, tpe)
            problem._base._parameters[name] = self._parameters[name]
        for activity in plain.activities:
            self._declare(activity)
        for activity in plain.activities:
            self._activities[activity.name].set_duration_bounds(
                self.expression(activity.lower), self.expression(activity.upper)
            )
        # the type checker needs longer than all the rest: what comes from a reader or a
        # compiler is well typed, so constraints are appended as they are
        problem._base._constraints += [(self.expression(c), []) for c in plain.constraints]
        for condition in plain.conditions:
            span = TimeInterval(self.timing(condition.low), self.timing(condition.high))
            self._chronicle(condition.owner).add_condition(
                span, self.expression(condition.expression)
            )
        # aries finds nothing where an effect at the end is listed before one at the start
        for effect in sorted(plain.effects, key=lambda e: (e.time[1] != "start", e.time[3])):
            self._effect(effect)
        if plain.minimize_makespan:
            problem.add_quality_metric(MinimizeMakespan(environment=self.environment))
        return problem

    def _chronicle(self, owner: str | None) -> Any:
        return self.up._base if owner is None else self._activities[owner]

    def _declare(self, activity: Activity) -> None:
        new = UpActivity(activity.name, 0, activity.optional, _env=self.environment)
        for full_name, tpe in activity.parameters:
            parameter = self._parameter(full_name, tpe)
            new._parameters[full_name.rsplit(".", 1)[-1]] = parameter
            self._parameters[full_name] = parameter
        self._activities[activity.name] = new
        self.up._activities.append(new)

    def _parameter(self, name: str, tpe: Type) -> Parameter:
        return Parameter(name, self.type(tpe), self.environment)

    def _effect(self, effect: Effect) -> None:
        # appended as it is: UP's check for clashing effects cannot see slots and constraints
        effects = self._chronicle(effect.owner)._effects
        effects.setdefault(self.timing(effect.time), []).append(
            UpEffect(
                self.expression(effect.fluent),
                self.expression(effect.value),
                self.expression(effect.condition),
                kind=EFFECT_KINDS[effect.kind],
            )
        )

    def type(self, tpe: Type) -> Any:
        """Return the UP type."""
        manager = self.environment.type_manager
        if tpe[0] == "bool":
            return manager.BoolType()
        if tpe[0] == "int":
            return manager.IntType(tpe[1], tpe[2])
        name = tpe[1]
        if name not in self._types:
            father = self.plain.types[name]
            self._types[name] = manager.UserType(
                name, None if father is None else self.type(("user", father))
            )
        return self._types[name]

    def timing(self, time: Expr) -> Timing:
        """Return a ``time`` expression as a UP timing."""
        _, anchor, activity, delay = time
        return Timing(delay, Timepoint(POINTS[anchor], container=activity))

    def expression(self, expression: Expr) -> FNode:
        """Return a plain expression as a UP expression."""
        done = self._memo.get(expression)
        if done is None:
            done = self._memo[expression] = self._expression(expression)
        return done

    def _expression(self, expression: Expr) -> FNode:
        operator, manager = expression[0], self.manager
        if operator in ("bool", "int", "obj", "par", "pres", "time"):
            return self._leaf(expression)
        if operator == "flu":
            arguments = tuple(self.expression(e) for e in expression[2:])
            return manager.FluentExp(self.up.fluent(expression[1]), arguments)
        operands = [self.expression(e) for e in expression[1:]]
        build = {
            "and": manager.And,
            "or": manager.Or,
            "not": manager.Not,
            "implies": manager.Implies,
            "iff": manager.Iff,
            "eq": manager.Equals,
            "le": manager.LE,
            "lt": manager.LT,
            "plus": manager.Plus,
            "minus": manager.Minus,
            "times": manager.Times,
            "div": manager.Div,
        }[operator]
        return build(*operands)

    def _leaf(self, expression: Expr) -> FNode:
        operator, manager = expression[0], self.manager
        if operator == "bool":
            return manager.TRUE() if expression[1] else manager.FALSE()
        if operator == "int":
            return manager.Int(expression[1])
        if operator == "obj":
            return manager.ObjectExp(self.up.object(expression[1]))
        if operator == "par":
            return manager.ParameterExp(self._parameters[expression[1]])
        if operator == "pres":
            return manager.PresentExp(Presence(expression[1]))
        return manager.TimingExp(self.timing(expression))
