"""The growing relaxation of a problem, the configurations in it that hang on decisions, and which
motions a schedule of it wants.

A waypoint may be a parameter of its activity, a variable, a parameter of another activity, or a
fluent. The relaxation has one decision variable of the activity's own (or of the problem) for each:
parameters and variables stand for themselves; what stands elsewhere gets a parameter that equals
it. So statements about motions need to name variables and values only, and wrapped engines meet
fluents and other activities' parameters nowhere but in one equation each.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import is_
from typing import Any

from unified_planning.environment import Environment
from unified_planning.model import (
    Effect,
    ExpressionManager,
    Fluent,
    FNode,
    Object,
    Parameter,
    Timing,
    Variable,
)
from unified_planning.model.motion import ActivityWaypoints, MotionActivity, SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.timing import TimePointInterval
from unified_planning.model.types import Type

from up_samp.model import (
    CandidateSchedule,
    ProblemError,
    ScheduledChange,
    ScheduledMotion,
    UnsupportedError,
)
from up_samp.model.graphs import grouped
from up_samp.model.refinement import Given, Literal
from up_samp.model.snapshot import Snapshot, Term, TermKind
from up_samp.upio.expressions import chronicles_of, constraints_of, present, walk, with_parameter
from up_samp.upio.movers import FluentChanges, changes_of


@dataclass(frozen=True)
class ConfigurationChoice:
    """The decision variable that a configuration comes from (its full name) and the names that it
    may be; ``None``: nothing changes it, and it is always the one value.
    """

    variable: str | None
    values: tuple[str, ...]


@dataclass
class Relaxation:
    """A growing plain problem. ``state[o]`` is the fluent that tells where object ``o`` is; what
    moves the object sets it ``early[o]`` units (0 or 1) before its end.

    ``choices``: what a configuration hangs on that is no constant, by its activity, its term, and
    whether it is read at the activity's end. ``elsewhere``: auxiliary activities, which witness
    that something is not at some place, and while which activity.
    """

    problem: SchedulingProblem
    snapshot: Snapshot
    rewriter: Rewriter
    state: dict[str, FNode]
    activities: dict[str, Activity] = field(default_factory=dict)
    elsewhere: dict[str, str] = field(default_factory=dict)
    choices: dict[tuple[str, Term, bool], ConfigurationChoice] = field(default_factory=dict)
    variables: dict[str, Parameter] = field(default_factory=dict)
    early: dict[str, int] = field(default_factory=dict)
    reachable: dict[FNode, tuple[str, ...]] = field(default_factory=dict)
    """What each of the problem's ground fluents may hold, as far as it was asked."""
    literals: dict[Literal, FNode] = field(default_factory=dict)
    """Parts of statements that are written already: most come many times."""
    told_fluents: dict[str, FNode] = field(default_factory=dict)
    """Fluents that motions name as configurations, by how the problem writes them."""
    places: set[Fluent] = field(default_factory=set)
    """What counts whether a place for one object is free."""

    def __post_init__(self) -> None:
        self.activities = {a.name: a for a in self.problem.activities}
        owners = chronicles_of(self.problem)
        self.variables = {p.name: p for _, owner in owners for p in owner.parameters}

    @cached_property
    def manager(self) -> ExpressionManager:
        """What makes the problem's expressions."""
        return self.problem.environment.expression_manager

    def place(self, name: str) -> FNode:
        """Return a configuration (or another object) as an expression."""
        return self.manager.ObjectExp(self.problem.object(name))

    def variable(self, name: str) -> FNode:
        """Return a decision variable, by its full name, as an expression."""
        return self.manager.ParameterExp(self.variables[name])

    def constrain(self, expression: FNode, *activities: Activity) -> None:
        """Add a constraint that binds where these activities are present."""
        self.problem.add_constraint(expression, present(*activities))

    @cached_property
    def unary(self) -> dict[FNode, list[FNode]]:
        """The problem's constraints on one parameter each (none of what was learned)."""
        return constraints_on_one(self.problem)

    @cached_property
    def given_values(self) -> dict[FNode, FNode]:
        """The initial values of the problem's own ground fluents (the problem lists them anew
        whenever it is asked).
        """
        values: dict[FNode, FNode] = self.problem.initial_values
        return values

    @cached_property
    def ground_fluents(self) -> dict[str, FNode]:
        """The problem's own ground fluents by how they are written."""
        return {str(expression): expression for expression in self.given_values}

    @cached_property
    def given_changes(self) -> tuple[FluentChanges, frozenset[Fluent]]:
        """What activities change of the problem's own fluents, and those that are set loosely."""
        return changes_of(self.problem)

    @cached_property
    def given_effects(self) -> dict[Fluent, list[Effect]]:
        """The effects on each of the problem's own fluents (states that are added have others)."""
        effects = (effect for _, effect, _ in self.problem.all_effects())
        return grouped(effects, lambda effect: effect.fluent.fluent())


