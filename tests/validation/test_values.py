"""Values of expressions: leaving out what decides nothing changes no value."""

import random

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import LE, And, Iff, Implies, Not, Or

from up_samp.validation.timeline import MISSING, Decisions, Reader


def formula(rng, activities, depth):
    """Return a random formula over presences and times."""
    if depth == 0 or rng.random() < 0.2:
        a, b = rng.choice(activities), rng.choice(activities)
        return a.present if rng.random() < 0.3 else LE(a.end, b.start)
    parts = [formula(rng, activities, depth - 1) for _ in range(rng.randint(2, 3))]
    kind = rng.choice((And, Or, And, Or, Not, Implies, Iff))
    if kind is Not:
        return Not(parts[0])
    return kind(*parts[:2]) if kind in (Implies, Iff) else kind(*parts)


@pytest.mark.parametrize("seed", range(10))
def test_hasty_readers_give_the_same_values(seed):
    rng = random.Random(seed)
    problem = SchedulingProblem("values")
    activities = [problem.add_activity(f"a{i}", 2, optional=True) for i in range(4)]
    seen = set()
    for _ in range(60):
        there = [a.name for a in activities if rng.random() < 0.6]
        times = {name: (start, start + 2) for name in there for start in (rng.randint(0, 6),)}
        decisions = Decisions(times, {}, {})
        node = formula(rng, activities, 3)
        values = [Reader(decisions, {}.__getitem__, hasty=h).value(node) for h in (False, True)]
        assert values[0] is values[1]
        seen.add(values[0])
    assert seen == {True, False, MISSING}
