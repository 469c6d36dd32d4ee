"""Jobs that begin at once are assigned to robots of their own, and done in one order by all."""

import pytest

from tests.fleet.test_rules import one_room
from tests.search.fleet.guesses import along_the_axes, assigned
from tests.shuffled import shuffled
from tests.usual import usually
from up_samp.fleet.build import write_problem
from up_samp.search.fleet.assignment import in_stated_order
from up_samp.search.fleet.jobs import find_jobs
from up_samp.upio import read_problem


def pairs(robots, seed, folder):
    """A hall with three pairs of orders, each carried together, and one that is carried alone."""
    fleet = one_room(robots=robots)
    fleet.add_place("d", 12, 3)
    for number in range(3):
        fleet.add_order(f"a{number}", "a", "c")
        fleet.add_order(f"b{number}", "b", "d", together=f"a{number}")
    fleet.add_order("alone", "a", "d")
    problem = shuffled(write_problem(fleet.records, folder).problem, seed, rename=False).problem
    snapshot = read_problem(problem)
    return find_jobs(problem, snapshot), snapshot


def name_of(jobs, job):
    return jobs.options[job][0].leader.split("_")[1]


@pytest.mark.parametrize("seed", usually(0, 2, of=range(4)))
def test_no_robot_does_two_of_a_crew(seed, tmp_path):
    jobs, snapshot = pairs(2 + seed % 2, seed, tmp_path)
    crews = {}
    for job, crew in jobs.crews.items():
        crews.setdefault(crew, set()).add(name_of(jobs, job))
    assert sorted(map(sorted, crews.values())) == [[f"a{n}", f"b{n}"] for n in range(3)]
    assignment = in_stated_order(
        assigned(jobs, snapshot, along_the_axes, seed=seed), {}, jobs.crews
    )
    orders = [
        [jobs.crews[job] for job, _ in tour if job in jobs.crews]
        for tour in assignment.tours.values()
    ]
    assert sum(map(len, orders)) == 6
    for order in orders:
        assert len(set(order)) == len(order)
    # nobody waits for somebody who waits for them
    for one in orders:
        for other in orders:
            both = set(one) & set(other)
            assert [c for c in one if c in both] == [c for c in other if c in both]
