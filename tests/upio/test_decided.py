"""What is decided of expressions is said: of what is over nothing is left to choose."""

import operator
import random

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    Equals,
    Implies,
    IntType,
    Minus,
    Not,
    Plus,
    Times,
)

from up_samp.upio.restrict import Decided

KINDS = {LE: operator.le, LT: operator.lt, Equals: operator.eq}


def number(rng, numbers, deep=2):
    """Draw an expression of numbers: itself, and its value."""
    if not deep or rng.random() < 0.3:
        return rng.choice(numbers)
    (one, first), (two, second) = (number(rng, numbers, deep - 1) for _ in range(2))
    write, count = rng.choice(((Plus, operator.add), (Minus, operator.sub), (Times, operator.mul)))
    return write(one, two), count(first, second)


def compared(rng, numbers, times):
    """Draw a comparison of a sum with times in it and another one: itself, and whether it held."""
    sides = []
    for some in (times, rng.choice((times, numbers))):
        parts = [rng.choice(some), number(rng, numbers)]
        rng.shuffle(parts)
        (one, first), (two, second) = parts
        write, count = rng.choice(((Plus, operator.add), (Minus, operator.sub)))
        sides.append((write(one, two), count(first, second)))
    rng.shuffle(sides)
    (one, first), (two, second) = sides
    if not one.type.is_time_type():  # UP compares times with numbers, not numbers with times
        return Not(LT(two, one)), not second < first
    write = rng.choice([*KINDS])
    return write(one, two), KINDS[write](first, second)


@pytest.mark.parametrize("first", range(0, 300, 100))
def test_what_is_over_held_or_did_not(first):
    for seed in range(first, first + 100):
        rng = random.Random(f"decided {seed}")
        problem, exact, known, times = SchedulingProblem(f"s{seed}"), {}, {}, []
        m = problem.environment.expression_manager
        numbers = [(m.Int(k), k) for k in (-2, 0, 1, 3)]
        for name in rng.sample(("a", "b", "c"), 3):
            activity = problem.add_activity(name, 3)
            start = rng.choice((0.0, 1.0, 2.25, 2.5))
            exact[name] = start, start + rng.choice((3.0, 3.25, 4.75))
            points = m.auto_promote(activity.start, activity.end)
            times += zip(points, exact[name], strict=True)
            told, value = activity.add_parameter("v", IntType(-5, 5)), rng.randint(-5, 5)
            known[told.name] = m.Int(value)
            numbers.append((m.ParameterExp(told), value))
        fix = Decided(
            problem.environment, absent=set(), lost=set(), present=set(), values=known,
            exact=exact, shift=9,
        )  # fmt: skip
        (one, first_held), (two, then_held) = (compared(rng, numbers, times) for _ in range(2))
        assert fix(one).constant_value() == first_held, one
        assert fix(Implies(one, two)).constant_value() == (not first_held or then_held)
        assert fix(And(two, Not(one))).constant_value() == (then_held and not first_held)