def choose(
    relaxation: Relaxation,
    activity: Activity,
    term: Term,
    *,
    at_end: bool = False,
    state: FNode | None = None,
) -> FNode:
    """Return the expression for a configuration of ``activity``, and note its choice.

    ``at_end``: a fluent is read at the activity's end, not at its start (motion effects). A fluent
    that is the object's own ``state`` needs no equation: the caller's condition is one.
    """
    if term.kind is TermKind.CONSTANT:
        return relaxation.place(term.name)
    key = (activity.name, term, at_end)
    known = relaxation.choices.get(key)
    if known is None:
        if term.kind is TermKind.PARAMETER:
            known = _of_parameter(relaxation, activity, term.name)
        else:
            known = _of_fluent(relaxation, activity, term.name, at_end=at_end, state=state)
        relaxation.choices[key] = known
    if known.variable is None:
        return relaxation.place(known.values[0])
    return relaxation.variable(known.variable)


def _of_parameter(relaxation: Relaxation, activity: Activity, name: str) -> ConfigurationChoice:
    parameter = relaxation.variables[name]
    values = _possible(relaxation, parameter)
    owners = (a for a in relaxation.problem.activities if parameter in a.parameters)
    owner = next(owners, None)
    if owner is None or owner is activity:
        return ConfigurationChoice(name, values)
    mine = _add_parameter(relaxation, activity, name, parameter.type)
    relaxation.constrain(relaxation.manager.Equals(mine, parameter), activity, owner)
    if owner.optional:  # who is absent decides nothing
        relaxation.constrain(owner.present, activity)
    return ConfigurationChoice(mine.name, values)


def _of_fluent(
    relaxation: Relaxation, activity: Activity, text: str, *, at_end: bool, state: FNode | None
) -> ConfigurationChoice:
    fluent = named_fluent(relaxation, activity, text)
    ground = [f for f in relaxation.given_values if _may_be(fluent, f)]
    values = tuple(sorted({v for f in ground for v in _reachable(relaxation, f)}))
    mine: Any = relaxation.place(values[0])
    if len(values) > 1:
        mine = _add_parameter(relaxation, activity, text, fluent.type)
    elif fluent.fluent() not in relaxation.given_effects:
        return ConfigurationChoice(None, values)
    if fluent != state:  # also one that always has the same value is kept apart from who sets it
        point = activity.end if at_end else activity.start
        same = relaxation.manager.Equals(fluent, mine)
        activity.add_condition(TimePointInterval(Timing(0, point)), same)
    return ConfigurationChoice(mine.name if len(values) > 1 else None, values)


def _add_parameter(relaxation: Relaxation, activity: Activity, what: str, tpe: Any) -> Parameter:
    """Add a parameter named after ``what`` it stands for."""
    base = "samp_" + "_".join(re.findall(r"\w+", what))
    names = (base if n == 0 else f"{base}_{n}" for n in itertools.count())
    taken = {p.name for p in activity.parameters}
    free = next(n for n in names if f"{activity.name}.{n}" not in taken)
    mine = with_parameter(activity, free, tpe)
    relaxation.variables[mine.name] = mine
    return mine


