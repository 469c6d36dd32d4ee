"""What is surely done on no route (machines that prepare for visits) binds visits, and what that
tells of bounds is never above the optimum.
"""

import itertools
import random

import pytest
from unified_planning.shortcuts import GE, LE, Or, Plus

from tests.scheduling.cpsat.fleets import Fleet, FleetWriter, random_fleet
from tests.scheduling.cpsat.truth import answer, bound_without_search
from up_samp.model import ScheduleStatus
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_tasks

LINE = Fleet((3, 30), (9, 21), (2, 2), ((0, 1), (0, 1)), alone="uses")


class Prepared(FleetWriter):
    """A fleet of which visits hang on machines: each is done from ``opens`` after the start of its
    preparation to ``closes`` after it, and preparations are done one at a time, ``gap`` apart.
    """

    def prepare(self, visit, length, opens, closes, *, of=None):
        made = self.problem.add_activity(f"{self.names.pop()}_prepare", length)
        for one in self.listed(self.visits[visit])[:of]:
            here = [one.present]
            self.problem.add_constraint(LE(Plus(made.start, opens), one.start), here)
            if closes is not None:
                self.problem.add_constraint(LE(one.end, Plus(made.start, closes)), here)
        return made

    def in_turn(self, some, gap):
        for a, b in itertools.combinations(self.listed(some), 2):
            ways = [LE(Plus(a.end, gap), b.start), GE(a.start, Plus(b.end, gap))]
            self.problem.add_constraint(Or(self.listed(ways)))


def drawn(seed):
    """Return a fleet whose visits hang on machines, some of them loosely."""
    r = random.Random(seed)
    writer = Prepared(random_fleet(seed, robots=2, visits=3), seed)
    made = []
    for visit in writer.visits:
        if r.random() < 0.8:
            opens = r.randint(0, 8)
            closes = r.choice([None, opens + r.randint(4, 20)])
            of = None if r.random() < 0.8 else 1
            made.append(writer.prepare(visit, r.randint(0, 25), opens, closes, of=of))
    if r.random() < 0.7:
        writer.in_turn(made, r.choice([0, 0, 1]))
    return writer.problem


def wrong(seed):
    """Return (answer, bound, truth) where they do not agree."""
    truth = answer(drawn(seed), plain=True)
    told, bound = answer(drawn(seed)), bound_without_search(drawn(seed))
    if truth is None:
        return None
    above = bound is not None and truth[1] is not None and bound > truth[1]
    return (told, bound, truth) if above or told not in (None, truth) else None


def test_visits_of_machines_in_turn_are_apart():
    writer = Prepared(LINE, 0)
    writer.in_turn([writer.prepare(v, 30, 10, 20) for v in writer.visits], 0)
    model = ScheduleModel(writer.problem)
    one, other = find_tasks(model, find_routes(model))
    # a visit begins 8 after its preparation at least, and 18 at most; the next is 30 later
    assert {gap for _, gap in one.apart + other.apart} == {30 + 10 - 18 - 2}
    assert one.tail == other.tail == 30 - 18
    assert (one.queues, other.queues) == ([(30 - 18, {1: 30})], [(30 - 18, {0: 30})])
    assert answer(writer.problem) == answer(writer.problem, plain=True)
    # the first visit begins when somebody has come: 9 - 3 + 1, and two preparations end after it
    assert bound_without_search(writer.problem) == 7 + 12 + 30


def test_what_comes_between_two_visits_keeps_them_apart():
    writer = Prepared(LINE, 0)
    later = writer.prepare(1, 12, 12, None)
    for one in writer.visits[0]:
        writer.problem.add_constraint(LE(one.end, later.start), [one.present])
    bound = bound_without_search(writer.problem)
    assert answer(writer.problem) == (ScheduleStatus.OPTIMAL, bound)


def test_bounds_of_fleets_with_machines():
    assert not {seed: found for seed in range(5) if (found := wrong(seed))}


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_bounds_of_many_fleets_with_machines(block):
    seeds = range(100 + 60 * block, 160 + 60 * block)
    assert not {seed: found for seed in seeds if (found := wrong(seed))}
