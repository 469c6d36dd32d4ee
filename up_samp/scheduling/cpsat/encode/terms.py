"""From UP expressions to linear expressions and forms (see :mod:`.forms`), and from durations,
constants and fractions to whole numbers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from unified_planning.model import FNode, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import DurationInterval, TimepointKind
from unified_planning.model.types import Type

from up_samp.model import ProblemError, UnsupportedError
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Form,
    Lin,
    Literal,
    ModelStore,
    compare,
    conjunction,
    constant,
    disjunction,
    indicator_sum,
    join,
)
from up_samp.upio.expressions import walk, whole_bounds


def fluents_in(node: FNode) -> dict[FNode, None]:
    """Return the fluent expressions in ``node``, in order of appearance."""
    return dict.fromkeys(n for n in walk(node) if n.node_type is Op.FLUENT_EXP)


def has_decisions(node: FNode) -> bool:
    """Return whether decision variables, times or presences occur."""
    kinds = (Op.PARAM_EXP, Op.TIMING_EXP, Op.PRESENT_EXP)
    return any(n.node_type in kinds for n in walk(node))


def unless_decided(node: FNode) -> tuple[FNode | None, FNode]:
    """Return a disjunction as (what parameters alone decide, what it says of fluents otherwise);
    (``None``, ``node``) if it is not of that kind.
    """
    manager = node.environment.expression_manager
    if node.node_type is Op.IMPLIES:
        node = manager.Or(manager.Not(node.arg(0)), node.arg(1))
    if node.node_type is not Op.OR:
        return None, node
    kinds = (Op.TIMING_EXP, Op.PRESENT_EXP)
    decided = [a for a in node.args if not fluents_in(a)]
    rest = [a for a in node.args if fluents_in(a)]
    if not decided or not rest or any(n.node_type in kinds for a in decided for n in walk(a)):
        return None, node
    return manager.Or(decided), manager.Or(rest)


Reader = Callable[[FNode], Lin]
"""Gives the value of a fluent expression where one is read (its object's code, 0/1, or number)."""


@dataclass
class ActivityVars:
    """An activity in the model. ``start`` and ``end`` need its presence (see ``Lin.needs``)."""

    name: str
    index: int
    present: Literal
    start: Lin
    end: Lin
    least: int
    most: int | None
    size: Lin


@dataclass
class World:
    """The names that expressions refer to."""

    store: ModelStore
    activities: dict[str, ActivityVars] = field(default_factory=dict)
    parameters: dict[str, Lin] = field(default_factory=dict)
    domains: dict[int, frozenset[int]] = field(default_factory=dict)
    """Parameter (variable) -> values that are left by the constraints on it alone, if any are."""
    objects: dict[str, int] = field(default_factory=dict)
    object_types: list[Any] = field(default_factory=list)
    makespan: int = -1
    makespan_used: bool = False
    timings: dict[FNode, Lin] = field(default_factory=dict)
    scales: dict[str, int] = field(default_factory=dict)
    """Fluent of a real type -> what its values are multiplied by, to be whole numbers."""
    equalities: dict[tuple[int, bool], Form] = field(default_factory=dict)
    """Of parameters and objects: (number of the node, whether it holds) -> what that says."""

    def values_of(self, tpe: Type) -> list[int]:
        """Return the codes of all values of a bool, user or bounded int type."""
        if tpe.is_bool_type():
            return [0, 1]
        if tpe.is_user_type():
            return [i for i, t in enumerate(self.object_types) if tpe.is_compatible(t)]
        low, high = int_bounds(tpe)
        return list(range(low, high + 1))


def int_bounds(tpe: Type) -> tuple[int, int]:
    """Return the bounds of an integer type."""
    if not tpe.is_int_type():
        raise UnsupportedError(f"values of type '{tpe}' are not supported by cpsat (integers are)")
    low = -MAGNITUDE if tpe.lower_bound is None else int(tpe.lower_bound)
    high = MAGNITUDE if tpe.upper_bound is None else int(tpe.upper_bound)
    return countable(low), countable(high)


def number_bounds(tpe: Type, scale: int) -> tuple[int, int]:
    """Return the bounds of a numeric type, whose values are multiplied by ``scale``."""
    if not tpe.is_real_type():
        return int_bounds(tpe)
    low, high = -MAGNITUDE, MAGNITUDE
    if tpe.lower_bound is not None:
        low = math.ceil(tpe.lower_bound * scale)
    if tpe.upper_bound is not None:
        high = math.floor(tpe.upper_bound * scale)
    return countable(low), countable(high)


def countable(value: int) -> int:
    """Return ``value``, if sums of such numbers can be counted with.

    :raises UnsupportedError: if they cannot.
    """
    if abs(value) > LARGEST:
        raise UnsupportedError(f"cpsat counts to {LARGEST}, not to {value}")
    return value


class Terms:
    """Compiles expressions. ``read`` tells what a fluent is worth (a time is implied); ``compare``
    says what a comparison is where something that it needs is absent.
    """

    def __init__(
        self,
        world: World,
        read: Reader,
        owner: ActivityVars | None = None,
        compare: Callable[[Lin, str], Form] = compare,
    ) -> None:
        self.world = world
        self.read = read
        self.owner = owner
        self.compare = compare

    # -- numbers, objects and times ----------------------------------------------------------
    def linear(self, node: FNode) -> Lin:
        """Return ``node`` (a number, time, object or Boolean) as an integer expression."""
        return self.at_scale(node, 1)

    def scaled(self, node: FNode) -> tuple[Lin, int]:
        """Return (expression, d) with node = expression / d."""
        kind = node.node_type
        if kind in (Op.PLUS, Op.MINUS):
            return self._sum(node)
        if kind is Op.TIMES:
            return self._product(node)
        if kind is Op.DIV:
            top, scale = self.scaled(node.arg(0))
            by, other = self.scaled(node.arg(1))
            if by.terms or by.const == 0:
                raise UnsupportedError(f"cpsat divides by non-zero constants only, not '{node}'")
            return times(top, other if by.const > 0 else -other), scale * abs(by.const)
        if kind is Op.REAL_CONSTANT:
            value = Fraction(node.constant_value())
            return constant(value.numerator), value.denominator
        if kind is Op.FLUENT_EXP:
            return self.read(node), self.world.scales.get(node.fluent().name, 1)
        if kind is Op.TIMING_EXP:
            known = self.world.timings.get(node)
            return (known, 1) if known is not None else self._rational_time(node)
        return self._atom(node), 1

    def at_scale(self, node: FNode, scale: int) -> Lin:
        """Return ``scale`` times ``node`` as an integer expression."""
        total, own = self.scaled(node)
        if scale % own:
            raise UnsupportedError(f"the fraction in '{node}' is not supported here by cpsat")
        return times(total, scale // own)

    def _sum(self, node: FNode) -> tuple[Lin, int]:
        parts = [self.scaled(a) for a in node.args]
        scale = math.lcm(*(d for _, d in parts))
        total = times(parts[0][0], scale // parts[0][1])
        sign = -1 if node.node_type is Op.MINUS else 1
        for part, d in parts[1:]:
            total = total.plus(part, sign * scale // d)
        return total, scale

    def _product(self, node: FNode) -> tuple[Lin, int]:
        total, scale = self.scaled(node.arg(0))
        for arg in node.args[1:]:
            other, d = self.scaled(arg)
            if other.terms and total.terms:
                total = self._multiply(total, other)
            elif other.terms:
                total = times(other, total.const)._replace(needs=join(total.needs, other.needs))
            else:
                total = times(total, other.const)
            scale *= d
        return total, scale

    def _multiply(self, a: Lin, b: Lin) -> Lin:
        store = self.world.store
        (al, ah), (bl, bh) = store.range(a), store.range(b)
        corners = [*map(math.prod, itertools.product((al, ah), (bl, bh)))]
        product = store.integer(min(corners), max(corners))
        store.model.add_multiplication_equality(
            store.var(product), [store.affine(a), store.affine(b)]
        )
        return Lin(((product, 1),), 0, join(a.needs, b.needs))

    def _rational_time(self, node: FNode) -> tuple[Lin, int]:
        timing = node.timing()
        delay = Fraction(timing.delay)
        countable(math.ceil(delay))
        point = self.timepoint(timing)
        time = times(point, delay.denominator).shift(delay.numerator)
        if delay.denominator == 1 and timing.timepoint.container is not None:
            self.world.timings[node] = time
        return time, delay.denominator

    def time(self, timing: Timing) -> Lin:
        """Return a timing as an expression; its delay must be an integer."""
        delay = Fraction(timing.delay)
        if delay.denominator != 1:
            raise UnsupportedError(f"cpsat plans in integer time; the delay of '{timing}' is none")
        return self.timepoint(timing).shift(countable(int(delay)))

    def timepoint(self, timing: Timing) -> Lin:
        """Return the timepoint of ``timing``, without its delay."""
        point = timing.timepoint
        if point.kind is TimepointKind.GLOBAL_START:
            return constant(0)
        if point.kind is TimepointKind.GLOBAL_END:
            self.world.makespan_used = True
            return Lin(((self.world.makespan, 1),))
        owner = self.owner
        if point.container is not None:
            owner = self.world.activities.get(point.container)
        if owner is None:
            raise ProblemError(f"'{timing}' refers to no activity of the problem")
        return owner.start if point.kind is TimepointKind.START else owner.end

    def _atom(self, node: FNode) -> Lin:
        kind = node.node_type
        if kind in (Op.INT_CONSTANT, Op.BOOL_CONSTANT):
            return constant(countable(int(node.constant_value())))
        if kind is Op.OBJECT_EXP:
            return constant(self.world.objects[node.object().name])
        if kind is Op.PARAM_EXP:
            name = node.parameter().name
            if name not in self.world.parameters:
                raise ProblemError(f"'{name}' is no parameter or variable of the problem")
            return self.world.parameters[name]
        if kind is Op.FLUENT_EXP:
            return self.read(node)
        if node.type.is_bool_type():
            positive, negative = self.form(node), self.form(node, False)
            return indicator_sum([(self.world.store.equivalent(positive, negative), 1)])
        raise UnsupportedError(f"'{node}' ({kind.name}) is not supported by cpsat")

    # -- truth ---------------------------------------------------------------------------------
    def form(self, node: FNode, positive: bool = True) -> Form:
        """Return the form of a Boolean expression (of its negation if not ``positive``)."""
        kind = node.node_type
        if kind is Op.NOT:
            return self.form(node.arg(0), not positive)
        if kind in (Op.AND, Op.OR):
            parts = [self.form(a, positive) for a in node.args]
            return conjunction(parts) if (kind is Op.AND) == positive else disjunction(parts)
        if kind is Op.IMPLIES:
            parts = [self.form(node.arg(0), not positive), self.form(node.arg(1), positive)]
            return disjunction(parts) if positive else conjunction(parts)
        if kind is Op.IFF:
            return self._iff(node.arg(0), node.arg(1), positive)
        if kind in (Op.LE, Op.LT):
            return self._inequality(node, positive)
        if kind is Op.EQUALS:
            if node.arg(0).type.is_bool_type():
                return self._iff(node.arg(0), node.arg(1), positive)
            return self._equality(node, positive)
        if kind is Op.PRESENT_EXP:
            return self._present(node) if positive else ~self._present(node)
        if kind is Op.BOOL_CONSTANT:
            return TRUE if node.bool_constant_value() == positive else FALSE
        return self._truth(self._atom_truth(node), positive)

    def _atom_truth(self, node: FNode) -> Lin:
        if node.node_type in (Op.PARAM_EXP, Op.FLUENT_EXP):
            return self._atom(node)
        raise UnsupportedError(f"'{node}' ({node.node_type.name}) is not supported by cpsat")

    def _truth(self, lin: Lin, positive: bool) -> Form:
        """Return ``lin == 1`` (or ``== 0``) for a 0/1 expression."""
        if (
            len(lin.terms) == 1
            and not lin.needs
            and (lin.terms[0][1], lin.const) in ((1, 0), (-1, 1))
        ):
            straight = lin.terms[0][1] == 1
            return lin.terms[0][0] if straight == positive else ~lin.terms[0][0]
        return self.compare(lin.shift(-1 if positive else 0), "==")

    def _present(self, node: FNode) -> Literal:
        name = node.presence().container
        if name not in self.world.activities:
            raise ProblemError(f"'{node}' refers to no activity of the problem")
        return self.world.activities[name].present

    def _iff(self, a: FNode, b: FNode, positive: bool) -> Form:
        both = conjunction([self.form(a), self.form(b, positive)])
        neither = conjunction([self.form(a, False), self.form(b, not positive)])
        return disjunction([both, neither])

    def _difference(self, node: FNode) -> Lin:
        left, d = self.scaled(node.arg(0))
        right, e = self.scaled(node.arg(1))
        if d == e:
            return left.plus(right, -1)
        scale = math.lcm(d, e)
        return times(left, scale // d).plus(times(right, scale // e), -1)

    def _inequality(self, node: FNode, positive: bool) -> Form:
        difference = self._difference(node)
        if node.node_type is Op.LT:
            difference = difference.shift(1)
        if not positive:
            difference = times(difference, -1).shift(1)
        return self.compare(difference, "<=")

    def _equality(self, node: FNode, positive: bool) -> Form:
        # who else reads these, or when, is no matter; copies of an activity are compared often
        plain = all(a.node_type in (Op.PARAM_EXP, Op.OBJECT_EXP) for a in node.args)
        if not plain or self.compare is not compare:
            return self.compare(self._difference(node), "==" if positive else "!=")
        key, known = (node.node_id, positive), self.world.equalities
        if key not in known:
            known[key] = compare(self._difference(node), "==" if positive else "!=")
        return known[key]


def times(lin: Lin, factor: int) -> Lin:
    """Return ``factor * lin``."""
    return lin if factor == 1 else Lin().plus(lin, factor)


# ------------------ Durations, constants and fractions as whole numbers, and how large these may be


MAGNITUDE = 10**9
"""Largest magnitude of an integer variable that the problem does not bound."""
LARGEST = 2**50
"""Largest number that a problem may name; sums of many have to fit into 63 bits."""
PLACEHOLDER = 10**7
"""Latest time of variables until the horizon is known."""
INFINITE = 10**12
"""Longer than anything: what cannot be."""


def constant_bounds(duration: DurationInterval) -> tuple[int | None, int | None]:
    """Return the least and greatest integer duration, ``None`` where it is not constant."""
    lower, upper = whole_bounds(duration)
    return (
        None if lower is None else max(0, lower),
        None if upper is None else min(upper, LARGEST),
    )


def check_duration(activity: Activity) -> None:
    """Refuse a duration that whole numbers cannot tell: times are counted in units.

    :raises UnsupportedError: if there are durations, but no whole ones, or it is too long.
    """
    duration = activity.duration
    lower, upper = constant_bounds(duration)
    if lower is None or upper is None:
        return
    if lower > LARGEST:
        raise UnsupportedError(
            f"activity '{activity.name}' lasts {duration.lower} units and more; "
            f"cpsat counts to {LARGEST}"
        )
    if lower > upper and Fraction(duration.upper.constant_value()) > 0:
        raise UnsupportedError(
            f"cpsat plans in whole units, and the duration of activity '{activity.name}', "
            f"{duration}, holds no whole number: choose a smaller unit for all times"
        )


def least(duration: DurationInterval) -> int:
    """Return the least integer duration (0 where it is not constant)."""
    return constant_bounds(duration)[0] or 0


def constants(node: FNode) -> int:
    """Return the sum of the magnitudes of the constants in ``node``."""
    if node.is_int_constant():
        return abs(int(node.constant_value()))
    if node.is_real_constant():
        return math.ceil(abs(node.constant_value()))
    if node.is_timing_exp():
        return int(abs(node.timing().delay)) + 1
    return sum(constants(a) for a in node.args)


# ------------------ Fluents of real types: by what their values are multiplied


def scales_of(problem: Any) -> dict[str, int]:
    """Return for each fluent of a real type by what its values are multiplied, to be whole numbers
    whatever happens.

    :raises UnsupportedError: where no number does, or only a huge one.
    """
    real = {f.name: f for f in problem.fluents if f.type.is_real_type()}
    scales = dict.fromkeys(real, 1)
    if not real:
        return {}
    for fluent, value in problem.fluents_defaults.items():
        if fluent.name in real:
            _multiply(scales, fluent.name, value)
    for fluent, value in problem.explicit_initial_values.items():
        if fluent.fluent().name in real:
            _multiply(scales, fluent.fluent().name, value)
    effects = [e for _, e, _ in problem.all_effects() if e.fluent.fluent().name in real]
    for _ in range(len(real) + 1):
        before = dict(scales)
        for effect in effects:
            _multiply(scales, effect.fluent.fluent().name, effect.value)
        if scales == before:
            return scales
    name = next(n for n in scales if scales[n] != before[n])
    raise UnsupportedError(
        f"cpsat counts in whole numbers, and '{name}' takes ever finer fractions"
    )


def _multiply(scales: dict[str, int], name: str, value: FNode) -> None:
    scales[name] = math.lcm(scales[name], denominator(value, scales))
    if scales[name] > MAGNITUDE:
        raise UnsupportedError(
            f"cpsat counts in whole numbers, and '{name}' has too fine fractions"
        )


def denominator(node: FNode, scales: dict[str, int]) -> int:
    """Return a number by which the value of an expression is whole."""
    kind = node.node_type
    if kind is Op.REAL_CONSTANT:
        return Fraction(node.constant_value()).denominator
    if kind is Op.FLUENT_EXP:
        return scales.get(node.fluent().name, 1)
    parts = [denominator(arg, scales) for arg in node.args]
    if kind in (Op.PLUS, Op.MINUS):
        return math.lcm(*parts)
    if kind is Op.TIMES:
        return math.prod(parts)
    if kind is Op.DIV and node.arg(1).is_constant():
        by = Fraction(node.arg(1).constant_value())
        return parts[0] * abs(by.numerator)
    if kind is Op.TIMING_EXP:
        return Fraction(node.timing().delay).denominator
    return 1