def named_fluent(relaxation: Relaxation, activity: Activity, text: str) -> FNode:
    """Return a waypoint's fluent over plain things."""
    if text in relaxation.ground_fluents:
        return relaxation.ground_fluents[text]
    fluent = relaxation.told_fluents[text]
    for argument in fluent.args:
        decided = argument.is_parameter_exp()
        owner = argument.parameter().name.rpartition(".")[0] if decided else ""
        if not (argument.is_constant() or (decided and owner in ("", activity.name))):
            raise UnsupportedError(
                f"activity '{activity.name}': the arguments of the waypoint '{text}' must be "
                f"constants, variables or parameters of '{activity.name}', not '{argument}'"
            )
    return fluent


def _may_be(fluent: FNode, ground: FNode) -> bool:
    """Return whether a fluent, with arguments that are decided, may stand for a ground one."""
    return fluent.fluent() == ground.fluent() and not _surely_other(fluent, ground)


def told_fluents(problem: SchedulingMotionProblem) -> Iterator[FNode]:
    """Yield the fluents that the motions of a problem name as configurations."""
    for activity in problem.activities:
        if not isinstance(activity, MotionActivity):
            continue
        places = [value for _, value in activity.motion_effects.items()]
        for constraint in activity.motion_constraints:
            if isinstance(constraint, ActivityWaypoints):
                places += [constraint.starting, *constraint.waypoints]
        yield from (place for place in places if place.is_fluent_exp())


def _reachable(relaxation: Relaxation, fluent: FNode) -> tuple[str, ...]:
    """Return what a ground fluent may hold: its initial value and what effects may assign."""
    if fluent in relaxation.reachable:
        return relaxation.reachable[fluent]
    found = {relaxation.given_values[fluent].object().name}
    for effect in relaxation.given_effects.get(fluent.fluent(), ()):
        if _surely_other(effect.fluent, fluent):
            continue
        if effect.value.is_object_exp():
            found.add(effect.value.object().name)
        elif effect.value.is_parameter_exp():
            found |= set(_possible(relaxation, effect.value.parameter()))
        else:
            found |= set(_configurations(relaxation, fluent.type))
    return relaxation.reachable.setdefault(fluent, tuple(sorted(found)))


def _surely_other(one: FNode, two: FNode) -> bool:
    """Return whether two expressions of one fluent differ in a constant argument."""
    return any(a != b and a.is_constant() for a, b in zip(one.args, two.args, strict=True))


def _configurations(relaxation: Relaxation, tpe: Any) -> Iterable[str]:
    known = relaxation.snapshot.configurations
    return (o.name for o in relaxation.problem.objects(tpe) if o.name in known)


def _possible(relaxation: Relaxation, parameter: Parameter) -> tuple[str, ...]:
    """Return the values that no constraint on the parameter alone forbids."""
    variable = relaxation.variable(parameter.name)
    asked = relaxation.unary.get(variable, ())

    def allowed(name: str) -> bool:
        put = {variable: relaxation.place(name)}
        return not any(c.substitute(put).simplify().is_false() for c in asked)

    return tuple(n for n in _configurations(relaxation, parameter.type) if allowed(n))


def constraints_on_one(problem: SchedulingProblem) -> dict[FNode, list[FNode]]:
    """Return the constraints that speak of one parameter and nothing else, by that parameter.

    They bind whenever the parameter counts: unscoped, or under its own activity's presence.
    """
    found: dict[FNode, list[FNode]] = {}
    for _, constraint, scope in constraints_of(problem):
        leaves = {e for e in walk(constraint) if e.is_fluent_exp() or not e.args}
        free = [e for e in leaves if not e.is_constant()]
        if len(free) != 1 or not free[0].is_parameter_exp():
            continue
        activity = free[0].parameter().name.rpartition(".")[0]
        if all(s.is_present_exp() and s.presence().container == activity for s in scope):
            found.setdefault(free[0], []).append(constraint)
    return found


# ------------------ Which motions a candidate schedule wants, from where to where, and when


