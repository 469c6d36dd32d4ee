"""What is left where something is decided: of expressions (who is there, what is over, which values
are known), and of the scheduling problem (which activities are present).
"""

from __future__ import annotations

import copy
import math
import operator
from collections.abc import Callable, Collection, Iterator, Mapping, Set
from dataclasses import replace
from functools import partial
from typing import TypeVar

from unified_planning.environment import Environment
from unified_planning.model import FNode, Timepoint, TimepointKind, Timing
from unified_planning.model.motion import MotionActivity, SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.scheduling.chronicle import Chronicle

from up_samp.model import CandidateSchedule, UnsupportedError
from up_samp.model.objective import Cost
from up_samp.upio.expressions import activity_named, walk
from up_samp.upio.objective import objective_of, only_makespan
from up_samp.upio.relaxation import Relaxation

_COMPARISONS = {Op.LE: operator.le, Op.LT: operator.lt, Op.EQUALS: operator.eq}


class Decided:
    """Puts what is decided into expressions.

    What has no value (times of what is absent, say) is neither true nor false, and a constraint
    that is not false holds (Kleene's logic, as the validator reads it). So a relation without a
    value counts as true where it stands, and as false under a negation.

    :param absent: activities that are not there, and so have no times.
    :param lost: parameters that have no value: of what is absent, mostly.
    :param present: activities that are surely there.
    :param values: known parameters.
    :param exact: start and end of activities that have begun (units, not rounded: what is over is
        judged by what really was; ``None``: it is not over).
    :param shift: units by which the clock of what is returned starts later.
    """

    def __init__(
        self,
        environment: Environment,
        *,
        absent: Set[str],
        lost: Set[str],
        present: Set[str],
        values: Mapping[str, FNode] | None = None,
        exact: Mapping[str, tuple[float, float | None]] | None = None,
        shift: int = 0,
    ) -> None:
        self.manager = environment.expression_manager
        self.absent, self.lost = absent, lost
        self.values, self.exact, self.shift = values or {}, exact or {}, shift
        self.present = present | self.exact.keys()
        self._past: dict[tuple[TimepointKind, str | None], float | None]
        self._past = {(TimepointKind.START, n): start for n, (start, _) in self.exact.items()}
        self._past |= {(TimepointKind.END, n): end for n, (_, end) in self.exact.items()}
        self._past[TimepointKind.GLOBAL_START, None] = 0.0
        self._memo: dict[tuple[FNode, bool], FNode] = {}

    def __call__(self, node: FNode, positive: bool = True) -> FNode:
        """Return an expression with what is decided; what has no value counts as ``positive``."""
        done = self._memo.get((node, positive))
        if done is None:
            done = self._memo[node, positive] = self._fix(node, positive)
        return done

    def cost(self, cost: Cost) -> Cost | None:
        """Return a cost on the new clock: what is over costs what it cost (``None``: it cannot
        come about any more).
        """
        plain = cost.node.type.is_bool_type()
        side = (self(cost.node), 0, 0.0) if plain else self._side(cost.node)
        if side is None or cost.activity in self.absent:
            return None
        node, live, _ = side
        if live:
            node = self.manager.Plus(node, self.manager.Int(self.shift * live))
        return replace(
            cost, node=node, activity=None if cost.activity in self.present else cost.activity
        )

    def tells(self, node: FNode) -> bool:
        """Return whether an expression speaks of parameters that are known, or of lost ones."""
        told = self.values.keys() | self.lost
        return any(n.is_parameter_exp() and n.parameter().name in told for n in walk(node))

    def _fix(self, node: FNode, positive: bool) -> FNode:
        m = self.manager
        if node.is_and() or node.is_or():
            return self._join(node, positive)
        if node.is_not():
            inner = self(node.arg(0), not positive)
            return m.Bool(not inner.constant_value()) if inner.is_bool_constant() else m.Not(inner)
        if node.is_implies():
            return self(m.Or(m.Not(node.arg(0)), node.arg(1)), positive)
        return self._iff(node, positive) if node.is_iff() else self._leaf(node, positive)

    def _join(self, node: FNode, positive: bool) -> FNode:
        m, decided = self.manager, node.is_or()
        kept = []
        for argument in node.args:
            fixed = self(argument, positive)
            if not fixed.is_bool_constant():
                kept.append(fixed)
            elif fixed.constant_value() == decided:
                return m.Bool(decided)
        if not kept:
            return m.Bool(not decided)
        return m.Or(kept) if decided else m.And(kept)

    def _iff(self, node: FNode, positive: bool) -> FNode:
        """Return what is left of an equivalence: the other side, where one is known."""
        m, (a, b) = self.manager, node.args
        if self._has_none(node):
            return self(m.And(m.Implies(a, b), m.Implies(b, a)), positive)
        one, two = map(self, node.args)
        for constant, other in ((one, two), (two, one)):
            if constant.is_true():
                return other
            if constant.is_false():
                return m.FALSE() if other.is_true() else m.Not(other)
        return m.Iff(one, two)

    def _leaf(self, node: FNode, positive: bool) -> FNode:
        """Return what is left of an expression that joins no truth values."""
        m = self.manager
        if node.is_present_exp():
            name = node.presence().container
            if name in self.present:
                return m.TRUE()
            return m.FALSE() if name in self.absent else node
        if node.node_type in _COMPARISONS:
            return self._comparison(node, positive)
        if self._has_none(node):
            return m.Bool(positive)
        if node.is_parameter_exp():
            return self.values.get(node.parameter().name, node)
        return self._rebuilt(node, tuple(self(a, positive) for a in node.args))

    def _rebuilt(self, node: FNode, arguments: tuple[FNode, ...]) -> FNode:
        if arguments == tuple(node.args):
            return node
        payload = node._content.payload
        return self.manager.create_node(node_type=node.node_type, args=arguments, payload=payload)

    def _has_none(self, node: FNode) -> bool:
        """Return whether something in it has no value: nobody chooses it any more."""
        return any(
            (n.is_parameter_exp() and n.parameter().name in self.lost)
            or (n.is_timing_exp() and activity_named(n) in self.absent)
            for n in walk(node)
        )

    def _comparison(self, node: FNode, positive: bool) -> FNode:
        """Return a comparison on the new clock; times without a partner are moved by the shift."""
        m = self.manager
        left, right = (self._side(a) for a in node.args)
        if left is None or right is None:
            return m.Bool(positive)
        (one, live_one, more_one), (two, live_two, more_two) = left, right
        if not live_one and not live_two and one.is_int_constant() and two.is_int_constant():
            return m.Bool(self._held(node))
        gap = self.shift * (live_one - live_two)
        gap += _whole(node.node_type, more_one - more_two, live_one > live_two)
        if gap and one.is_int_constant() and live_two == 1:
            one = m.Int(one.int_constant_value() + gap)
        elif gap and two.is_int_constant() and live_one == 1:
            two = m.Int(two.int_constant_value() - gap)
        elif gap:
            one = m.Plus(one, m.Int(gap))
        if one.is_int_constant() and two.is_int_constant():
            holds = _COMPARISONS[node.node_type](one.int_constant_value(), two.int_constant_value())
            return m.Bool(holds)
        if self._is_late(node.node_type, one, two):
            return m.FALSE()
        sides = [one, two]
        if node.is_equals():  # UP compares times with numbers, not numbers with times
            sides.sort(key=FNode.is_int_constant)
        return self._rebuilt(node, tuple(sides))

    def _is_late(self, kind: Op, one: FNode, two: FNode) -> bool:
        """Return whether what goes on is to end before a time (or then) that is over."""
        if kind == Op.EQUALS or not one.is_timing_exp() or not two.is_int_constant():
            return False
        timing = one.timing()
        in_time = _COMPARISONS[kind](1 + timing.delay, two.int_constant_value())
        return timing.timepoint.container in self.exact and not in_time

    def _held(self, node: FNode) -> bool:
        """Return whether a comparison of times that are over held."""
        one, two = (self._real(a) for a in node.args)
        if node.node_type == Op.LE:
            return one <= two + 1e-6
        return one < two if node.node_type == Op.LT else abs(one - two) <= 1e-6

    def _real(self, node: FNode) -> float:
        if node.is_timing_exp():
            was = self._was(node)
            assert was is not None
            return float(node.timing().delay) + was
        if node.is_plus():
            return sum(self._real(a) for a in node.args)
        if node.is_minus():
            return self._real(node.arg(0)) - self._real(node.arg(1))
        return float(self(node).simplify().constant_value())

    def _was(self, node: FNode) -> float | None:
        """Return when a point in time was (units; ``None``: it is still to come)."""
        point = node.timing().timepoint
        return self._past.get((point.kind, point.container))

    def _side(self, node: FNode) -> tuple[FNode, int, float] | None:
        """Return an arithmetic expression with past times put in (whole units), how many of the
        times in it are still to come, and by how much (units) it really is more (``None``: it has
        no value).
        """
        if node.is_timing_exp():
            return self._timing(node)
        if self._has_none(node):
            return None
        if not node.is_plus() and not node.is_minus():
            if any(n.is_timing_exp() for n in walk(node)):
                raise UnsupportedError(f"'{node}' in a constraint: times can only be added")
            found = self(node)
            return found.simplify() if node.args else found, 0, 0.0
        nodes, counts, parts = zip(*filter(None, map(self._side, node.args)), strict=True)
        sign = -1 if node.is_minus() else 1
        total = counts[0] + sign * sum(counts[1:])
        more = parts[0] + sign * sum(parts[1:])
        if all(n.is_int_constant() for n in nodes):
            first, *rest = (n.int_constant_value() for n in nodes)
            return self.manager.Int(first + sign * sum(rest)), total, more
        return self._rebuilt(node, nodes), total, more

    def _timing(self, node: FNode) -> tuple[FNode, int, float] | None:
        if node.timing().timepoint.container in self.absent:
            return None
        was = self._was(node)
        if was is None:
            return node, 1, 0.0
        whole = math.floor(was + 1e-9)
        return self.manager.Int(int(whole + node.timing().delay)), 0, was - whole


