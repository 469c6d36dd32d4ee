"""From a UP ``SchedulingProblem`` to a :class:`PlainProblem`, and back under short names: messages
to engines' servers have a limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
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

from up_samp.model import CandidateSchedule, UnsupportedError
from up_samp.scheduling.compilers.plain import (
    TRUE,
    Activity,
    Condition,
    Effect,
    Expr,
    Fluent,
    PlainProblem,
    Type,
    conjunction,
    disjunction,
    implies,
    later,
)
from up_samp.upio.expressions import (
    QuantifierRemover,
    chronicles_of,
    constraints_of,
    effects_of,
    whole_bounds,
    with_timings,
)

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


# ------------------ From a UP problem to plain values


_LEAVES: Mapping[Op, Callable[[FNode], Expr]] = {
    Op.BOOL_CONSTANT: lambda node: ("bool", node.bool_constant_value()),
    Op.INT_CONSTANT: lambda node: ("int", node.int_constant_value()),
    Op.OBJECT_EXP: lambda node: ("obj", node.object().name),
    Op.PARAM_EXP: lambda node: ("par", node.parameter().name),
}
_OPERATORS = {kind: name for name, kind in OPERATORS.items()}
_ANCHORS = {kind: anchor for anchor, kind in POINTS.items()}
_KINDS = {kind: name for name, kind in EFFECT_KINDS.items()}


def read_plain(problem: SchedulingProblem, *, objective: bool = True) -> PlainProblem:
    """Return ``problem`` as plain values; without ``objective``, whatever is best.

    Scopes become implications, intervals closed ones over integers, presence of a mandatory
    activity becomes true, quantifiers are expanded.

    Raises:
        UnsupportedError: real numbers, or a metric other than the makespan.
    """
    return _ProblemReader(problem).read(objective)


def read_expression(problem: SchedulingProblem, node: FNode) -> Expr:
    """Return an expression of ``problem`` as a plain value."""
    return _ProblemReader(problem).expression(node)


def read_constraints(problem: SchedulingProblem) -> list[tuple[FNode, Expr]]:
    """Return the constraints of ``problem``, each as it is given and as a plain value."""
    return _ProblemReader(problem).constraints()


def read_type(tpe: Any) -> Type:
    """Return a UP type as plain values."""
    if tpe.is_bool_type():
        return ("bool",)
    if tpe.is_int_type():
        return ("int", tpe.lower_bound, tpe.upper_bound)
    if tpe.is_user_type():
        return ("user", tpe.name)
    raise UnsupportedError(f"type {tpe} in a scheduling problem")


class _ProblemReader:
    def __init__(self, problem: SchedulingProblem):
        self.problem = problem
        self.optional = {a.name for a in problem.activities if a.optional}
        self._written_out = QuantifierRemover(problem)
        self._memo: dict[int, Expr] = {}
        self.fathers: dict[str, str | None] = {
            t.name: None if t.father is None else t.father.name for t in problem.user_types
        }
        self.objects = {o.name: o.type.name for o in problem.all_objects}

    def read(self, objective: bool) -> PlainProblem:
        problem = self.problem
        constraints = [c for _, c in self.constraints()]
        conditions, effects = [], []
        for owner, chronicle in chronicles_of(problem):
            for span, expressions in chronicle.conditions.items():
                conditions += [self._condition(span, e, owner) for e in expressions]
            for timing, effect in effects_of(chronicle):
                each = self._written_out.effects(effect)
                effects += [self._effect(timing, e, owner) for e in each]
        return PlainProblem(
            activities=tuple(self._activity(a) for a in problem.activities),
            constraints=tuple(c for c in constraints if c != TRUE),
            conditions=tuple(conditions),
            effects=tuple(effects),
            variables={p.name: read_type(p.type) for p in problem.base_variables},
            types=self.fathers,
            objects=self.objects,
            fluents={f.name: self._fluent(f) for f in problem.fluents},
            initial={
                self.expression(f): self.expression(v)
                for f, v in problem.explicit_initial_values.items()
            },
            minimize_makespan=objective and self._metric(),
        )

    def constraints(self) -> list[tuple[FNode, Expr]]:
        said = constraints_of(self.problem)
        return [(node, self._scoped(node, scope)) for _, node, scope in said]

    def _metric(self) -> bool:
        for metric in self.problem.quality_metrics:
            if not isinstance(metric, MinimizeMakespan):
                raise UnsupportedError(f"metric {metric} (only the makespan is supported)")
        return bool(self.problem.quality_metrics)

    def _fluent(self, fluent: Any) -> Fluent:
        default = self.problem.fluents_defaults.get(fluent)
        return Fluent(
            read_type(fluent.type),
            tuple((p.name, read_type(p.type)) for p in fluent.signature),
            None if default is None else self.expression(default),
        )

    def _activity(self, activity: UpActivity) -> Activity:
        lasts = activity.duration
        bounds = (
            (lasts.lower, 1 if lasts.is_left_open() else 0),
            (lasts.upper, -1 if lasts.is_right_open() else 0),
        )
        lower, upper = (
            _shift(self.expression(node), step) if number is None else ("int", number)
            for number, (node, step) in zip(whole_bounds(lasts), bounds, strict=True)
        )
        if lower[0] == upper[0] == "int" and lower[1] > upper[1]:
            raise UnsupportedError(
                f"the duration of activity '{activity.name}', {activity.duration}, holds no whole "
                "number: choose a smaller unit for all times"
            )
        parameters = tuple((p.name, read_type(p.type)) for p in activity.parameters)
        return Activity(activity.name, activity.optional, lower, upper, parameters)

    def _scoped(self, constraint: FNode, scope: Any) -> Expr:
        guard = conjunction(self.expression(s) for s in scope)
        return implies(guard, self.expression(constraint))

    def _condition(self, span: Any, expression: FNode, owner: str | None) -> Condition:
        span = with_timings(span)
        low, high = self._timing(span.lower, owner), self._timing(span.upper, owner)
        if span.is_left_open():
            low = later(low, 1)
        if span.is_right_open():
            high = later(high, -1)
        said = self.expression(expression)
        return Condition(low, high, said, owner, dense=span.is_right_open())

    def _effect(self, timing: Any, effect: Any, owner: str | None) -> Effect:
        kind = _KINDS.get(effect.kind)
        if kind is None:
            raise UnsupportedError(f"effect {effect} of {owner or 'the problem'}")
        time = self._timing(timing, owner)
        fluent, value, condition = (
            self.expression(e) for e in (effect.fluent, effect.value, effect.condition)
        )
        if time[2] in self.optional - {owner}:  # it happens if there is such a time
            condition = conjunction([("pres", time[2]), condition])
        return Effect(time, kind, fluent, value, condition, owner)

    def _timing(self, timing: Timing, owner: str | None) -> Expr:
        anchor = _ANCHORS[timing.timepoint.kind]
        container = timing.timepoint.container
        if anchor in ("start", "end") and container is None:
            container = owner
        if timing.delay != int(timing.delay):
            raise UnsupportedError(f"fractional time {timing}")
        return ("time", anchor, container, int(timing.delay))

    def expression(self, node: FNode) -> Expr:
        """Return a UP expression as plain values."""
        return self._read(self._written_out(node))

    def _read(self, node: FNode) -> Expr:
        done = self._memo.get(node.node_id)
        if done is None:
            done = self._memo[node.node_id] = self._expression(node)
        return done

    def _expression(self, node: FNode) -> Expr:
        kind = node.node_type
        if kind in (Op.AND, Op.OR):
            join = conjunction if kind == Op.AND else disjunction
            return join(self._read(a) for a in node.args)
        if kind in (Op.LE, Op.LT, Op.EQUALS):
            return self._compared(_OPERATORS[kind], node)
        if kind in _OPERATORS:
            return (_OPERATORS[kind], *(self._read(a) for a in node.args))
        return self._leaf(node)

    def _compared(self, operator: str, node: FNode) -> Expr:
        """Return a comparison; fractions that are added to its sides are rounded away."""
        (left, plus), (right, minus) = (self._split(a) for a in node.args)
        short = plus - minus
        if short == 0:
            return (operator, left, right)
        if operator == "eq" and short.denominator != 1:  # never, but of absent activities
            low, high = _shift(left, math.floor(short)), _shift(left, math.ceil(short))
            return conjunction([("le", high, right), ("le", right, low)])
        return (
            operator,
            _shift(left, math.floor(short) if operator == "lt" else math.ceil(short)),
            right,
        )

    def _split(self, node: FNode) -> tuple[Expr, Fraction]:
        """Return a sum as an expression of whole numbers, and the fraction that is added to it."""
        if node.is_real_constant():
            value = Fraction(node.real_constant_value())
            return ("int", math.floor(value)), value % 1
        if node.is_timing_exp():
            timing = node.timing()
            delay = Fraction(timing.delay)
            return self._timing(Timing(math.floor(delay), timing.timepoint), None), delay % 1
        if node.is_plus() or node.is_minus():
            sides = [self._split(a) for a in node.args]
            rest = sum((f for _, f in sides[1:]), Fraction(0))
            total = sides[0][1] + (rest if node.is_plus() else -rest)
            return (_OPERATORS[node.node_type], *(e for e, _ in sides)), total
        return self._read(node), Fraction(0)

    def _leaf(self, node: FNode) -> Expr:
        if node.node_type in _LEAVES:
            return _LEAVES[node.node_type](node)
        if node.is_real_constant() and node.real_constant_value().denominator == 1:
            return ("int", int(node.real_constant_value()))
        if node.is_timing_exp():
            return self._timing(node.timing(), None)
        if node.is_present_exp():
            name = node.presence().container
            return ("pres", name) if name in self.optional else TRUE
        if node.is_fluent_exp():
            return ("flu", node.fluent().name, *(self._read(a) for a in node.args))
        raise UnsupportedError(f"expression {node}")


def _shift(expression: Expr, by: int) -> Expr:
    if by == 0:
        return expression
    if expression[0] == "int":
        return ("int", expression[1] + by)
    return ("plus", expression, ("int", by))


# ------------------ From plain values to a UP problem


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
        self._leaves: dict[str, Callable[[Any], FNode]] = {
            "bool": self.manager.Bool,
            "int": self.manager.Int,
            "obj": lambda name: self.manager.ObjectExp(self._objects[name]),
            "par": lambda name: self.manager.ParameterExp(self._parameters[name]),
            "pres": lambda name: self.manager.PresentExp(Presence(self._names["activity"][name])),
        }
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
        return self._leaves[operator](expression[1])
