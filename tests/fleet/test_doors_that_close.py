"""Fleets behind doors that close by themselves: somebody has to open them again and again."""

import itertools

import pytest
from shapely.geometry import box

from tests.shuffled import shuffled_fleet
from tests.usual import usually
from up_samp.fleet import Fleet
from up_samp.fleet.files import write_problem_file
from up_samp.fleet.importers import map_from_polygons
from up_samp.scheduling.cpsat.routing import list_scheduling
from up_samp.validation import validate_plan


def hall(folder, walls):
    """A hall of 18 m x 8 m, with a wall (x) at each of ``walls`` and a gap in the midst of each."""
    free = box(0, 0, 18, 8)
    for x in walls:
        free = free.difference(box(x - 0.2, 0, x + 0.2, 3)).difference(box(x - 0.2, 5, x + 0.2, 8))
    return map_from_polygons(free, folder, "hall", 0.1)


def site(folder, walls, jobs, *, robots=2, closes=20, times=3, apart=False):
    """Robots on the left (``apart``: by turns on either side), a door in each wall with a button on
    either side of it, and orders from stand to stand: ``l0``, ``l1`` on the left, ``r0``, ``r1`` on
    the right.
    """
    fleet = Fleet(hall(folder, walls))
    fleet.add_robot_type("agv", (0.9, 0.6), model="omni", v_max=1.5, a_max=1.0, omega_max=1.5)
    for i in range(robots):
        x = 16.8 if apart and i % 2 else 1.2
        fleet.add_place(f"home{i}", x, 1.2 + 2.4 * i)
        fleet.add_robot(f"bot{i}", "agv", f"home{i}")
    for name, x in (("l", 4.0), ("r", 15.0)):
        fleet.add_place(f"{name}0", x, 1.5)
        fleet.add_place(f"{name}1", x, 6.5)
    for k, x in enumerate(walls):
        buttons = [f"{side}{k}" for side in ("before", "behind")]
        for button, beside in zip(buttons, (-1.2, 1.2), strict=True):
            fleet.add_place(button, x + beside, 6.0)
        ends = {"closed": (x, 4, 0), "open": (x, 6.5, 0), "opened_from": buttons}
        fleet.add_door(f"gate{k}", (0.4, 1.9), **ends, closes=closes, times=times)
    for k, (pickup, delivery) in enumerate(jobs):
        fleet.add_order(f"o{k}", pickup, delivery)
    return fleet


SITES = {
    "two rooms": ((9.0,), [("l0", "r0"), ("l1", "r1")], {}),
    "both ways": ((9.0,), [("l0", "r0"), ("r1", "l1"), ("l1", "r1")], {"apart": True}),
    "two doors in line": ((7.0, 11.5), [("l0", "r0"), ("l1", "r1")], {"closes": 25}),
}


SITES["two rooms, more jobs"] = ((9.0,), [*SITES["two rooms"][1], ("l0", "r1")], {})
USUAL = [("two rooms", 1), ("both ways", 1)]


@pytest.mark.parametrize(("name", "seed"), usually(*USUAL, of=itertools.product(SITES, (0, 1))))
def test_somebody_opens_a_door_that_closes_for_whoever_comes(tmp_path, monkeypatch, name, seed):
    """However a site is listed: by tours, without a search of the whole for a first schedule."""
    walls, jobs, options = SITES[name]
    fleet = site(tmp_path, walls, jobs, **options)
    told = shuffled_fleet(fleet.records, seed, rename=False).records
    again = Fleet.from_file(write_problem_file(tmp_path / "again.yaml", told))
    found = []
    realize = list_scheduling.improve

    def improve(work, *args, **more):
        tour = realize(work, *args, **more)
        found.append((bool(work.set_back), tour is not None))
        return tour

    monkeypatch.setattr("up_samp.scheduling.cpsat.solve.strategy.improve", improve)
    result = again.solve(timeout=600, first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(again.problem, result.plan, seconds_per_unit=1.0).valid
    assert (True, True) in found
    opened = [a["name"] for a in result.data["activities"] if a["name"].startswith("open_")]
    assert opened