def _whole(kind: Op, more: float, later: bool) -> int:
    """Return what whole units are to be added to the left of a comparison whose left is ``more``
    (units) than it tells, so that whole times keep it if they really do. What is to be equal
    happens no sooner, as nothing waits longer by itself; ``later``: the left is what happens.
    """
    down = kind == Op.LT or (kind == Op.EQUALS and later)
    return math.floor(more + 1e-6) if down else math.ceil(more - 1e-6)


# ------------------ Problems with presence decided


Problem = TypeVar("Problem", bound=SchedulingProblem)


def restrict(
    relaxation: Relaxation,
    schedule: CandidateSchedule,
    *,
    free: frozenset[str] = frozenset(),
) -> SchedulingProblem:
    """Return the relaxation with all that was learned, with presence decided as in ``schedule``:
    present activities mandatory, others gone, motions between the same configurations. Those that
    are ``free``, present or not, may be left out; so may those that only witness where something
    is meanwhile: in another order it may be elsewhere.
    """
    names = schedule.times.keys() | free
    witnesses = {name for name, main in relaxation.elsewhere.items() if main in names}
    problem = _restricted(relaxation, names | witnesses, free | witnesses)
    _keep_decisions(relaxation, problem, schedule)
    return problem


def decided(relaxation: Relaxation, schedule: CandidateSchedule) -> SchedulingProblem:
    """Return the same with nothing left to decide but times."""
    problem = _restricted(relaxation, schedule.times.keys(), frozenset())
    _keep_decisions(relaxation, problem, schedule)
    return problem


