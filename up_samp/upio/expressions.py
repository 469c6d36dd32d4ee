"""What UP expressions speak of, and intervals of conditions, as several rooms ask it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from typing import Any
from weakref import WeakKeyDictionary

from unified_planning.environment import Environment
from unified_planning.model import (
    Effect,
    Fluent,
    FNode,
    Object,
    Parameter,
    Timepoint,
    Timing,
    Type,
)
from unified_planning.model.mixins.timed_conds_effs import TimedCondsEffs
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.timing import (
    ClosedTimeInterval,
    DurationInterval,
    LeftOpenTimeInterval,
    OpenTimeInterval,
    RightOpenTimeInterval,
    TimeInterval,
    TimePointInterval,
    TimepointKind,
)
from unified_planning.model.walkers import ExpressionQuantifiersRemover

from up_samp.model import ProblemError, UnsupportedError

_PLAIN: WeakKeyDictionary[Environment, set[int]] = WeakKeyDictionary()
"""Numbers of expressions that have no quantifier in them; environments keep all of theirs."""


def walk(node: FNode) -> Iterator[FNode]:
    """Yield ``node`` and everything below it, in order of appearance."""
    stack = [node]
    while stack:
        item = stack.pop()
        yield item
        stack += item.args[::-1]


def conjuncts(node: FNode) -> list[FNode]:
    """Return the parts of a conjunction (the node itself if it is none)."""
    if node.node_type is Op.AND:
        return [part for arg in node.args for part in conjuncts(arg)]
    return [node]


def chronicles_of(problem: SchedulingProblem) -> Iterator[tuple[str | None, Any]]:
    """Yield all that says something of a problem, by name: itself (None), and its activities."""
    yield None, problem._base
    yield from ((activity.name, activity) for activity in problem.activities)


def effects_of(chronicle: TimedCondsEffs) -> Iterator[tuple[Timing, Effect]]:
    """Yield the effects of an activity, or of the problem itself, with their times."""
    for timing, effects in chronicle.effects.items():
        yield from ((timing, effect) for effect in effects)


def constraints_of(
    problem: SchedulingProblem,
) -> Iterator[tuple[str | None, FNode, list[FNode]]]:
    """Yield all constraints of a problem with their scopes, each after the activity that has it
    (None: the problem itself).
    """
    for name, owner in chronicles_of(problem):
        yield from ((name, constraint, scope) for constraint, scope in owner.scoped_constraints)


def statements(
    constraint: FNode, scope: Iterable[FNode]
) -> Iterator[tuple[FNode, frozenset[str | None]]]:
    """Yield what a constraint says part by part, each with the activities that have to be present
    for it (None: it hangs on something else, too), however it is written: as a conjunction, as an
    implication of presences, or with a scope.
    """
    needed = frozenset(map(present_told, scope))
    for node in conjuncts(constraint):
        if node.node_type is Op.IMPLIES:
            yield from _under(node.args[1], conjuncts(node.args[0]), needed)
        elif node.node_type is Op.OR and (told := _consequence(node)):
            yield from _under(*told, needed)
        else:
            yield node, needed


def _under(
    node: FNode, conditions: Iterable[FNode], needed: frozenset[str | None]
) -> Iterator[tuple[FNode, frozenset[str | None]]]:
    for part, more in statements(node, conditions):
        yield part, needed | more


def _consequence(node: FNode) -> tuple[FNode, list[FNode]] | None:
    """Return the one part of a disjunction that is no absence, and what is absent in the others."""
    absent = [a.args[0] for a in node.args if a.node_type is Op.NOT and present_told(a.args[0])]
    told = [a for a in node.args if not (a.node_type is Op.NOT and present_told(a.args[0]))]
    return (told[0], absent) if len(told) == 1 else None


def present_told(node: FNode) -> str | None:
    """Return the activity whose presence ``node`` is."""
    return str(node.presence().container) if node.node_type is Op.PRESENT_EXP else None


def present(*activities: Activity) -> list[FNode]:
    """Return what must hold for all ``activities`` to be there."""
    return [a.present for a in activities if a.optional]


def fluent_told(node: FNode) -> tuple[FNode, FNode] | None:
    """Return (fluent, value) if ``node`` says that a fluent equals something."""
    if node.node_type is not Op.EQUALS:
        return None
    left, right = node.args
    if right.node_type is Op.FLUENT_EXP:
        left, right = right, left
    return (left, right) if left.node_type is Op.FLUENT_EXP else None


def activity_named(node: FNode) -> str | None:
    """Return the activity whose start, end, presence or parameter ``node`` itself is."""
    if node.node_type is Op.TIMING_EXP:
        name = node.timing().timepoint.container
    elif node.node_type is Op.PRESENT_EXP:
        name = node.presence().container
    elif node.node_type is Op.PARAM_EXP:
        name = node.parameter().name.rpartition(".")[0]
    else:
        return None
    return str(name) if name else None


def activities_in(node: FNode) -> set[str]:
    """Return the activities that an expression speaks of."""
    return {name for item in walk(node) if (name := activity_named(item)) is not None}


def end_before_start(node: FNode) -> tuple[str, str, int] | None:
    """Return (a, b, units) if ``node`` says ``a.end + units <= b.start``, and nothing else."""
    return _before_start(node, TimepointKind.END)


def start_before_start(node: FNode) -> tuple[str, str, int] | None:
    """Return (a, b, units) if ``node`` says ``a.start + units <= b.start``, and nothing else."""
    return _before_start(node, TimepointKind.START)


def _before_start(node: FNode, kind: TimepointKind) -> tuple[str, str, int] | None:
    if node.node_type not in (Op.LE, Op.LT):
        return None
    left, right = node.args
    if not left.node_type is right.node_type is Op.TIMING_EXP:
        return None
    first, then = left.timing().timepoint, right.timing().timepoint
    if first.kind is not kind or then.kind is not TimepointKind.START:
        return None
    units = left.timing().delay - right.timing().delay + (node.node_type is Op.LT)
    if first.container is None or then.container is None or not isinstance(units, int):
        return None
    return first.container, then.container, units


class QuantifierRemover:
    """Writes out what a problem says of all objects, or of some.

    :raises UnsupportedError: when asked for what is said of all or some numbers.
    """

    def __init__(self, problem: SchedulingProblem) -> None:
        self._problem = problem
        self._plain = _PLAIN.setdefault(problem.environment, set())

    def __call__(self, expression: FNode) -> FNode:
        """Return an expression without quantifiers."""
        if expression.node_id in self._plain or not self._quantified(expression):
            return expression
        remover = ExpressionQuantifiersRemover(self._problem.environment)
        return remover.remove_quantifiers(expression, self._problem)

    def effects(self, effect: Effect) -> Iterator[Effect]:
        """Yield an effect for each choice of objects for the variables it is "for all" of."""
        if not all(v.type.is_user_type() for v in effect.forall):
            raise UnsupportedError(f"effects are for all objects only, not as '{effect}' is")
        for each in effect.expand_effect(self._problem):
            value, condition = map(self, (each.value, each.condition))
            if value is each.value and condition is each.condition:
                yield each
            else:
                yield Effect(each.fluent, value, condition, each.kind, each.forall)

    def _quantified(self, expression: FNode) -> bool:
        plain, stack = self._plain, [expression]
        met = []
        for node in stack:  # it grows on the way
            number = node.node_id
            if number in plain:
                continue
            if node.node_type in (Op.EXISTS, Op.FORALL):
                if not all(v.type.is_user_type() for v in node.variables()):
                    raise UnsupportedError(f"up_samp quantifies over objects only, not in '{node}'")
                return True
            met.append(number)
            stack += node.args
        plain.update(met)
        return False


# ------------------ Intervals: those that conditions of the relaxation are about, and those of UP
# scripts, whose ends may be bare timepoints


def at_start(activity: Activity) -> TimePointInterval:
    """Return the instant at which an activity starts."""
    return TimePointInterval(Timing(0, activity.start))


def whole(activity: Activity, early: int = 0) -> TimeInterval:
    """Return when a state that is set ``early`` units before the ends of activities has to hold
    all through one of them, which may begin at the instant at which another one ends: an effect
    is seen from the next instant on.

    The ends are wrapped in timings: bare timepoints crash UP's ``problem.kind``.
    """
    if early:
        return ClosedTimeInterval(Timing(0, activity.start), Timing(-early, activity.end))
    return LeftOpenTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def told_by(activity: str, obstacle: Object, value: Any) -> FNode:
    """Return the expression that tells where an obstacle is: what the problem gives, and a fluent
    of one parameter that is the obstacle, of that obstacle.

    :raises ProblemError: for a fluent of other parameters.
    """
    if not isinstance(value, Fluent):
        return obstacle.environment.expression_manager.auto_promote(value)[0]
    types = [p.type for p in value.signature]
    if not types:
        return value()
    if len(types) == 1 and types[0].is_compatible(obstacle.type):
        return value(obstacle)
    raise ProblemError(
        f"activity '{activity}': the fluent '{value.name}' of its obstacle '{obstacle.name}' has "
        f"{len(types)} parameters; say which, as in {value.name}(...)"
    )


def with_parameter(activity: Activity, name: str, tpe: Type) -> Parameter:
    """Add a parameter to an activity of any environment (UP's own way to do so knows the global one
    only), and return it.
    """
    found = Parameter(f"{activity.name}.{name}", tpe, activity._environment)
    activity._parameters[name] = found
    return found


def rewritten(lasts: DurationInterval, rewrite: Callable[[FNode], FNode]) -> DurationInterval:
    """Return the bounds of a duration with each expression rewritten."""
    bounds = map(rewrite, (lasts.lower, lasts.upper))
    return DurationInterval(*bounds, lasts.is_left_open(), lasts.is_right_open())


def whole_bounds(lasts: DurationInterval) -> tuple[int | None, int | None]:
    """Return the least and the greatest whole duration (``None``: that bound is no constant)."""
    least = most = None
    if lasts.lower.is_constant():
        value = Fraction(lasts.lower.constant_value())
        least = math.floor(value) + 1 if lasts.is_left_open() else math.ceil(value)
    if lasts.upper.is_constant():
        value = Fraction(lasts.upper.constant_value())
        most = math.ceil(value) - 1 if lasts.is_right_open() else math.floor(value)
    return least, most


def closed(activity: Activity) -> TimeInterval:
    """Return [start, end] of an activity: it begins after others that set what it needs."""
    return ClosedTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def nothing_but_an_instant(activity: Activity) -> TimeInterval:
    """Return the instant at which an activity of no length happens; nothing for any other one."""
    return ClosedTimeInterval(Timing(0, activity.end), Timing(0, activity.start))


def inner(activity: Activity, early: int = 0) -> TimeInterval:
    """Return when the effects of what ends within (start, end) happen: nothing, for an activity
    that lasts one unit.
    """
    if early:
        return RightOpenTimeInterval(Timing(0, activity.start), Timing(-early, activity.end))
    return OpenTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def with_timings(span: TimeInterval) -> TimeInterval:
    """Return the interval with timings as its ends.

    ``ClosedTimeInterval(a.start, a.end)`` holds bare timepoints, which have no ``delay``: UP takes
    it, and its ``problem.kind`` crashes on it.
    """
    lower, upper = _timing(span.lower), _timing(span.upper)
    if lower is span.lower and upper is span.upper:
        return span
    return TimeInterval(lower, upper, span.is_left_open(), span.is_right_open())


def conditions_of(chronicle: TimedCondsEffs) -> dict[TimeInterval, list[FNode]]:
    """Return the conditions of an activity or of the problem itself by their intervals, each of
    which is there once, however it was written.
    """
    found: dict[TimeInterval, list[FNode]] = {}
    for span, conditions in chronicle.conditions.items():
        same = found.setdefault(with_timings(span), [])
        same += [c for c in conditions if c not in same]
    return found


def own_end(timing: Timing | Timepoint, activity: Activity) -> tuple[bool, object] | None:
    """Return whether a timing counts from an activity's end (else from its start), and the delay;
    None for a timing of the whole plan or of another activity.
    """
    told = _timing(timing)
    if told.is_global() or told.timepoint.container not in (None, activity.name):
        return None
    return told.is_from_end(), told.delay


def asks_at_start(span: TimeInterval, activity: Activity, least: int) -> bool:
    """Return whether a condition over an interval always asks for something right when an activity
    starts, at that instant or at the next one.

    :param least: units that the activity lasts at least.
    """
    upper = own_end(span.upper, activity)
    if own_end(span.lower, activity) != (False, 0) or upper is None:
        return False
    from_end, delay = upper
    length = delay + (least if from_end else 0) if isinstance(delay, int) else -1
    return length >= span.is_left_open() + span.is_right_open()


def _timing(end: Any) -> Timing:
    return Timing(0, end) if isinstance(end, Timepoint) else end


def has_bare_ends(problem: Any) -> bool:
    """Return whether some interval of a scheduling problem ends at a bare timepoint: then UP cannot
    compute the problem's kind.
    """
    spans = (span for _, chronicle in chronicles_of(problem) for span in chronicle.conditions)
    return any(with_timings(span) is not span for span in spans)
