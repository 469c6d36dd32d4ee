"""Conditions over intervals, said so that engines read them as they are meant: half-open ones where
time is dense, empty ones, those that only keep others away, and those that need one supporter.
"""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter

from up_samp.model import UnsupportedError
from up_samp.model.graphs import grouped
from up_samp.scheduling.compilers.fluents import (
    comes_after,
    comes_before,
    empty,
    least,
    never_empty,
    outside,
)
from up_samp.scheduling.compilers.plain import (
    Activity,
    Compiled,
    Condition,
    Effect,
    Expr,
    PlainProblem,
    conjunction,
    conjuncts,
    disjunction,
    end,
    fluents_in,
    fresh,
    implies,
    integer,
    later,
    names_in_use,
    negation,
    put,
    show,
    start,
)


def compile_support(problem: PlainProblem) -> Compiled:
    """State conditions that effects may renew so that one supporter each loses nothing; likewise
    those over an interval that relate several fluents, which engines take for several conditions.

    The result is not exact where an interval may be empty, and where what an effect leaves hangs
    on other fluents and on whether it comes within.
    """
    conditions: list[Condition] = []
    constraints: list[Expr] = []
    exact = True
    for condition in conjuncts(problem.conditions):
        behind = least(problem, condition.high, condition.low)
        if behind is not None and behind > 0:
            continue  # over nothing
        read = {f[1] for f in fluents_in(condition.expression)}
        near = [e for e in problem.effects if e.fluent[1] in read]
        instant = behind == 0  # or nothing
        renewed = not instant and any(
            condition.lets(e) and _renews(problem, condition, e) for e in near
        )
        wanted = renewed or (len(read) > 1 and not instant)
        said = _effect_by_effect(problem, condition, near) if wanted else None
        if said is None:
            exact = exact and not renewed
            conditions.append(condition)
        else:
            conditions += said[0]
            constraints += said[1]
    found = problem.saying(constraints, conditions=tuple(dict.fromkeys(conditions)))
    return Compiled(found, exact=exact)


def _effect_by_effect(
    problem: PlainProblem, condition: Condition, effects: list[Effect]
) -> tuple[list[Condition], list[Expr]] | None:
    """Return conditions at instants, and constraints, that say the same as a condition over an
    interval, given all effects on what it reads; ``None`` where these cannot say it.
    """
    low, high = condition.low, condition.high
    flat = all(
        len(f) == 2 for f in (*fluents_in(condition.expression), *(e.fluent for e in effects))
    )
    before_the_end = high[1] == "horizon" and high[3] < 0
    if not flat or before_the_end or not never_empty(problem, condition):
        return None
    conditions = [replace(condition, high=low)]
    constraints: list[Expr] = []
    for effect in effects:
        if fluents_in(effect.condition):
            return None
        if not condition.lets(effect):
            constraints.append(outside(problem, condition, effect))
            continue
        since, until = least(problem, low, effect.time), least(problem, effect.time, high)
        if effect.kind != "assign" or fluents_in(effect.value):
            return None
        after = put(condition.expression, {effect.fluent: effect.value})
        ways = [*problem.apart(condition, effect), comes_before(problem, effect.time, low)]
        if high[1] != "horizon":  # which comes after all effects
            ways.append(("le", high, effect.time))
        if not fluents_in(after):
            constraints.append(disjunction([*ways, after]))
        elif since is None or since < 0 or until is None or until < 1:
            return None
        elif effect.owner not in (None, condition.owner):
            return None  # which may be absent
        else:
            then = later(effect.time, 1)
            conditions.append(replace(condition, low=then, high=then))
    return conditions, constraints


def _renews(problem: PlainProblem, condition: Condition, effect: Effect) -> bool:
    """Return whether the effect may come within the interval and keep the condition true."""
    if _breaks(condition, effect):
        return False
    before = least(problem, effect.time, condition.low)
    after = least(problem, condition.high, effect.time)
    return not ((before is not None and before >= 1) or (after is not None and after >= 0))


def _breaks(condition: Condition, effect: Effect) -> bool:
    """Return whether the condition asks for a constant other than the effect's."""
    expression = condition.expression
    if effect.kind != "assign" or expression[0] != "eq":
        return False
    wanted = [e for e in expression[1:] if e != effect.fluent]
    constants = ("obj", "int", "bool")
    if len(wanted) != 1 or wanted[0][0] not in constants or effect.value[0] not in constants:
        return False
    return bool(wanted[0] != effect.value)


# ------------------ Half-open conditions where time is dense
# What is set in their last unit is seen inside. A condition over ``[low, high + 1)`` holds at
# ``high``, and also right after it. Effects of other activities keep out of it anyway; one of its
# own activity, or of the problem itself, may come at ``high``. Then the condition has to hold with
# what that sets, which engines that know integer times only do not ask for.