def parts_for_engines(
    relaxation: Relaxation, schedule: CandidateSchedule | None
) -> Iterator[tuple[str, SchedulingProblem]]:
    """Yield what another engine is asked for a schedule of: what is present in ``schedule``, that
    with all that moves something, and the whole (nothing else without one); each with what it is in
    words. Nothing is optimised, and nothing is told of places that hold one object, which engines
    miscount.

    Each schedule of a part is one of the whole.
    """
    optional = {a.name for a in relaxation.problem.activities if a.optional}
    snapshot = relaxation.snapshot
    movers = snapshot.by_activity.keys() | {c.activity for c in snapshot.changes}
    movers &= optional
    twins = relaxation.elsewhere.keys()
    everything = relaxation.activities.keys() | twins
    parts: dict[str, Callable[[], SchedulingProblem]]
    parts = {"the whole": partial(_restricted, relaxation, everything, optional)}
    if schedule is not None:
        wider = movers | twins | schedule.times.keys()
        parts = {
            "what our own scheduler drew": partial(decided, relaxation, schedule),
            "that and all moves": partial(_restricted, relaxation, wider, movers | twins),
            **parts,
        }
    for what, made in parts.items():
        part = made()
        part.clear_quality_metrics()
        for activity in part.activities:
            for effects in activity._effects.values():
                effects[:] = [e for e in effects if e.fluent.fluent() not in relaxation.places]
        yield f"{what} ({len(part.activities)} of {len(everything)} activities)", part


