"""A naive oracle for small scheduling problems: try every schedule, look at every instant.

It shares nothing with the engines and the validator; its rules are those of
``docs/semantics.md``, written as directly as possible.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from fractions import Fraction

from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.timing import TimepointKind

from up_samp.model.objective import MinimizeCosts

UNKNOWN = None


@dataclass
class Best:
    """The best schedule found: value of the metric (makespan without one) and the choice."""

    value: int
    makespan: int
    choice: dict


class Choice:
    """One candidate: ``times[name]`` is (start, end) or None; ``values`` of all parameters."""

    def __init__(self, times, values):
        self.times = times
        self.values = values
        self.makespan = max((t[1] for t in times.values() if t is not None), default=0)


def solve(problem, horizon):
    """Return the best valid schedule with all ends <= ``horizon``, or None."""
    names = [a.name for a in problem.activities]
    options = [_options(problem, a, horizon) for a in problem.activities]
    variables = problem.base_variables
    globals_ = [
        dict(zip([v.name for v in variables], combo, strict=True))
        for combo in itertools.product(*(_values(problem, v.type) for v in variables))
    ]
    judge = _Judge(problem)
    best = None
    metric = problem.quality_metrics[0] if problem.quality_metrics else None
    combos = sorted(
        itertools.product(*options),
        key=lambda c: max((o[0][1] for o in c if o[0] is not None), default=0),
    )
    for combo in combos:
        times = {n: o[0] for n, o in zip(names, combo, strict=True)}
        own = {k: v for o in combo for k, v in o[1].items()}
        for shared in globals_:
            choice = Choice(times, {**own, **shared})
            states = judge.valid(choice)
            if states is None:
                continue
            value = judge.metric(metric, choice, states)
            if best is None or value < best.value:
                best = Best(value, choice.makespan, {"times": times, "values": choice.values})
            if metric is None or metric.is_minimize_makespan():
                return best
    return best


def _values(problem, tpe):
    if tpe.is_bool_type():
        return [False, True]
    if tpe.is_user_type():
        return [o.name for o in problem.all_objects if tpe in list(o.type.ancestors)]
    return list(range(tpe.lower_bound, tpe.upper_bound + 1))


def _options(problem, activity, horizon):
    found = [(None, {})] if activity.optional else []
    pools = [_values(problem, p.type) for p in activity.parameters]
    names = [p.name for p in activity.parameters]
    for start in range(horizon + 1):
        for end in range(start, horizon + 1):
            for combo in itertools.product(*pools):
                found.append(((start, end), dict(zip(names, combo, strict=True))))
    bounds = activity.duration
    if bounds.lower.is_constant() and bounds.upper.is_constant():
        found = [o for o in found if o[0] is None or _lasts(bounds, o[0][1] - o[0][0])]
    return found


def _lasts(bounds, size, lower=None, upper=None):
    lower = bounds.lower.constant_value() if lower is None else lower
    upper = bounds.upper.constant_value() if upper is None else upper
    above = size > lower if bounds.is_left_open() else size >= lower
    below = size < upper if bounds.is_right_open() else size <= upper
    return above and below


class _Judge:
    def __init__(self, problem):
        self.problem = problem
        self.constraints = [(c, scope, None) for c, scope in problem.base_scoped_constraints] + [
            (c, scope, a) for a in problem.activities for c, scope in a.scoped_constraints
        ]
        self.effects = problem.all_effects()
        self.conditions = problem.all_conditions()
        self.initial = {}
        for node, value in problem.initial_values.items():
            key = (node.fluent().name, *(_plain(a) for a in node.args))
            self.initial[key] = _plain(value)
        self.bounds = {
            f.name: (f.type.lower_bound, f.type.upper_bound)
            for f in problem.fluents
            if f.type.is_int_type() or f.type.is_real_type()
        }

    # -- expressions -------------------------------------------------------------------------
    def time(self, timing, choice, owner, end=None):
        point = timing.timepoint
        if point.kind is TimepointKind.GLOBAL_START:
            base = 0
        elif point.kind is TimepointKind.GLOBAL_END:
            base = choice.makespan if end is None else end
        else:
            name = point.container or owner.name
            span = choice.times[name]
            if span is None:
                return UNKNOWN
            base = span[0] if point.kind is TimepointKind.START else span[1]
        return base + timing.delay

    def value(self, node, choice, owner, read):
        kind, args = node.node_type, node.args
        if kind in (Op.BOOL_CONSTANT, Op.INT_CONSTANT, Op.REAL_CONSTANT, Op.OBJECT_EXP):
            return _plain(node)
        if kind is Op.PARAM_EXP:
            return choice.values.get(node.parameter().name, UNKNOWN)
        if kind is Op.TIMING_EXP:
            return self.time(node.timing(), choice, owner)
        if kind is Op.PRESENT_EXP:
            return choice.times[node.presence().container] is not None
        if kind is Op.FLUENT_EXP:
            key = [self.value(a, choice, owner, read) for a in args]
            if UNKNOWN in key:
                return UNKNOWN
            return read((node.fluent().name, *key))
        values = [self.value(a, choice, owner, read) for a in args]
        return _OPERATORS[kind](values)

    # -- judging -----------------------------------------------------------------------------
    def valid(self, choice):
        """Return the history of the state if the choice is valid, else None."""

        def static(key):
            return self.initial[key]

        for constraint, scope, owner in self.constraints:
            binds = all(self.value(s, choice, owner, static) is True for s in scope)
            if binds and self.value(constraint, choice, owner, static) is False:
                return None
        history = self.run(choice)
        if history is None:
            return None
        log, states, last = history
        for activity in self.problem.activities:
            span = choice.times[activity.name]
            if span is not None:

                def read(key, t=span[0]):
                    return _at(states, t)[key]

                low = self.value(activity.duration.lower, choice, activity, read)
                high = self.value(activity.duration.upper, choice, activity, read)
                if not _lasts(activity.duration, span[1] - span[0], low, high):
                    return None
                bounds = [activity.duration.lower, activity.duration.upper]
                keys = self.read_keys(bounds, choice, activity)
                if any(self.disturbed(k, span[0], span[0], activity, log) for k in keys):
                    return None
        for interval, condition, owner in self.conditions:
            if not self.holds(interval, condition, owner, choice, log, states, last):
                return None
        return states, last

    def run(self, choice):
        """Return (effects that happen, states by instant, last instant) or None."""
        timed = self.timed(choice)
        if any(t < 0 for t, *_ in timed):
            return None
        timed.sort(key=lambda x: x[0])
        state, states, log = dict(self.initial), [(-1, dict(self.initial))], []
        looked = []
        for t, group in itertools.groupby(timed, key=lambda x: x[0]):
            new, touched = dict(state), {}
            for _, effect, owner in group:

                def read(key, state=state):
                    return state[key]

                own = self.value_key(effect.fluent, choice, owner, read)
                keys = self.read_keys([effect.condition, effect.value], choice, owner)
                looked.append((t, keys - {own}, owner))
                if self.value(effect.condition, choice, owner, read) is False:
                    continue
                key = own
                value = self.value(effect.value, choice, owner, read)
                kind = "=" if effect.is_assignment() else "+"
                if key in touched and not (touched[key] == kind == "+"):
                    return None
                touched[key] = kind
                if kind == "=":
                    new[key] = value
                else:
                    new[key] += value if effect.is_increase() else -value
                log.append((t, key, owner, effect))
            for key in touched:
                low, high = self.bounds.get(key[0], (None, None))
                if (low is not None and new[key] < low) or (high is not None and new[key] > high):
                    return None
            state = new
            states.append((t, state))
        last = max([choice.makespan, *(t for t, *_ in timed)])
        for t, keys, owner in looked:
            if any(self.disturbed(k, t, t, owner, log) for k in keys):
                return None
        return log, states, last

    def timed(self, choice):
        """Return (time, effect, owner) for all effects of present activities and the problem."""
        found = []
        for timing, effect, owner in self.effects:
            if owner is None or choice.times[owner.name] is not None:
                t = self.time(timing, choice, owner)
                if t is not UNKNOWN:
                    found.append((t, effect, owner))
        return found

    def value_key(self, node, choice, owner, read):
        return (node.fluent().name, *(self.value(a, choice, owner, read) for a in node.args))

    def read_keys(self, nodes, choice, owner):
        keys = set()
        for node in nodes:
            if node.node_type is Op.FLUENT_EXP:
                keys.add(self.value_key(node, choice, owner, None))
            keys |= self.read_keys(node.args, choice, owner)
        return keys

    @staticmethod
    def disturbed(key, lo, hi, owner, log):
        if owner is None:
            return False
        return any(
            k == key and lo <= t <= hi and o is not None and o.name != owner.name
            for t, k, o, _ in log
        )

    def holds(self, interval, condition, owner, choice, log, states, last):
        if owner is not None and choice.times[owner.name] is None:
            return True
        lo = self.time(interval.lower, choice, owner, last + 1)
        hi = self.time(interval.upper, choice, owner, last + 1)
        if lo is UNKNOWN or hi is UNKNOWN:
            return True
        lo += 1 if interval.is_left_open() else 0
        hi -= 1 if interval.is_right_open() else 0
        for t in range(lo, hi + 1):

            def read(key, t=t):
                return _at(states, t)[key]

            if self.value(condition, choice, owner, read) is False:
                return False
            keys = self.read_keys([condition], choice, owner)
            if any(self.disturbed(k, t, t, owner, log) for k in keys if UNKNOWN not in k):
                return False
        if interval.is_right_open() and lo <= hi:
            # time is dense inside: what is set at hi is seen in the last unit

            def read_inside(key):
                return _at(states, hi + 1)[key]

            return self.value(condition, choice, owner, read_inside) is not False
        return True

    def total(self, costs, choice, read):
        sums = Counter()
        for cost in costs:
            sums[cost.term, cost.share] += self.cost(cost, choice, read)
        shared = {term for term, share in sums if share}
        most = [max(0, *(v for (t, s), v in sums.items() if t == m and s)) for m in shared]
        return sum(most) + sum(v for (_, share), v in sums.items() if not share)

    def metric(self, metric, choice, history):
        if metric is None or metric.is_minimize_makespan():
            return choice.makespan
        states, last = history

        def read(key):
            return _at(states, last + 1)[key]

        if isinstance(metric, MinimizeCosts):
            ranks = sorted({cost.rank for cost in metric.costs})
            told = [[c for c in metric.costs if c.rank == rank] for rank in ranks]
            values = tuple(self.total(costs, choice, read) for costs in told)
            return values if len(ranks) > 1 else sum(values)  # of several, the first counts first
        if metric.is_minimize_expression_on_final_state():
            return self.value(metric.expression, choice, None, read)
        if metric.is_minimize_action_costs():
            return self.costs(metric, choice)
        if metric.is_oversubscription():
            reached = (self.value(g, choice, None, read) is True for g in metric.goals)
            return -sum(g for g, r in zip(metric.goals.values(), reached, strict=True) if r)
        if metric.is_temporal_oversubscription():
            return -sum(
                gain
                for (span, goal), gain in metric.goals.items()
                if self.throughout(span, goal, choice, states, last)
            )
        return -self.value(metric.expression, choice, None, read)

    def cost(self, cost, choice, read):
        """Return one cost of a sum: nothing, where its activity is absent."""
        activities = {a.name: a for a in self.problem.activities}
        if cost.activity is not None and choice.times[cost.activity] is None:
            return 0
        value = self.value(cost.node, choice, activities.get(cost.activity), read)
        if cost.node.type.is_bool_type():
            return cost.weight if value is True else 0
        return cost.weight * (max(0, value) if cost.positive else value)

    def costs(self, metric, choice):
        """Return what the present activities cost, by the fluents' first values."""
        total = 0
        for activity in self.problem.activities:
            if choice.times[activity.name] is not None:
                total += self.value(metric.default, choice, activity, lambda key: self.initial[key])
        return total

    def throughout(self, interval, goal, choice, states, last):
        """Return whether a goal is true at every instant, and inside a half-open last unit."""
        lo = self.time(interval.lower, choice, None, last + 1)
        hi = self.time(interval.upper, choice, None, last + 1)
        if lo is UNKNOWN or hi is UNKNOWN:
            return False
        lo += 1 if interval.is_left_open() else 0
        hi -= 1 if interval.is_right_open() else 0
        if lo > hi:
            return True
        hi += 1 if interval.is_right_open() else 0

        def read_at(t):
            return lambda key: _at(states, t)[key]

        return all(self.value(goal, choice, None, read_at(t)) is True for t in range(lo, hi + 1))


