"""A naive judge of schedules, to compare encodings: plain recursion over UP expressions.

``holds(problem, times, reading)`` tells whether ``times`` (name -> (start, end) of the present
activities) satisfies durations, constraints, conditions and effects. ``reading`` is ``"pddl"`` (an
effect at t is seen from t + 1 on and may not meet a condition of another activity) or
``"definition 3"`` (an effect at t is seen at t).
"""

import operator

from unified_planning.model import OperatorKind, TimepointKind

_COMPARE = {
    OperatorKind.LT: operator.lt,
    OperatorKind.LE: operator.le,
    OperatorKind.EQUALS: operator.eq,
}


class Judge:
    def __init__(self, problem, times):
        self.problem = problem
        self.times = times
        self.horizon = max((e for _, e in times.values()), default=0)
        self.effects = []
        for timing, effect, owner in problem.all_effects():
            if owner is None or owner.name in times:
                at = self.instant(timing)
                self.effects.append((at, str(effect.fluent), effect.value, owner))

    def instant(self, timing):
        point = timing.timepoint
        if point.kind == TimepointKind.GLOBAL_END:
            return self.horizon + 1 + timing.delay
        if point.kind == TimepointKind.GLOBAL_START:
            return timing.delay
        start, end = self.times[point.container]
        return (start if point.kind == TimepointKind.START else end) + timing.delay

    def value(self, expression, state=None):
        kind = expression.node_type
        if kind == OperatorKind.AND:
            return all(self.value(x, state) for x in expression.args)
        if kind == OperatorKind.OR:
            return any(self.value(x, state) for x in expression.args)
        if kind == OperatorKind.NOT:
            return not self.value(expression.arg(0), state)
        if kind == OperatorKind.IMPLIES:
            return not self.value(expression.arg(0), state) or self.value(expression.arg(1), state)
        if kind == OperatorKind.IFF:
            return self.value(expression.arg(0), state) == self.value(expression.arg(1), state)
        if expression.is_bool_constant():
            return expression.bool_constant_value()
        if expression.is_present_exp():
            return expression.presence().container in self.times
        if expression.is_timing_exp():
            try:
                return self.instant(expression.timing())
            except KeyError:
                return None
        if expression.is_fluent_exp():
            return state[str(expression)]
        if expression.is_object_exp():
            return expression.object()
        sides = [self.value(x, state) for x in expression.args]
        return None not in sides and _COMPARE[kind](*sides)

    def state(self, t, strictly):
        values = {str(k): v for k, v in self.problem.initial_values.items()}
        for at, fluent, value, _ in sorted(self.effects, key=lambda e: e[0]):
            if at < t or (at == t and not strictly):
                values[fluent] = value
        return {k: self.value(v) for k, v in values.items()}

    def condition(self, span, formula, owner, reading):
        low, high = self.instant(span.lower), self.instant(span.upper)
        used = {str(f) for f in self.problem.environment.free_vars_extractor.get(formula)}
        for at, fluent, _, other in self.effects:
            meets = low <= at <= high and other is not owner
            if reading == "pddl" and fluent in used and meets:
                return False
        return all(
            self.value(formula, self.state(t, strictly=reading == "pddl"))
            for t in range(low, high + 1)
        )


def holds(problem, times, reading="pddl"):
    judge = Judge(problem, times)
    for a in problem.activities:
        if a.name in times:
            start, end = times[a.name]
            low, high = a.duration.lower.constant_value(), a.duration.upper.constant_value()
            if start < 0 or not low <= end - start <= high:
                return False
        elif not a.optional:
            return False
    for formula, scope in problem.all_scoped_constraints():
        if all(judge.value(s) for s in scope) and not judge.value(formula):
            return False
    moments = [(at, fluent) for at, fluent, _, _ in judge.effects]
    if len(set(moments)) < len(moments):
        return False
    return all(
        judge.condition(span, formula, owner, reading)
        for span, formula, owner in problem.all_conditions()
        if owner is None or owner.name in times
    )
