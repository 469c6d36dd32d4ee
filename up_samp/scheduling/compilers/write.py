"""From a :class:`PlainProblem` back to a UP ``SchedulingProblem``, under short names: messages to
engines' servers have a limit.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import starmap
from typing import Any

from unified_planning.environment import get_environment
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
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity as UpActivity
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.timing import TimeInterval

from up_samp.model import CandidateSchedule
from up_samp.scheduling.compilers.plain import Activity, Effect, Expr, PlainProblem, Type

OPERATORS = {
    "and": Op.AND,
    "or": Op.OR,
    "not": Op.NOT,
    "implies": Op.IMPLIES,
    "iff": Op.IFF,
    "eq": Op.EQUALS,
    "le": Op.LE,
    "lt": Op.LT,
    "plus": Op.PLUS,
    "minus": Op.MINUS,
    "times": Op.TIMES,
    "div": Op.DIV,
}
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


def _short(letter: str, names: Iterable[str]) -> dict[str, str]:
    return {name: f"{letter}{i}" for i, name in enumerate(names)}


class ProblemWriter:
    """Writes ``plain`` as the UP problem ``up`` in the global environment, and reads names in its
    schedules back.
    """

    def __init__(self, plain: PlainProblem):
        self.plain = plain
        self.environment = get_environment()
        self.manager = self.environment.expression_manager
        self.up = SchedulingProblem("p", self.environment)
        self._names = {
            "activity": _short("a", (a.name for a in plain.activities)),
            "object": _short("o", plain.objects),
            "type": _short("T", plain.types),
        }
        self._memo: dict[Expr, FNode] = {}
        self._types: dict[str, Any] = {}
        self._objects: dict[str, Object] = {}
        self._fluents: dict[str, UpFluent] = {}
        self._parameters: dict[str, Parameter] = {}
        self._activities: dict[str, UpActivity] = {}
        self._write()

    def read_back(self, schedule: CandidateSchedule) -> CandidateSchedule:
        """Return a schedule of ``up`` under the names of ``plain``."""
        activities = {new: old for old, new in self._names["activity"].items()}
        objects = {new: old for old, new in self._names["object"].items()}
        parameters = {p.name: name for name, p in self._parameters.items()}
        return CandidateSchedule(
            {activities[a]: times for a, times in schedule.times.items()},
            {
                parameters[p]: objects[v] if isinstance(v, str) else v
                for p, v in schedule.parameters.items()
                if p in parameters
            },
        )

    def _write(self) -> None:
        plain, problem = self.plain, self.up
        for name in plain.types:
            problem._add_user_type(self.type(("user", name)))
        for name, user_type in plain.objects.items():
            short = self._names["object"][name]
            self._objects[name] = Object(short, self.type(("user", user_type)), self.environment)
            problem.add_object(self._objects[name])
        for i, (name, fluent) in enumerate(plain.fluents.items()):
            signature = list(starmap(self._parameter, fluent.parameters))
            new = UpFluent(f"f{i}", self.type(fluent.type), signature, environment=self.environment)
            default = None if fluent.default is None else self.expression(fluent.default)
            self._fluents[name] = problem.add_fluent(new, default_initial_value=default)
        for fluent_expression, value in plain.initial.items():
            problem.set_initial_value(self.expression(fluent_expression), self.expression(value))
        for i, (name, tpe) in enumerate(plain.variables.items()):
            self._parameters[name] = self._parameter(f"v{i}", tpe)
            problem._base._parameters[f"v{i}"] = self._parameters[name]
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

    def _chronicle(self, owner: str | None) -> Any:
        return self.up._base if owner is None else self._activities[owner]

    def _declare(self, activity: Activity) -> None:
        short = self._names["activity"][activity.name]
        new = UpActivity(short, 0, activity.optional, _env=self.environment)
        for i, (full_name, tpe) in enumerate(activity.parameters):
            parameter = self._parameter(f"{short}.p{i}", tpe)
            new._parameters[f"p{i}"] = self._parameters[full_name] = parameter
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
                self._names["type"][name], None if father is None else self.type(("user", father))
            )
        return self._types[name]

    def timing(self, time: Expr) -> Timing:
        """Return a ``time`` expression as a UP timing."""
        _, anchor, activity, delay = time
        container = None if activity is None else self._names["activity"][activity]
        return Timing(delay, Timepoint(POINTS[anchor], container=container))

    def expression(self, expression: Expr) -> FNode:
        """Return a plain expression as a UP expression."""
        done = self._memo.get(expression)
        if done is None:
            done = self._memo[expression] = self._expression(expression)
        return done

    def _expression(self, expression: Expr) -> FNode:
        operator, manager = expression[0], self.manager
        if operator in OPERATORS:
            operands = tuple(self.expression(e) for e in expression[1:])
            return manager.create_node(node_type=OPERATORS[operator], args=operands)
        if operator == "flu":
            arguments = tuple(self.expression(e) for e in expression[2:])
            return manager.FluentExp(self._fluents[expression[1]], arguments)
        if operator == "time":
            return manager.TimingExp(self.timing(expression))
        said = expression[1]
        if operator == "bool":
            return manager.TRUE() if said else manager.FALSE()
        if operator == "int":
            return manager.Int(said)
        if operator == "obj":
            return manager.ObjectExp(self._objects[said])
        if operator == "par":
            return manager.ParameterExp(self._parameters[said])
        return manager.PresentExp(Presence(self._names["activity"][said]))