def _keep_decisions(
    relaxation: Relaxation, problem: SchedulingProblem, schedule: CandidateSchedule
) -> None:
    """Keep the configurations of all motions: what is found out about them is for these."""
    for name in sorted({c.variable for c in relaxation.choices.values() if c.variable is not None}):
        value = schedule.parameters.get(name)
        owner = name.rpartition(".")[0]
        if isinstance(value, str) and (not owner or owner in schedule.times):
            kept = relaxation.manager.Equals(relaxation.variable(name), relaxation.place(value))
            problem.add_constraint(kept)


def _restricted(
    relaxation: Relaxation, present: Collection[str], free: Collection[str]
) -> SchedulingProblem:
    """Return the relaxation with presence decided: present activities mandatory (but for those
    that are ``free``), others gone.
    """
    source = relaxation.problem
    target, fix = _left_of(source, present, free)
    if not only_makespan(source):
        objective = objective_of(source)
        assert objective is not None
        target.clear_quality_metrics()
        target.add_quality_metric(objective.decided(fix, present))
    return target


def thinned(problem: SchedulingMotionProblem, keep: Collection[str]) -> SchedulingMotionProblem:
    """Return a problem without the optional activities that are not in ``keep``: they are absent.

    Each of its schedules is one of ``problem``.
    """
    names = {a.name for a in problem.activities if not a.optional or a.name in keep}
    target, _ = _left_of(problem, names, names)
    return target


def _left_of(
    problem: Problem, present: Collection[str], free: Collection[str]
) -> tuple[Problem, Decided]:
    """Return a problem without the activities that are not ``present``, of which the ``free`` ones
    stay optional, and what tells what is left of expressions. It takes time in proportion to what
    is left, and to the number of activities.
    """
    hollow = copy.copy(problem)
    hollow._activities = []
    if isinstance(hollow, SchedulingMotionProblem):
        hollow._motion_activities = []
    target = hollow.clone()
    kept = [a for a in problem.activities if a.name in present]
    gone = [a for a in problem.activities if a.name not in present]
    fix = Decided(
        problem.environment,
        absent={a.name for a in gone},
        lost={p.name for a in gone for p in a.parameters},
        present=set(present).difference(free).union(a.name for a in kept if not a.optional),
    )
    for activity in kept:
        copied = activity.clone()
        if activity.optional and activity.name not in free:
            copied._optional, copied._present = False, fix.manager.TRUE()
        _keep_constraints(fix, activity, copied)
        keep_times(fix, copied)
        target._activities.append(copied)
        if isinstance(copied, MotionActivity):
            target._motion_activities.append(copied)
    _keep_constraints(fix, problem._base, target._base)
    keep_times(fix, target._base)
    return target, fix


def _keep_constraints(fix: Decided, source: Chronicle, target: Chronicle) -> None:
    """Copy constraints with presence decided."""
    target._constraints = []
    for constraint, scope in source._constraints:
        # a scope that is not known to be true does not bind
        kept = [fix(s, positive=False) for s in scope]
        if any(s.is_false() for s in kept):
            continue
        fixed = fix(constraint)
        if not fixed.is_true():
            target._constraints.append((fixed, [s for s in kept if not s.is_true()]))


def keep_times(fix: Decided, target: Chronicle) -> None:
    """Drop conditions and effects at times of what is absent, and conditions on what it decides:
    these ask nothing, and do not happen.
    """

    def there(*times: Timing | Timepoint) -> bool:
        points = (t if isinstance(t, Timepoint) else t.timepoint for t in times)
        return fix.absent.isdisjoint(point.container for point in points)

    effects, conditions = target._effects, target._conditions
    target._effects = {time: some for time, some in effects.items() if there(time)}
    target._conditions = {}
    for span, nodes in conditions.items():
        if there(span.lower, span.upper):
            fixed = [fix(n) if fix.tells(n) else n for n in nodes]
            target._conditions[span] = [n for n in fixed if not n.is_true()]