@dataclass(frozen=True)
class Itinerary:
    """What a schedule asks of the objects: ``motions`` and ``changes`` in order of time."""

    schedule: CandidateSchedule
    motions: tuple[ScheduledMotion, ...]
    changes: tuple[ScheduledChange, ...]

    @property
    def given(self) -> Given:
        """The decisions that all configurations come from."""
        parts = [*(m.given for m in self.motions), *(c.given for c in self.changes)]
        return tuple(sorted({pair for given in parts for pair in given}))

    def places(self, snapshot: Snapshot, name: str) -> list[tuple[float, str]]:
        """Return ``(since, configuration)`` of object ``name`` over time, in units.

        A move counts from its end on, where it leads.
        """
        events = [(m.end, to) for m in self.motions for who, to in m.brings if who == name]
        events += [(c.time, c.configuration) for c in self.changes if c.object == name]
        return [(-math.inf, snapshot.initial[name]), *sorted(events)]

    def periods(self, snapshot: Snapshot, name: str) -> list[tuple[float, float, str]]:
        """Return ``(since, until, configuration)`` of object ``name`` over time, in units."""
        places = self.places(snapshot, name)
        ends = [since for since, _ in places[1:]]
        return [(a, b, place) for (a, place), b in zip(places, [*ends, math.inf], strict=True)]

    def place_at(self, snapshot: Snapshot, name: str, time: int) -> str:
        """Return the configuration that object ``name`` has, or is leaving, at ``time`` (units)."""
        return [place for since, place in self.places(snapshot, name) if since <= time][-1]


def read_itinerary(relaxation: Relaxation, schedule: CandidateSchedule) -> Itinerary:
    """Resolve every present motion and change of ``schedule`` to configurations and poses."""
    snapshot = relaxation.snapshot
    motions = []
    for task in snapshot.tasks:
        if task.activity not in schedule.times:
            continue
        start, end = schedule.times[task.activity]
        names, given = _resolve(relaxation, schedule, task.activity, task.terms)
        goals = [ride.goal for ride in task.rides]
        put, _ = _resolve(relaxation, schedule, task.activity, goals)
        motions.append(
            ScheduledMotion(
                activity=task.activity,
                constraint=task.index,
                object=task.object,
                configurations=names,
                poses=tuple(snapshot.configurations[n] for n in names),
                start=start,
                end=end,
                avoid=task.avoid,
                given=given,
                loads=tuple((r.load, p) for r, p in zip(task.rides, put, strict=True)),
            )
        )
    changes = []
    for change in snapshot.changes:
        if change.activity in schedule.times:
            _, end = schedule.times[change.activity]
            terms = (change.term,)
            (name,), given = _resolve(relaxation, schedule, change.activity, terms, at_end=True)
            pose = snapshot.configurations[name]
            changes.append(ScheduledChange(change.activity, change.object, name, pose, end, given))
    motions.sort(key=lambda m: (m.start, m.end, m.activity))
    changes.sort(key=lambda c: (c.time, c.activity))
    return Itinerary(schedule, tuple(motions), tuple(changes))


def _resolve(
    relaxation: Relaxation,
    schedule: CandidateSchedule,
    activity: str,
    terms: Sequence[Term],
    *,
    at_end: bool = False,
) -> tuple[tuple[str, ...], Given]:
    """Return the terms' configurations, and the decisions that they come from."""
    names, given = [], {}
    for term in terms:
        if term.kind is TermKind.CONSTANT:
            names.append(term.name)
            continue
        choice = relaxation.choices[activity, term, at_end]
        if choice.variable is None:
            names.append(choice.values[0])
            continue
        value = schedule.parameters.get(choice.variable)
        if not isinstance(value, str):
            raise ProblemError(f"activity '{activity}': no value for '{term.name}'")
        names.append(value)
        given[choice.variable] = value
    return tuple(names), tuple(sorted(given.items()))


# ------------------ Motion types, objects, fluents and parameters exchanged for plain ones
# Wrapped engines (and UP's protobuf) know no movable and configuration types, so the relaxation
# uses a plain user type for each, with objects of the same names.


