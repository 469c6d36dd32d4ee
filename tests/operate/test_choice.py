"""Who is planned with whom: robots that stand where others go, and more where no plan was found."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from tests.operate.sites import hall
from up_samp.operate.choice import Day, choose
from up_samp.operate.clock import SimulatedClock
from up_samp.operate.records import DayOrder, OrderState, Settings, job_record


class Standing(Day):
    """Robots that stand, all of them free; ``stuck``: r0 is not at home."""

    def __init__(self, fleet, stuck=False):
        self.settings, self.clock, self.site = Settings(), SimulatedClock(), fleet.records
        self.poses = {r: self._home(robot.start) for r, robot in self.site.robots.items()}
        self.meanings, self.jobs, self.away, self.placed = {}, {}, {}, {}
        self.using = {}
        self.shut, self.aside, self.tried, self.areas = {}, {}, {}, {}
        self.cramped = set()
        self.stuck, self.carrying, self.ends = stuck, {}, {}

    def stranded(self):
        return ["r0"] if self.stuck else []

    def dropped(self):
        return []

    def cut(self, opened=None):
        poses = self.ends or self.poses
        return SimpleNamespace(carrying=self.carrying, poses=poses, free={}, jobs=())

    def take(self, name, state=OrderState.WAITING, **options):
        record = job_record({"id": name, "pickup": "rack0", "delivery": "dock0", **options})
        self.jobs[name] = DayOrder(record, 0.0, state)


@pytest.mark.parametrize("stuck", [False, True])
def test_so_many_more_are_planned_each_time_that_no_plan_was_found_and_then_fewer_again(
    tmp_path, stuck
):
    day, found = Standing(hall(tmp_path, 7), stuck), []
    if not stuck:
        day.take("o0")
    for _ in range(2 * day.settings.most + 3):
        found.append(len(choose(day).beside))
        day.put_aside([*day.jobs], [*day.site.robots])
    assert found[: day.settings.most + 2] == [0, 1, 2, 3, 0]
    assert max(found) <= day.settings.most


def test_who_stands_where_a_stranded_robot_brings_its_order_is_planned_with_it(tmp_path):
    day = Standing(hall(tmp_path, 4), stuck=True)
    assert not choose(day).beside
    day.poses["r2"] = day.site.places["dock0"].pose
    assert not choose(day).beside  # it goes home only
    day.take("o0", OrderState.BEGUN)
    day.carrying = {"o0": "r0"}
    assert choose(day).beside == ("r2",)


def test_who_only_passes_where_an_order_goes_is_not_planned_with_it(tmp_path):
    """It is free there, once it has done its own order, and drives home at once."""
    day = Standing(hall(tmp_path, 4))
    day.take("o0", robots=["r0"])
    day.ends, day.poses = day.poses, {**day.poses, "r2": day.site.places["dock0"].pose}
    assert not choose(day).beside
    day.ends = {}
    assert choose(day).beside == ("r2",)


@pytest.mark.parametrize("order", [1, -1])
def test_two_that_were_planned_in_vain_are_planned_alone_at_once_each(tmp_path, order):
    day = Standing(hall(tmp_path, 4))
    pair = ["r0", "r1"][::order]
    day.stranded = lambda: pair
    day.again = math.inf  # what is put aside waits

    def turns():
        found = choose(day)
        return [] if found is None else [r for r in found.opened if r not in found.beside]

    assert turns() == pair
    day.put_aside([], pair)
    assert turns() == pair[1:]
    day.put_aside([], pair[1:])
    assert turns() == pair[:1]
    day.put_aside([], pair[:1])
    assert turns() == []
    day.aside.clear()
    assert turns() == pair


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"due": 100.0, "pickup": "rack2"}, {"due": 101.0}),  # however far it is
        ({"due": 100.0, "weight": 3.0}, {"due": 40.0}),
        ({"due": 100.0}, {"due": 40.0, "weight": 0.3}),
        ({"due": 500.0}, {}),
        ({}, {"due": 700.0}),
        ({"priority": 1}, {"due": 1.0}),
        ({"pickup": "rack2"}, {}),  # it came first
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_the_most_urgent_order_is_next(tmp_path, one, other, turned):
    day = Standing(hall(tmp_path, 1))
    orders = [("one", one), ("other", other)]
    for name, options in reversed(orders) if turned else orders:
        day.take(name, **options)
    day.jobs["other"] = replace(day.jobs["other"], came=1e-3)
    assert choose(day).jobs == (day.jobs["one"],)