def _at(states, t):
    """Return the state seen at ``t``: after all effects before ``t``."""
    seen = states[0][1]
    for when, state in states:
        if when < t:
            seen = state
    return seen


def _plain(node):
    if node.is_object_exp():
        return node.object().name
    value = node.constant_value()
    return int(value) if isinstance(value, Fraction) and value.denominator == 1 else value


def _known(function):
    return lambda v: UNKNOWN if any(x is UNKNOWN for x in v) else function(v)


def _and(values):
    if any(v is False for v in values):
        return False
    return UNKNOWN if any(v is UNKNOWN for v in values) else True


def _or(values):
    if any(v is True for v in values):
        return True
    return UNKNOWN if any(v is UNKNOWN for v in values) else False


def _product(values):
    total = 1
    for v in values:
        total *= v
    return total


_OPERATORS = {
    Op.AND: _and,
    Op.OR: _or,
    Op.NOT: _known(lambda v: not v[0]),
    Op.IMPLIES: lambda v: _or([UNKNOWN if v[0] is UNKNOWN else not v[0], v[1]]),
    Op.IFF: _known(lambda v: v[0] == v[1]),
    Op.LE: _known(lambda v: v[0] <= v[1]),
    Op.LT: _known(lambda v: v[0] < v[1]),
    Op.EQUALS: _known(lambda v: v[0] == v[1]),
    Op.PLUS: _known(sum),
    Op.MINUS: _known(lambda v: v[0] - v[1]),
    Op.TIMES: _known(_product),
    Op.DIV: _known(lambda v: Fraction(v[0]) / v[1]),
}
