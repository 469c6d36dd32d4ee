"""Rooms behind doors, with ways from place to place within them: what is recognised changes no
answer, whether doors stay open or are shut again.
"""

import itertools
import random

import pytest
from unified_planning.model import ClosedTimeInterval, GlobalStartTiming, TimePointInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    BoolType,
    Equals,
    Fluent,
    MinimizeMakespan,
    UserType,
)

from tests.scheduling.cpsat.truth import disagreement
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes

FEW = (1, 2, 3, 4, 6, 7)
HARD = (0, 5)
"""They take seconds, where others take a tenth of one."""


def rooms(seed):
    """Return travellers in a hall with buttons, and rooms of two or three places behind doors."""
    r = random.Random(seed)
    problem = SchedulingProblem(f"rooms{seed}")
    kind = UserType("place")
    doors, travellers = range(r.choice([1, 1, 1, 2])), range(r.choice([1, 1, 1, 2]))
    room_of = {"hall": None, **{f"button{d}": None for d in doors}}
    room_of |= {f"r{d}_{i}": d for d in doors for i in range(r.choice([2, 2, 3]))}
    places = {
        name: problem.add_object(name, kind) for name in r.sample(sorted(room_of), len(room_of))
    }
    is_open = [Fluent(f"open{d}", BoolType()) for d in doors]
    for d in doors:
        problem.add_fluent(is_open[d], default_initial_value=r.random() < 0.15)
    apart = {p: r.randint(0, 9) for p in sorted(room_of)}
    for t in travellers:
        _travel(problem, r, t, (places, room_of, is_open, apart))
    for d in doors:
        if r.random() < 0.4:  # by itself, for a while
            since = r.randint(1, 6)
            problem.add_effect(GlobalStartTiming(since), is_open[d](), True)
            problem.add_effect(GlobalStartTiming(since + r.randint(6, 14)), is_open[d](), False)
    problem.add_quality_metric(MinimizeMakespan())
    problem._activities[:] = r.sample(problem._activities, len(problem._activities))
    return problem


def _travel(problem, r, t, floor):
    """Add what one traveller may do."""
    places, room_of, is_open, apart = floor
    kind = next(iter(places.values())).type
    at, hands = Fluent(f"at{t}", kind), problem.add_resource(f"hands{t}", 1)
    start = r.choice(["hall", r.choice(sorted(room_of))])
    problem.add_fluent(at, default_initial_value=places[start])
    for a, b in itertools.permutations(sorted(room_of), 2):
        if r.random() < 0.08:
            continue
        move = problem.add_activity(
            f"move{t}_{a}_{b}", duration=1 + abs(apart[a] - apart[b]), optional=True
        )
        move.uses(hands)
        move.add_condition(TimePointInterval(Timing(0, move.start)), Equals(at(), places[a]))
        move.add_effect(move.end, at(), places[b])
        crossed = {room_of[a], room_of[b]} - {None} if room_of[a] != room_of[b] else set()
        for d in sorted(crossed):
            span = ClosedTimeInterval(Timing(0, move.start), Timing(0, move.end))
            move.add_condition(span, is_open[d]())
    for d, value in itertools.product(range(len(is_open)), (True, False)):
        if not value and r.random() < 0.6:
            continue
        change = problem.add_activity(f"{'open' if value else 'shut'}{d}_{t}", 1, optional=True)
        change.uses(hands)
        there = TimePointInterval(Timing(0, change.start))
        change.add_condition(there, Equals(at(), places[f"button{d}"]))
        change.add_effect(change.end, is_open[d](), value)
    inner = [place for place, room in sorted(room_of.items()) if room is not None]
    for k, place in enumerate(r.choices([*inner, *inner, *sorted(room_of)], k=r.randint(1, 3))):
        work = problem.add_activity(f"work{t}_{k}", r.randint(1, 4))
        work.uses(hands)
        work.add_condition(TimePointInterval(Timing(0, work.start)), Equals(at(), places[place]))


def check(seeds):
    told, wrong = 0, {}
    for seed in seeds:
        problem = rooms(seed)
        wrong[seed], _ = disagreement(problem)
        told += any(route.entries for route in find_routes(ScheduleModel(problem)))
    assert not {seed: what for seed, what in wrong.items() if what}
    assert told > len(seeds) // 8


def test_rooms_whose_doors_are_recognised_change_no_answer():
    check(FEW)


@pytest.mark.long
@pytest.mark.parametrize("seeds", [HARD, *(range(k, k + 100) for k in range(1000, 2000, 100))])
def test_many_rooms_whose_doors_are_recognised_change_no_answer(seeds):
    check(seeds)
