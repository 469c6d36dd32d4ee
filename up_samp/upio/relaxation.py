"""The growing relaxation of a problem, and the configurations in it that hang on decisions.

A waypoint may be a parameter of its activity, a variable, a parameter of another activity, or a
fluent. The relaxation has one decision variable of the activity's own (or of the problem) for each:
parameters and variables stand for themselves; what stands elsewhere gets a parameter that equals
it. So statements about motions need to name variables and values only, and wrapped engines meet
fluents and other activities' parameters nowhere but in one equation each.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from unified_planning.model import Effect, Fluent, FNode, Parameter, Timing
from unified_planning.model.motion import ActivityWaypoints, MotionActivity, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.timing import TimePointInterval

from up_samp.model import UnsupportedError
from up_samp.model.refinement import Literal
from up_samp.model.snapshot import Snapshot, Term, TermKind
from up_samp.upio.expressions import constraints_of, walk
from up_samp.upio.rewrite import Rewriter
from up_samp.upio.whereabouts import FluentChanges, changes_of


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
    whether it is read at the activity's end.
    """

    problem: SchedulingProblem
    snapshot: Snapshot
    rewriter: Rewriter
    state: dict[str, FNode]
    activities: dict[str, Activity] = field(default_factory=dict)
    elsewhere: dict[tuple[str, str, str], Activity] = field(default_factory=dict)
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
        owners = (self.problem._base, *self.problem.activities)
        self.variables = {p.name: p for owner in owners for p in owner.parameters}

    def variable(self, name: str) -> Parameter:
        """Return a decision variable by its full name."""
        return self.variables[name]

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
        found: dict[Fluent, list[Effect]] = {}
        for _, effect, _ in self.problem.all_effects():
            found.setdefault(effect.fluent.fluent(), []).append(effect)
        return found


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
    problem = relaxation.problem
    manager = problem.environment.expression_manager
    if term.kind is TermKind.CONSTANT:
        return manager.ObjectExp(problem.object(term.name))
    key = (activity.name, term, at_end)
    known = relaxation.choices.get(key)
    if known is None:
        if term.kind is TermKind.PARAMETER:
            known = _of_parameter(relaxation, activity, term.name)
        else:
            known = _of_fluent(relaxation, activity, term.name, at_end=at_end, state=state)
        relaxation.choices[key] = known
    if known.variable is None:
        return manager.ObjectExp(problem.object(known.values[0]))
    return manager.ParameterExp(relaxation.variable(known.variable))


def _of_parameter(relaxation: Relaxation, activity: Activity, name: str) -> ConfigurationChoice:
    problem = relaxation.problem
    parameter = relaxation.variable(name)
    values = _possible(relaxation, parameter)
    owner = next((a for a in problem.activities if parameter in a.parameters), None)
    if owner is None or owner is activity:
        return ConfigurationChoice(name, values)
    mine = _add_parameter(relaxation, activity, name, parameter.type)
    manager = problem.environment.expression_manager
    problem.add_constraint(
        manager.Equals(mine, parameter), [a.present for a in (activity, owner) if a.optional]
    )
    if owner.optional:
        # who is absent decides nothing
        problem.add_constraint(owner.present, [activity.present] if activity.optional else [])
    return ConfigurationChoice(mine.name, values)


def _of_fluent(
    relaxation: Relaxation, activity: Activity, text: str, *, at_end: bool, state: FNode | None
) -> ConfigurationChoice:
    problem = relaxation.problem
    fluent = named_fluent(relaxation, activity, text)
    ground = [f for f in relaxation.given_values if _may_be(fluent, f)]
    values = tuple(sorted({v for f in ground for v in _reachable(relaxation, f)}))
    manager = problem.environment.expression_manager
    mine: Any = manager.ObjectExp(problem.object(values[0]))
    if len(values) > 1:
        mine = _add_parameter(relaxation, activity, text, fluent.type)
    elif fluent.fluent() not in relaxation.given_effects:
        return ConfigurationChoice(None, values)
    if fluent != state:  # also one that always has the same value is kept apart from who sets it
        point = activity.end if at_end else activity.start
        activity.add_condition(TimePointInterval(Timing(0, point)), manager.Equals(fluent, mine))
    return ConfigurationChoice(mine.name if len(values) > 1 else None, values)


def _add_parameter(relaxation: Relaxation, activity: Activity, what: str, tpe: Any) -> Parameter:
    """Add a parameter named after ``what`` it stands for."""
    base = "samp_" + "_".join(re.findall(r"\w+", what))
    names = (base if n == 0 else f"{base}_{n}" for n in itertools.count())
    taken = {p.name for p in activity.parameters}
    free = next(n for n in names if f"{activity.name}.{n}" not in taken)
    mine: Parameter = activity.add_parameter(free, tpe)
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
    if fluent not in relaxation.reachable:
        relaxation.reachable[fluent] = _reached(relaxation, fluent)
    return relaxation.reachable[fluent]


def _reached(relaxation: Relaxation, fluent: FNode) -> tuple[str, ...]:
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
    return tuple(sorted(found))


def _surely_other(one: FNode, two: FNode) -> bool:
    """Return whether two expressions of one fluent differ in a constant argument."""
    return any(a != b and a.is_constant() for a, b in zip(one.args, two.args, strict=True))


def _configurations(relaxation: Relaxation, tpe: Any) -> Iterable[str]:
    known = relaxation.snapshot.configurations
    return (o.name for o in relaxation.problem.objects(tpe) if o.name in known)


def _possible(relaxation: Relaxation, parameter: Parameter) -> tuple[str, ...]:
    """Return the values that no constraint on the parameter alone forbids."""
    problem = relaxation.problem
    manager = problem.environment.expression_manager
    variable = manager.ParameterExp(parameter)

    def allowed(name: str) -> bool:
        put = {variable: manager.ObjectExp(problem.object(name))}
        return not any(
            c.substitute(put).simplify().is_false() for c in relaxation.unary.get(variable, ())
        )

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