class Rewriter:
    """Maps everything of a SAMP problem to its plain counterpart (memoised).

    ``above``: a plain type that all configuration types are below (for objects that take
    configurations of several types).
    """

    def __init__(self, environment: Environment, above: Type | None = None):
        self.environment = environment
        self.above = above
        self._types: dict[Type, Type] = {}
        self._names: set[str] = set()
        self._objects: dict[Object, Object] = {}
        self._fluents: dict[Fluent, Fluent] = {}
        self._met: dict[Fluent, None] = {}
        self._parameters: dict[Parameter, Parameter] = {}
        self._expressions: dict[int, FNode] = {}
        """By the number of a node, which is its own in the environment."""

    def type(self, tpe: Type) -> Type:
        """Return the plain type for ``tpe`` (itself where it is plain already)."""
        if not tpe.is_user_type():
            return tpe
        if tpe not in self._types:
            father = getattr(tpe, "father", None)
            plain_father = None if father is None else self.type(father)
            if tpe.is_configuration_type():
                plain_father = self.above
            name = tpe.name
            while name in self._names:  # UP takes a configuration type and a user type of one name
                name += "_"
            self._names.add(name)
            self._types[tpe] = self.environment.type_manager.UserType(name, plain_father)
        return self._types[tpe]

    def object(self, obj: Object) -> Object:
        """Return the plain object of the same name."""
        if obj not in self._objects:
            self._objects[obj] = Object(obj.name, self.type(obj.type), self.environment)
        return self._objects[obj]

    @property
    def fluents(self) -> list[Fluent]:
        """All fluents that expressions name, as they are in the SAMP problem."""
        return list(self._met)

    def fluent(self, fluent: Fluent) -> Fluent:
        """Return the plain fluent of the same name and signature."""
        if fluent not in self._fluents:
            signature = [
                Parameter(p.name, self.type(p.type), self.environment) for p in fluent.signature
            ]
            self._fluents[fluent] = Fluent(
                fluent.name, self.type(fluent.type), signature, environment=self.environment
            )
        return self._fluents[fluent]

    def parameter(self, parameter: Parameter) -> Parameter:
        """Return the plain parameter of the same (scoped) name."""
        if parameter not in self._parameters:
            self._parameters[parameter] = Parameter(
                parameter.name, self.type(parameter.type), self.environment
            )
        return self._parameters[parameter]

    def variable(self, variable: Variable) -> Variable:
        """Return the plain variable (of a quantifier) of the same name."""
        return Variable(variable.name, self.type(variable.type), self.environment)

    def __call__(self, expression: FNode) -> FNode:
        """Return ``expression`` over plain things."""
        done = self._expressions.get(expression.node_id)
        if done is None:
            done = self._expressions[expression.node_id] = self._rewrite(expression)
        return done

    def _rewrite(self, expression: FNode) -> FNode:
        manager, kind = self.environment.expression_manager, expression.node_type
        if kind is Op.OBJECT_EXP:
            return manager.ObjectExp(self.object(expression.object()))
        if kind is Op.PARAM_EXP:
            return manager.ParameterExp(self.parameter(expression.parameter()))
        if kind is Op.VARIABLE_EXP:
            return manager.VariableExp(self.variable(expression.variable()))
        arguments = expression.args
        known = self._expressions
        # preconditions without fluents are millions of nodes: most arguments were seen before
        plain = tuple([known.get(a.node_id) or self(a) for a in arguments])
        if kind is Op.FLUENT_EXP:
            self._met[expression.fluent()] = None
            return manager.FluentExp(self.fluent(expression.fluent()), plain)
        payload: Any = expression._content.payload
        if kind in (Op.EXISTS, Op.FORALL):
            payload = tuple(map(self.variable, expression.variables()))
        elif all(map(is_, plain, arguments)):
            return expression
        return manager.create_node(node_type=kind, args=plain, payload=payload)

    def effect(self, effect: Effect) -> Effect:
        """Return a plain effect."""
        return Effect(
            self(effect.fluent),
            self(effect.value),
            self(effect.condition),
            kind=effect.kind,
            forall=tuple(map(self.variable, effect.forall)),
        )
