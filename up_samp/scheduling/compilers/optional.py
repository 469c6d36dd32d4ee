"""Optional activities and global decision variables away: everything becomes mandatory, a bool
parameter says presence.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.constraints import DifferenceForm
from up_samp.scheduling.compilers.plain import (
    TRUE,
    Activity,
    Compiled,
    Condition,
    Effect,
    Expr,
    Fluent,
    PlainProblem,
    Type,
    conjunction,
    disjunction,
    end,
    evaluate,
    fluents_in,
    fresh,
    integer,
    names_in_use,
    rewrite,
    show,
    some_value,
    start,
    subexpressions,
    values_of,
)


def touched_fluents(problem: PlainProblem, optional: frozenset[str]) -> set[str]:
    """Return the fluents that optional activities, and effects with conditions, read or write."""
    touched = {e.fluent[1] for e in problem.effects if e.owner in optional or e.condition != TRUE}
    return touched | {
        fluent[1]
        for condition in problem.conditions
        if condition.owner in optional
        for fluent in fluents_in(condition.expression)
    }


def ground_fluents(problem: PlainProblem, fluents: set[str]) -> list[Expr]:
    """Return all ground expressions of these fluents."""
    ground = []
    for name in sorted(fluents):
        domains = [values_of(problem, t) for _, t in problem.fluents[name].parameters]
        ground += [("flu", name, *choice) for choice in itertools.product(*domains)]
    return ground


def idle_values(problem: PlainProblem, owner: str) -> dict[Expr, Expr]:
    """Return values that the parameters of an absent activity may take so that all its conditions
    hold on private copies. Nothing else asks anything of them then.
    """
    conditions = [c for c in problem.conditions if c.owner == owner]
    used = {e: e for c in conditions for e in subexpressions(c.expression) if e[0] == "par"}
    types = problem.parameter_types
    finite = [(p, types[p[1]]) for p in used]
    finite = [(p, t) for p, t in finite if t[0] != "int" or None not in t[1:]]
    domains = [values_of(problem, t) for _, t in finite]
    for choice in itertools.islice(itertools.product(*domains), 10_000):
        values = dict(zip((p for p, _ in finite), choice, strict=True))
        if all(wished_values(problem, c, values) is not None for c in conditions):
            return values
    shown = ", ".join(show(c.expression) for c in conditions)
    raise UnsupportedError(
        f"the conditions of optional activity {owner} ({shown}): no values of its fluents and "
        "parameters are known to satisfy them"
    )


def wished_values(
    problem: PlainProblem, condition: Condition, idle: dict[Expr, Expr]
) -> dict[Expr, Expr] | None:
    """Return values of the fluents with which the condition holds if the parameters have their
    ``idle`` values, whatever others do; None where none are known.
    """
    expression = condition.expression
    distinct = fluents_in(expression)
    domains = [_candidates(problem, expression, atom) for atom in distinct]
    for choice in itertools.islice(itertools.product(*domains), 100_000):
        values = dict(zip(distinct, choice, strict=True))
        if evaluate(rewrite(rewrite(expression, values.get), idle.get)) == TRUE:
            return values
    return None


def _candidates(problem: PlainProblem, expression: Expr, atom: Expr) -> list[Expr]:
    tpe = problem.fluents[atom[1]].type
    if tpe[0] != "int":
        return values_of(problem, tpe)
    numbers = {e[1] + d for e in subexpressions(expression) if e[0] == "int" for d in (-1, 0, 1)}
    numbers |= {0} | {bound for bound in tpe[1:] if bound is not None}
    low, high = tpe[1], tpe[2]
    inside = [
        n for n in sorted(numbers) if (low is None or low <= n) and (high is None or n <= high)
    ]
    return [integer(n) for n in inside]


# ------------------ An activity of no duration at time 0, that is surely there


def compile_anchor(problem: PlainProblem) -> Compiled:
    """Give all global variables to one activity of no duration at time 0: aries 0.5.0 does not
    report those that belong to none. It comes where no activity has to be there, too: cpse 0.1.0
    finds no makespan then, and calls the problem unsolvable.
    """
    if not problem.variables and any(not a.optional for a in problem.activities):
        return Compiled(problem)
    name = fresh("anchor", names_in_use(problem))
    anchor = Activity(name, False, integer(0), integer(0), tuple(problem.variables.items()))
    at_0 = ("le", start(name), integer(0))
    everybody = (*problem.activities, anchor)
    return Compiled(problem.saying([at_0], activities=everybody, variables={}))


# ------------------ Optional activities away
# Every activity becomes mandatory, a bool parameter says presence. An absent activity runs as early
# and as short as it can (at time 0, mostly without duration). Its conditions and effects stay, on
# private copies of the fluents: every fluent that an optional activity touches gets one more
# parameter, a *slot*. The slot ``main`` is the real fluent. Each condition and effect of an
# optional activity has a slot parameter that is ``main`` if the activity is present, and ``off...``
# if not; the copies that absent conditions read have suitable initial values (shared where those
# are equal, as nobody writes there), the copies that absent effects write are read by nobody. An
# effect with a condition over parameters is treated likewise: its slot is ``main`` if it happens.
#
# Size: linear in the conditions and effects.


def compile_optional(problem: PlainProblem) -> Compiled:
    """Return a problem without optional activities.

    Raises:
        UnsupportedError: an optional activity with a duration that depends on parameters, or with
            a condition that no values of the fluents satisfy.
    """
    if not problem.optional_names and all(e.condition == TRUE for e in problem.effects):
        return Compiled(problem)
    return _OptionalCompiler(problem).compile()


class _OptionalCompiler:
    def __init__(self, problem: PlainProblem):
        self.problem = problem
        self.taken = names_in_use(problem)
        self.optional = problem.optional_names
        self.shortest = {a.name: self._shortest(a) for a in problem.activities if a.optional}
        self.earliest = {name: self._earliest(name) for name in self.optional}
        self.present: dict[str, str] = {
            name: fresh(f"{name}.present", self.taken) for name in sorted(self.optional)
        }
        self.slotted = touched_fluents(problem, self.optional)
        self.slot_types = {f: fresh(f"Slot_{f}", self.taken) for f in self.slotted}
        self.main = {f: fresh(f"main_{f}", self.taken) for f in self.slotted}
        self.types: dict[str, str | None] = dict(problem.types)
        self.objects = dict(problem.objects)
        for f in self.slotted:
            self.types[self.slot_types[f]] = None
            self.objects[self.main[f]] = self.slot_types[f]
        self.initial: dict[Expr, Expr] = {}
        self.extra: dict[str, list[tuple[str, Type]]] = {name: [] for name in self.optional}
        self.constraints: list[Expr] = []
        self.variables = dict(problem.variables)
        certain = tuple(replace(a, optional=False) for a in problem.activities)
        self.normal = DifferenceForm(replace(problem, activities=certain))
        self._copies: dict[tuple[str, Expr], str] = {}
        self.idle: dict[str, dict[Expr, Expr]] = {}
        self.exact = True

    def compile(self) -> Compiled:
        problem = self.problem
        activities = [self._activity(a) for a in problem.activities]
        conditions = [self._condition(c) for c in problem.conditions]
        effects = [self._effect(e) for e in problem.effects]
        for ground in ground_fluents(problem, self.slotted):
            self.initial[self._at_main(ground)] = problem.initial_value(ground)
        fluents = {
            name: replace(f, parameters=(*f.parameters, ("slot", ("user", self.slot_types[name]))))
            if name in self.slotted
            else f
            for name, f in problem.fluents.items()
        }
        kept = {k: v for k, v in problem.initial.items() if k[1] not in self.slotted}
        for name in self.slotted:
            fluents[name] = self._with_default(fluents[name])
        compiled = replace(
            problem,
            activities=tuple(
                replace(a, parameters=(*a.parameters, *self.extra.get(a.name, ())))
                for a in activities
            ),
            constraints=(
                *map(self._expression, problem.constraints),
                *(c for c in self.constraints if c != TRUE),
            ),
            conditions=tuple(conditions),
            effects=tuple(effects),
            variables=self.variables,
            types=self.types,
            objects=self.objects,
            fluents=fluents,
            initial={**kept, **self.initial},
        )
        floor = max((self.shortest[n] + self.earliest[n] for n in self.optional), default=0)
        return Compiled(compiled, self.present, floor, self.exact)

    def _with_default(self, fluent: Fluent) -> Fluent:
        """Return the fluent with a default value, for copies whose value does not matter."""
        if fluent.default is not None:
            return fluent
        return replace(fluent, default=some_value(self.problem, fluent.type))

    def _shortest(self, activity: Activity) -> int:
        """Return the shortest duration with which none of the activity's conditions is empty
        (an empty interval makes aries 0.5.0 call a problem unsolvable).
        """
        shortest, longest = 0, math.inf
        for condition in self.problem.conditions:
            if condition.owner != activity.name:
                continue
            (_, low, at, low_delay), (_, high, to, high_delay) = condition.low, condition.high
            if at != activity.name or to != activity.name:
                continue  # relative to the plan's start or end
            if low == high and low_delay <= high_delay:
                continue
            if low == "start" and high == "end":
                shortest = max(shortest, low_delay - high_delay)
            else:
                longest = min(longest, high_delay - low_delay if low != high else -math.inf)
            if shortest > longest:
                raise UnsupportedError(
                    f"the condition of optional activity {activity.name} over "
                    f"[{show(condition.low)}, {show(condition.high)}]"
                )
        return shortest

    def _earliest(self, name: str) -> int:
        """Return the start of the activity, if absent, at which nothing of it is before 0."""
        times = [c.low for c in self.problem.conditions if c.owner == name]
        times += [e.time for e in self.problem.effects if e.owner == name]
        return max((-t[3] for t in times if t[1] in ("start", "end") and t[3] < 0), default=0)

    def _activity(self, activity: Activity) -> Activity:
        if not activity.optional:
            return activity
        name, lower, upper = activity.name, activity.lower, activity.upper
        if lower[0] != "int" or upper[0] != "int":
            raise UnsupportedError(f"a duration of optional activity {name} that is not constant")
        shortest, present = self.shortest[name], ("par", self.present[name])
        self.extra[name].append((self.present[name], ("bool",)))
        if lower[1] > shortest:
            long = ("le", start(name, lower[1]), end(name))
            self.constraints.append(disjunction([("not", present), long]))
        if upper[1] < shortest:
            short = ("le", end(name), start(name, upper[1]))
            self.constraints.append(disjunction([("not", present), short]))
        first = self.earliest[name]
        last = integer(first + shortest)
        self.constraints.append(disjunction([present, ("le", start(name), integer(first))]))
        if first:
            self.constraints.append(disjunction([present, ("le", integer(first), start(name))]))
        self.constraints.append(disjunction([present, ("le", end(name), last)]))
        duration = integer(min(shortest, lower[1])), integer(max(shortest, upper[1]))
        return Activity(name, False, *duration, activity.parameters)

    def _expression(self, expression: Expr) -> Expr:
        def leaf(e: Expr) -> Expr | None:
            if e[0] == "pres":
                return ("par", self.present[e[1]]) if e[1] in self.present else TRUE
            if e[0] == "flu" and e[1] in self.slotted:
                return self._at_main((*e[:2], *(self._expression(a) for a in e[2:])))
            return None

        return rewrite(expression, leaf)

    def _at_main(self, fluent: Expr) -> Expr:
        return (*fluent, ("obj", self.main[fluent[1]]))

    def _condition(self, condition: Condition) -> Condition:
        owner = condition.owner
        if owner not in self.optional:
            return replace(condition, expression=self._expression(condition.expression))
        assert owner is not None
        if owner not in self.idle:
            self.idle[owner] = idle_values(self.problem, owner)
        condition = replace(condition, expression=self._with_own(owner, condition.expression))
        wishes = wished_values(self.problem, condition, self.idle[owner])
        assert wishes is not None
        slots = {
            atom: self._in_slot(
                owner, self._present(owner), atom, self._reading_copy(atom, wishes[atom])
            )
            for atom in fluents_in(condition.expression)
        }
        return replace(condition, expression=rewrite(condition.expression, slots.get))

    def _with_own(self, owner: str, expression: Expr) -> Expr:
        """Return a condition with the owner's own parameters only: who is absent must not bind
        the problem's variables and others' parameters. A stand-in equals them if it is present.
        """
        own = {name for name, _ in self.problem.activity(owner).parameters}
        types = self.problem.parameter_types
        stand_ins: dict[Expr, Expr] = {}
        for e in subexpressions(expression):
            if e[0] != "par" or e[1] in own or e in stand_ins:
                continue
            name = fresh(f"{owner}.own", self.taken)
            self.extra[owner].append((name, types[e[1]]))
            stand_ins[e] = ("par", name)
            if e in self.idle[owner]:
                self.idle[owner]["par", name] = self.idle[owner][e]
            same = self.normal(("eq", e, ("par", name)))
            self.constraints.append(disjunction([("not", self._present(owner)), same]))
        return rewrite(expression, stand_ins.get)

    def _effect(self, effect: Effect) -> Effect:
        owner, fluent = effect.owner, effect.fluent
        value, condition = self._expression(effect.value), self._expression(effect.condition)
        if owner not in self.optional and condition == TRUE:
            return replace(effect, fluent=self._expression(fluent), value=value)
        if fluents_in(condition):
            raise UnsupportedError(
                f"the effect of {owner or 'the problem'} on {show(fluent)} that depends on fluents"
            )
        happens = conjunction([self._present(owner), condition])
        own = fresh(f"off_{fluent[1]}_{owner}", self.taken)
        self.objects[own] = self.slot_types[fluent[1]]
        if effect.kind != "assign":
            self._make_room(effect, own)
        slot = self._in_slot(owner, happens, fluent, own)
        return replace(effect, fluent=slot, value=value, condition=TRUE)

    def _present(self, owner: str | None) -> Expr:
        return ("par", self.present[owner]) if owner in self.present else TRUE

    def _make_room(self, effect: Effect, copy: str) -> None:
        """Let the copy start with a value from which one can count. Where an amount is more than
        its fluent's type has room for, nobody who changes it so can be absent.
        """
        _, low, high = self.problem.fluents[effect.fluent[1]].type
        least, most = self._amounts(effect.value)
        rises = (effect.kind == "increase") == (least >= 0)
        most = max(-least, most)
        value = low if rises else high
        if value is None:  # there is room from the other bound on
            value = (high or 0) - most if rises else (low or 0) + most
        room = math.inf if None in (low, high) else high - low
        self.exact &= most <= room
        for ground in ground_fluents(self.problem, {effect.fluent[1]}):
            self.initial[(*ground, ("obj", copy))] = integer(value)

    def _amounts(self, value: Expr) -> tuple[int, int]:
        """Return the least and the greatest amount. Where they are not known, or of both signs, the
        compiled problem is not exact.
        """
        value = evaluate(value)
        tpe = self.problem.parameter_types[value[1]] if value[0] == "par" else value
        plain = all((tpe[0] == "int", None not in tpe))
        known = tpe[1:] if plain else (0,)
        self.exact &= plain & (known[0] * known[-1] >= 0)
        return known[0], known[-1]

    def _reading_copy(self, atom: Expr, wish: Expr) -> str:
        """Return the slot in which the fluent has the wished value and nobody writes."""
        key = (atom[1], wish)
        if key not in self._copies:
            copy = fresh(f"off_{atom[1]}", self.taken)
            self._copies[key] = copy
            self.objects[copy] = self.slot_types[atom[1]]
            for ground in ground_fluents(self.problem, {atom[1]}):
                self.initial[(*ground, ("obj", copy))] = wish
        return self._copies[key]

    def _in_slot(self, owner: str | None, happens: Expr, fluent: Expr, off: str) -> Expr:
        """Return a fluent with one more slot parameter: ``main`` if it ``happens``, ``off`` if
        not.
        """
        base = "slot" if owner is None else f"{owner}.slot"
        parameter, tpe = fresh(base, self.taken), ("user", self.slot_types[fluent[1]])
        if owner is None:
            self.variables[parameter] = tpe
        else:
            self.extra.setdefault(owner, []).append((parameter, tpe))
        slot = ("par", parameter)
        self.constraints += [
            disjunction([self.normal(happens, False), ("eq", slot, ("obj", self.main[fluent[1]]))]),
            disjunction([self.normal(happens), ("eq", slot, ("obj", off))]),
        ]
        return (*fluent, slot)
