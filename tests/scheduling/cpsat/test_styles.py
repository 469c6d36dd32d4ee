"""How a problem is written changes neither its optimum nor what is recognised in it."""

import pytest

from tests.scheduling.cpsat.sites import Site, shop, small, store
from tests.scheduling.cpsat.styles import LOOSE, SPOILED, TIGHT, Style
from tests.scheduling.cpsat.truth import answer, bound_without_search
from tests.scheduling.cpsat.writer import write
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_tasks

ALL = [*TIGHT, *LOOSE]


def disagreements(seed, styles):
    """Return style -> what differs from the truth, on the small site of a seed."""
    site, found, wrong = small(seed), {}, {}
    for style in styles:
        problem = write(site, style)
        truth = answer(problem, plain=True)
        mine = answer(problem)
        if truth is None or mine is None:
            continue
        if mine != truth:
            wrong[str(style)] = f"{mine}, but in truth {truth}"
        if found.setdefault(style.units, truth) != truth:
            wrong[str(style)] = f"{truth}, but in other styles {found[style.units]}"
        quick = bound_without_search(problem)
        if quick is not None and truth[1] is not None and quick > truth[1]:
            wrong[str(style)] = f"bound by work {quick} above {truth[1]}"
    return wrong


@pytest.mark.parametrize("seed", range(3))
def test_every_style_of_a_small_site_has_the_same_optimum(seed):
    assert disagreements(seed, [*ALL, *SPOILED][seed % 3 :: 3]) == {}


def test_small_sites_with_doors_are_solved_as_they_are_written():
    sites = {seed: small(seed) for seed in range(40, 70)}
    for seed in (seed for seed, site in sites.items() if site.doors):
        assert disagreements(seed, [Style()]) == {}, seed


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_every_style_of_many_small_sites_has_the_same_optimum(block):
    for seed in range(100 + 5 * block, 105 + 5 * block):
        assert disagreements(seed, [*ALL, *SPOILED]) == {}, seed


def each_fifth(styles):
    """Return styles as parameters; four of five only where the slow tests are run, too."""
    slow = [pytest.mark.long]
    return [pytest.param(s, id=str(s), marks=slow if i % 5 else []) for i, s in enumerate(styles)]


@pytest.mark.parametrize("style", each_fifth(ALL))
def test_routes_are_found_in_every_style(style):
    """Each robot is a traveller whose stops are its tasks and door openings."""
    # moves that may each take any road are many
    for site in (shop(2, 1, 1 if style.moves == "go" else 2), store(2, 2)):
        problem = write(site, style)
        model = ScheduleModel(problem)
        routes = find_routes(model)
        roads = [{(*m.origins, m.to) for m in r.moves} for r in routes]
        assert [len(some) for some in roads] == [len(site.ways(r)) for r in range(2)]
        assert all(len(r.stops) == len(site.tasks) + len(site.doors) for r in routes)
        assert all((r.step, r.gap) == style.units[:2] for r in routes)
        assert all(len(r.entries) == len(site.doors) for r in routes)
        assert len(model.exact) == 2 * len(site.tasks)
        tasks = find_tasks(model, routes)
        # whoever opens it, and whatever says that it is busy, a door is opened once
        openings = [t for t in tasks if not t.wanted]
        assert all(len(t.ways) == 2 for t in openings)
        assert len(openings) == len(site.doors)


@pytest.mark.parametrize("step", [pytest.param(2, marks=pytest.mark.long), 4])
def test_a_shop_is_proven_optimal_in_every_style(step):
    site, makespans = shop(2, 2, 1), {}
    # moves that may each take any road can be exchanged, so a proof takes long
    for style in [s for s in ALL if s.moves != "go"][::step]:
        report = CpsatSession(write(site, style), workers=1).solve(Deadline.after(60))
        assert report.status is ScheduleStatus.OPTIMAL, str(style)
        makespans.setdefault(style.units, set()).add(report.schedule.makespan)
    assert all(len(some) == 1 for some in makespans.values())
    assert min(makespans[0, 0, 0, 0, 0, 0]) < min(makespans[1, 1, 1, 1, 0, 0])


def test_a_tight_style_loses_no_unit_where_a_loose_one_does():
    site = store(1, 1)
    tight, loose = (
        CpsatSession(write(site, style), workers=1).solve(Deadline.after(60)).schedule.makespan
        for style in (Style(), Style(arrive="end"))
    )
    assert 0 < loose - tight <= len(site.roads)


def test_who_only_has_to_come_somewhere_is_on_a_route():
    """Doors one behind the other: nothing happens at the goals, and only moves need the doors."""
    roads = {(0, 1): 4, (1, 2): 3, (2, 3): 5, (0, 4): 2, (2, 5): 2, (5, 3): 1}
    roads |= {(b, a): length for (a, b), length in roads.items()}
    site = Site((0, 0), roads, (), {1: 4, 3: 5}, visits={0: 3, 1: 3})
    makespans = set()
    for style in (Style(), Style(alone="uses"), Style(fluents="precedences")):
        problem = write(site, style)
        model = ScheduleModel(problem)
        routes = find_routes(model)
        assert [len(route.visits) for route in routes] == [1, 1]
        report = CpsatSession(problem, workers=1).solve(Deadline.after(60))
        assert report.status is ScheduleStatus.OPTIMAL
        assert set(report.schedule.times) <= {a.name for a in problem.activities}
        makespans.add(report.schedule.makespan)
    # one opens the first door (2, 1), goes back (2) and all the way in (4, 3, 2, 1)
    assert makespans == {15}