def compile_dense(problem: PlainProblem) -> Compiled:
    """State for every effect that may come in the last unit of a half-open condition that it does
    not, or keeps it true.

    The result is not exact where what it sets cannot be told from parameters alone: there it is
    kept away.
    """
    constraints: list[Expr] = []
    conditions: dict[Condition, None] = {}
    exact = True
    for condition in problem.conditions:
        conditions[replace(condition, dense=False)] = None
        for effect in problem.effects if condition.dense else ():
            if not _may_meet(problem, condition, effect):
                continue
            after = _after(condition.expression, effect)
            exact = exact and after is not None
            # whether it happens cannot be told where that hangs on fluents: as if it did
            exact = exact and not fluents_in(effect.condition)
            ways = [*problem.apart(condition, effect), *_at_other_times(problem, condition, effect)]
            constraints.append(disjunction([*ways, *([after] if after is not None else [])]))
    found = problem.saying(constraints, conditions=tuple(conditions))
    return Compiled(found, exact=exact)


def _may_meet(problem: PlainProblem, condition: Condition, effect: Effect) -> bool:
    """Return whether an effect may come at the condition's last instant, and matters to it."""
    if effect.fluent[1] not in {f[1] for f in fluents_in(condition.expression)}:
        return False
    if not condition.lets(effect):
        return False
    before = least(problem, effect.time, condition.high)
    after = least(problem, condition.high, effect.time)
    return not ((before or 0) >= 1 or (after or 0) >= 1)


def _after(expression: Expr, effect: Effect) -> Expr | None:
    """Return an expression with what an effect sets; ``None`` if other fluents matter, too."""
    if effect.kind != "assign" or fluents_in(effect.value):
        return None
    said = put(expression, {effect.fluent: effect.value})
    return None if fluents_in(said) else said


def _at_other_times(problem: PlainProblem, condition: Condition, effect: Effect) -> list[Expr]:
    """Return the ways in which an effect is not at the last instant of a condition that asks for
    anything.
    """
    ways: list[Expr] = []
    if least(problem, condition.high, effect.time) != 0:
        ways.append(comes_before(problem, effect.time, condition.high))
    if least(problem, effect.time, condition.high) != 0:
        ways.append(comes_after(problem, effect.time, condition.high))
    span = least(problem, condition.low, condition.high)
    if span is None or span < 0:
        ways.append(empty(problem, condition))
    return ways


# ------------------ Conditions that only keep others away, and conditions that another one implies
# A condition that every value satisfies (``f = f``) still keeps the effects of other activities on
# ``f`` out of its interval. That is said by differences, which spares engines a supporter.


def compile_stillness(problem: PlainProblem) -> Compiled:
    """Turn tautologies over a fluent without arguments into constraints; drop conditions over
    a part of the interval of an equal one.
    """
    effects = grouped(problem.effects, attrgetter("fluent"))
    constraints: list[Expr] = []
    conditions: dict[Condition, None] = {}
    for condition in problem.conditions:
        fluent = _still(condition)
        others = [e for e in effects.get(fluent, ()) if not condition.lets(e)]
        if fluent is None or any(fluents_in(e.condition) for e in others):
            conditions[condition] = None
        else:
            constraints += [outside(problem, condition, e) for e in others]
    kept = tuple(_without_implied(list(conditions)))
    return Compiled(problem.saying(constraints, conditions=kept))


def _still(condition: Condition) -> Expr | None:
    """Return the fluent if the condition says ``f = f`` (or ``f or not f``), else ``None``."""
    expression = condition.expression
    if expression[0] in ("eq", "iff", "le") and expression[1] == expression[2]:
        fluent: Expr = expression[1]
    elif expression[0] == "or" and len(expression) == 3:
        a, b = expression[1:]
        if negation(a) != b:
            return None
        fluent = a[1] if a[0] == "not" else a
    else:
        return None
    return fluent if fluent[0] == "flu" and len(fluent) == 2 else None


def _without_implied(conditions: list[Condition]) -> list[Condition]:
    by_content = grouped(conditions, attrgetter("owner", "expression"))
    return [
        c
        for c in conditions
        if not any(_inside(c, d) for d in by_content[c.owner, c.expression] if d is not c)
    ]


def _inside(c: Condition, d: Condition) -> bool:
    """Return whether the interval of ``c`` is surely a part of that of ``d``."""
    if c.low == d.low and c.high == d.high:
        return False  # the same (kept once, as conditions are a set here)
    begins = c.low == d.low or (c.low[:3] == d.low[:3] and c.low[3] >= d.low[3])
    ends = c.high[:3] == d.high[:3] and c.high[3] <= d.high[3]
    point = c.low == c.high and c.low[1] == "start" and d.high[1:3] == ("end", c.low[2])
    return begins and (ends or (point and d.high[3] >= c.high[3]))


# ------------------ Conditions over intervals that may be empty
# For engines that do not take those as asking nothing.
#
# Where the duration decides whether the interval holds an instant, the condition moves to an
# auxiliary optional activity that spans just the interval and is present if that is not empty.


