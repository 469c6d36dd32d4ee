"""What is left of a plan asks of what has begun, and of what is over, what the whole problem asks:
schedules of the rest keep its rules exactly if, with what has happened, they keep the problem's.
"""

import random
from fractions import Fraction

import pytest
from unified_planning.shortcuts import GE, LE, LT, Implies, Not, Or, Plus

from tests.execution import floors
from up_samp.execution import Delays, Executor, dependencies_of
from up_samp.execution.simulate import Floor
from up_samp.execution.state import TaskPhase
from up_samp.validation.schedule import judge_decisions
from up_samp.validation.timeline import Decisions


def bounded(rng, problem, spans):
    """Ask more of starts and ends, all of which the plan keeps, with some seconds to spare."""
    names = rng.sample(sorted(spans), len(spans))
    points = [(getattr(problem.get_activity(n), side), spans[n][k])
              for n in names for k, side in enumerate(("start", "end"))]  # fmt: skip
    for _ in range(rng.randint(6, 12)):
        (one, first), (two, then) = rng.sample(points, 2)
        gap, room = then - first, rng.choice((0, 1, 5))
        asked = rng.choice((
            GE(two, Plus(one, gap - room)), LE(Plus(one, gap - room), two),
            LE(two, Plus(one, gap + room + 6)), Not(LT(Plus(one, gap + room + 6), two)),
            GE(two, then - room), LE(two, then + room + 6), LT(Plus(one, gap - room - 1), two),
        ))  # fmt: skip
        never = LT(two, rng.choice((0, -3)))
        problem.add_constraint(
            rng.choice((asked, asked, Or(never, asked), Implies(Not(never), asked)))
        )
    for activity in problem.motion_activities:
        start, end = spans[activity.name]
        if rng.random() < 0.7:
            activity.set_duration_bounds(max(1, end - start - rng.choice((0, 1))), 400)


def verdicts(problem, times, without=(), instant=1, ticks=1):
    """The constraints that times (start, end; units) break, and the durations of all but some."""
    spans = {n: tuple(Fraction(round(t * ticks), ticks) for t in pair) for n, pair in times.items()}
    found, _ = judge_decisions(problem, Decisions(spans, {}, {}, instant))
    broken = [v for v in found.violations if v.kind in ("constraint", "duration")]
    return [v for v in broken if v.node is not None or not set(v.about) & set(without)]


def half_done(rng, seed, yaml):
    """Return what has been carried out of a plan of which more is asked, all of it shuffled."""
    problem, plan = floors.rounds(seed, yaml)
    bounded(rng, problem, {a["name"]: (a["start"], a["end"]) for a in plan["activities"]})
    for listed in (problem._activities, problem._motion_activities, problem._base._constraints):
        rng.shuffle(listed)
    executor = Executor(plan, problem, dependencies=dependencies_of(problem, plan))
    delays = Delays(slow=rng.choice((0, 0.4)), late=rng.choice((0, 0.4)))
    floor, until = Floor(executor, delays, seed), rng.uniform(0.1, 0.9) * plan["makespan"]
    while floor.goes_on and floor.now < until:
        floor.step()
    return executor


def drawn(rng, executor, left):
    """Return a schedule of what is left: the plan's, later, and a little otherwise."""
    later, found = rng.choice((0, 0, 1, 2, 4)), {}
    moved = rng.sample(sorted(executor.state.phase), 2)
    planned = {a["name"]: (a["start"], a["end"]) for a in executor.plan["activities"]}
    for activity in left.problem.activities:
        name, (start, end) = activity.name, planned[activity.name]
        other = rng.choice((-3, -1, 1, 2)) if name in moved else 0
        if executor.phase(name) is TaskPhase.WAITING:
            first = max(0, start - left.since + later + other)
            found[name] = first, first + max(1, end - start + rng.choice((0, other)))
        elif executor.state.ways_of[name]:
            found[name] = 0, max(1, end - left.since + other)
        else:  # how long it goes on is known
            found[name] = 0, activity.duration.lower.constant_value()
    return found


def differing(seed, yaml, tries=60):
    """Return where rules that schedules of the rest break are more or fewer than with what has
    happened those of the problem, and how many schedules break none.
    """
    rng = random.Random(f"begun {seed}")
    executor = half_done(rng, seed, yaml)
    problem, left, over = executor.problem, executor.remaining_problem(), executor.times()
    done = {n for n in over if executor.phase(n) is TaskPhase.DONE}
    at_work = {n for n in over if not executor.state.ways_of[n]}
    dropped = [note for note in left.notes if note.startswith("already broken")]
    found, kept = [], 0
    for _ in range(tries):
        new = drawn(rng, executor, left)
        whole = {n: over[n] for n in done}
        for name, (start, end) in new.items():
            began, _ = over.get(name, (start + left.since, None))
            whole[name] = began, end + left.since
        of_rest = verdicts(left.problem, new)
        of_all = verdicts(problem, whole, done | at_work, Fraction(1, 1000), 1000)
        of_all = [v for v in of_all if not any(str(v.node) in note for note in dropped)]
        kept += not of_rest
        if len(of_rest) != len(of_all):
            found.append((left.since, new, [str(v) for v in (*of_rest, *of_all)]))
    return found, kept


def test_the_rest_asks_of_what_has_begun_what_the_problem_asks(yaml):
    rows = [differing(seed, yaml) for seed in (6, 18)]
    assert [found for found, _ in rows] == [[]] * 2
    assert any(kept for _, kept in rows)


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 200, 20))
def test_many_rests_ask_of_what_has_begun_what_the_problems_ask(yaml, first):
    rows = [differing(seed, yaml) for seed in range(first, first + 20)]
    assert [found for found, _ in rows] == [[]] * 20
    assert sum(kept for _, kept in rows) > 20
