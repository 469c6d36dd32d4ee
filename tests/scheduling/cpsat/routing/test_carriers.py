"""What robots carry and set, in sequences of tasks and quick schedules: bounds stay true."""

import pytest

from tests.scheduling.cpsat.carriers import carriers
from tests.scheduling.cpsat.routing.test_sequences import compare
from up_samp.fleet import Fleet
from up_samp.fleet.files import write_starter
from up_samp.model import Deadline
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import improve
from up_samp.scheduling.cpsat.routing.needs import later_than
from up_samp.scheduling.cpsat.routing.workload import bound_by_work
from up_samp.upio import read_problem, relax


def some(seeds, **drawn):
    return ((seed, carriers(seed, **drawn)) for seed in seeds)


def test_bounds_of_carriers():
    met, count = compare(some(range(12)))
    assert count == 12
    assert met >= 7


def test_bounds_of_carriers_with_odd_forks():
    _, count = compare(some(range(1000, 1012), odd=True))
    assert count >= 6


def test_gaps_add_up_also_where_some_are_less_than_nothing():
    gaps = {1: {2: -5, 4: 1}, 2: {3: 7}, 4: {3: 3}, 3: {1: -20}}
    assert later_than(gaps, 1) == {2: -5, 4: 1, 3: 4}
    assert later_than({1: {2: -5}, 2: {3: 7}}, 1) == {2: -5, 3: 2}


def test_the_starter_is_bounded_and_drawn_without_search(tmp_path):
    """Two robots, three orders: who picks one up delivers it, one at a time."""
    files = write_starter(tmp_path)
    problem = Fleet.from_file(files[0]).problem
    model = ScheduleModel(relax(problem, read_problem(problem)).problem)
    work = find_work(model, find_routes(model))
    assert work is not None
    assert len(work.own) == 2
    tour = improve(work, 300, 0, Deadline.never())
    bound = bound_by_work(work).value
    assert bound <= tour.schedule.makespan <= 1.5 * bound
    times = tour.schedule.times
    picks = {name: times[name] for name in times if name.startswith("pick")}
    assert len(picks) == 3
    for name, (_, end) in picks.items():
        assert end <= times[name.replace("pick", "deliver")][0]


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_many_bounds_of_carriers(block):
    compare(some(range(2000 + 100 * block, 2100 + 100 * block), odd=block % 2 == 1))