def compile_intervals(problem: PlainProblem) -> Compiled:
    """Make every interval hold an instant.

    The result is not exact (``Compiled.exact``) where the condition's activity changes the same
    fluent itself: there the interval is just demanded not to be empty. Nor is it where an
    interval may begin before time 0, or be empty towards the plan's end, nor where what is asked
    at an activity's only instant is asked at the start of a longer one, too.
    """
    taken = names_in_use(problem)
    hosts: list[Activity] = []
    conditions: list[Condition] = []
    constraints = list(problem.constraints)
    given = _instants_joined(problem)
    exact = len(given) == len(problem.conditions)
    for condition in given:
        if condition.low[3] < 0 and condition.low[1] in ("start", "end"):
            exact = False  # before 0 the initial value counts; engines refuse such times
        if never_empty(problem, condition):
            conditions.append(condition)
        elif "horizon" in (condition.low[1], condition.high[1]):
            exact = False  # there engines look at an end of an empty interval
            conditions.append(condition)
        elif _changes_itself(problem, condition):
            exact = False
            here = problem.presence(condition.owner)
            constraints.append(implies(here, ("le", condition.low, condition.high)))
            conditions.append(condition)
        else:
            name = fresh(f"span_{condition.owner or 'base'}", taken)
            hosts.append(_host(problem, condition, name))
            constraints += _spans(problem, condition, name)
            conditions.append(replace(condition, low=start(name), high=end(name), owner=name))
    found = replace(
        problem,
        activities=(*problem.activities, *hosts),
        conditions=tuple(conditions),
        constraints=tuple(constraints),
    )
    return Compiled(found, exact=exact)


def _instants_joined(problem: PlainProblem) -> list[Condition]:
    """Return the conditions, with what is asked throughout (start, end] of an activity, and at its
    only instant if it has no length, asked throughout [start, end]: that is stricter.
    """
    given = list(problem.conditions)
    for instant in problem.conditions:
        owner = instant.owner or ""
        later_on = replace(instant, low=start(owner, 1), high=end(owner))
        if (instant.low, instant.high) == (end(owner), start(owner)) and later_on in given:
            given.remove(instant)
            given[given.index(later_on)] = replace(later_on, low=start(owner))
    return given


def _changes_itself(problem: PlainProblem, condition: Condition) -> bool:
    read = {f[1] for f in fluents_in(condition.expression)}
    return any(e.owner == condition.owner and e.fluent[1] in read for e in problem.effects)


def _host(problem: PlainProblem, condition: Condition, name: str) -> Activity:
    """Return an activity that is as long as a condition's interval may be: a million units where
    its owner's duration is not a constant.
    """
    upper = problem.activity(condition.owner).upper if condition.owner else None
    # an open end: no longer than the owner plus what the delays add
    most = abs(condition.low[3]) + abs(condition.high[3])
    length = upper[1] + most if upper is not None and upper[0] == "int" else 10**6
    return Activity(name, True, integer(0), integer(length))


def _spans(problem: PlainProblem, condition: Condition, name: str) -> list[Expr]:
    """State that an activity spans a condition's interval, and is there if that is not empty."""
    here, owner = ("pres", name), problem.presence(condition.owner)
    low, high = condition.low, condition.high
    same = [(start(name), low), (low, start(name)), (end(name), high), (high, end(name))]
    return [
        disjunction([here, negation(owner), ("lt", high, low)]),
        implies(here, conjunction([owner, ("le", low, high)])),
        implies(here, conjunction(("le", a, b) for a, b in same)),
    ]


# ------------------ What engines take for something else, or break down on, and nothing else says


def refuse_times(problem: PlainProblem) -> Compiled:
    """Return the problem if all conditions and effects are at times of who has them, or the plan's,
    and none before its end.

    Raises:
        UnsupportedError: others' times, or times before the plan's end, by name.
    """
    some: list[tuple[str, str | None, Expr]] = [
        *(("condition", c.owner, time) for c in problem.conditions for time in (c.low, c.high)),
        *(("effect", e.owner, e.time) for e in problem.effects),
    ]
    for what, owner, time in some:
        before_end = time[1] == "horizon" and time[3] < 0
        if time[2] not in (None, owner) or (before_end and what == "condition"):
            raise UnsupportedError(f"the {what} of {owner or 'the problem'} at {show(time)}")
    return Compiled(problem)


def refuse_numbers(problem: PlainProblem) -> Compiled:
    """Return the problem if it asks of numbers at instants only.

    Raises:
        UnsupportedError: a condition on a number over an interval, or a number that is both
            assigned and increased or decreased, by name.
    """
    counted = {e.fluent[1]: e.kind != "assign" for e in problem.effects}
    for effect in problem.effects:
        if counted[effect.fluent[1]] != (effect.kind != "assign"):
            raise UnsupportedError(f"fluent {effect.fluent[1]}, both assigned and counted")
    for condition in problem.conditions:
        for fluent in fluents_in(condition.expression):
            number = problem.fluents[fluent[1]].type[0] == "int"
            if number and condition.low != condition.high:
                raise UnsupportedError(
                    f"the condition {show(condition.expression)} of "
                    f"{condition.owner or 'the problem'} over an interval on the number "
                    f"{show(fluent)}"
                )
    return Compiled(problem)
