"""Zones that so many robots may be in at a time: kept over a day, judged by what was driven."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.operate.days import Day
from tests.operate.sites import hall
from up_samp import Fleet
from up_samp.execution.floor import Delays, Drive
from up_samp.execution.graph import At, Event
from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError
from up_samp.operate.judge import crowded
from up_samp.operate.simulated import Mishaps
from up_samp.operate.zones import ZoneVisit, _in_rooms, _one_by_one, still_counted

MIDDLE = [(7.0, 0.3), (17.5, 0.3), (17.5, 13.7), (7.0, 13.7)]
"""Across the hall, with its rows of shelves."""


@pytest.mark.long
@pytest.mark.parametrize("most", [1, 2])
def test_no_more_robots_are_in_a_zone_than_it_takes(tmp_path, most):
    fleet = hall(tmp_path, 3)
    fleet.add_zone("middle", MIDDLE, max_robots=most)
    day = Day(tmp_path, fleet=fleet, mishaps=Mishaps(Delays(0.3, 0.6, 5.0, 0.0, 0.3, noise=0.02)))
    try:
        for k in range(3):
            day.order(f"o{k}", f"rack{k}", f"dock{k}", robots=[f"r{k}"])
        day.run(900)
        day.robots.close()
        assert day.verdict().good, day.story()
        assert {day.state(f"o{k}") for k in range(3)} == {"done"}
        zone = replace(day.fleet.records.zones["middle"], max_robots=most - 1)
        site = replace(day.fleet.records, zones={"middle": zone})
        assert list(crowded(site, day.robots.initial, day.robots.drives))  # so many were in it
    finally:
        day.operation.close()


def visit(robot, since, until, enters=True, leaves=True):
    return ZoneVisit(
        robot, since, until,
        Event(At.LEAVE, f"{robot} {since}", robot, 1.0) if enters else None,
        Event(At.REACH, f"{robot} {since}", robot, 2.0) if leaves else None,
    )  # fmt: skip


class Draft:
    """Holds what is put into it."""

    def __init__(self):
        self.edges = []

    def put(self, edge):
        self.edges.append((edge.first, edge.then))


def test_where_one_fits_either_may_go_first_unless_it_is_there_already():
    there = visit("r0", -math.inf, 3.0, enters=False)
    one, two, again = visit("r1", 4.0, 6.0), visit("r2", 7.0, 9.0), visit("r1", 10.0, 12.0)
    draft = Draft()
    choices = list(_one_by_one(draft, [there, one, two, again], "zone"))
    assert {e[0] for e in draft.edges} == {there.leaves}
    assert [v.enters for v in (one, two, again)] == [e[1] for e in draft.edges]
    assert [tuple((w.first, w.then) for w in c) for c in choices] == [
        ((one.leaves, two.enters), (two.leaves, one.enters)),
        ((two.leaves, again.enters), (again.leaves, two.enters)),
    ]


def test_nobody_comes_into_a_zone_that_never_gets_room_again():
    stays = visit("r0", 2.0, math.inf, leaves=False)
    with pytest.raises(ProblemError, match="'r1' and 'r0' would be in one: zone"):
        list(_one_by_one(Draft(), [stays, visit("r1", 4.0, 6.0)], "zone"))
    with pytest.raises(ProblemError, match="'r2' would be one too many"):
        list(_in_rooms([stays, visit("r1", 4.0, 6.0), visit("r2", 5.0, 7.0)], 2, "zone"))


def test_rooms_are_taken_one_after_the_other():
    rng = np.random.default_rng(0)
    for _ in range(200):
        most, visits, busy = int(rng.integers(2, 4)), [], []
        for k in range(8):
            since = 1.0 if not visits else visits[-1].since + float(rng.uniform(0, 2))
            busy = [t for t in busy if t > since]
            if len(busy) == most:
                since = min(busy)
                busy.remove(since)
            until = since + float(rng.uniform(0.5, 5))
            busy.append(until)
            visits.append(visit(f"r{k}", since, until))
        waits = list(_in_rooms(visits, most, "zone"))
        assert len(waits) == len(visits) - most
        # any order of times that keeps the waits has no more robots inside
        leaves = {v.leaves: v for v in visits}
        begin, end = {}, {}
        for v in visits:
            before = [end[leaves[a].robot] for a, b in waits if b == v.enters]
            begin[v.robot] = max([float(rng.uniform(0, 9)), *before])
            end[v.robot] = begin[v.robot] + float(rng.uniform(0, 9))
        for v in visits:
            at = begin[v.robot]
            assert sum(begin[w] <= at < end[w] for w in begin) <= most


def test_only_zones_that_may_be_full_count_in_a_problem(tmp_path):
    cells = np.zeros((60, 120), dtype=bool)
    fleet = Fleet(write_map(tmp_path, "free", cells, 0.1), name="free", margin=0.1)
    fleet.add_robot_type("agv", (0.8, 0.6))
    fleet.add_place("a", 3.0, 3.0)
    fleet.add_place("b", 9.0, 3.0)
    for name, at in (("r0", "a"), ("r1", "b"), ("r2", [6, 5, 0])):
        fleet.add_robot(name, "agv", start=at)
    fleet.add_zone("left", [(2, 2), (4, 2), (4, 4), (2, 4)], max_robots=1)
    site, poses = fleet.records, {"r0": (3, 3, 0), "r1": (9, 3, 0), "r2": (6, 5, 0)}
    assert still_counted(site, poses, ["r0"]) == {}
    assert still_counted(site, poses, ["r1"]) == site.zones
    crowded = {**poses, "r2": (3.5, 3.0, 0)}
    assert still_counted(site, crowded, ["r1"])["left"].max_robots == 2


def test_who_drives_through_a_zone_waits_before_it(tmp_path):
    fleet = hall(tmp_path, 2)
    fleet.add_zone("way", [(7, 0.3), (8, 0.3), (8, 13.7), (7, 13.7)], max_robots=1)
    day = Day(tmp_path, fleet=fleet)
    try:
        day.order("o0", "shelf0", "dock1", robots=["r0"])
        day.order("o1", "shelf1", "dock0", robots=["r1"])

        def waits():
            graph = getattr(getattr(day.operation.executor, "state", None), "graph", None)
            return [e for e in graph.edges if e.kind == "zone"] if graph else []

        day.until(waits)
        assert {e.why for e in waits()} == {"zone 'way' takes 1"}
        assert all(e.first.at is At.REACH and e.then.at is At.LEAVE for e in waits())
        stop = day.clock.now() + 12.0
        day.until(lambda: day.clock.now() > stop)
        day.robots.close()
        assert list(crowded(fleet.records, day.robots.initial, day.robots.drives)) == []
    finally:
        day.operation.close()


def test_a_crowd_is_seen(tmp_path):
    fleet = hall(tmp_path, 2)
    fleet.add_zone("homes", [(1, 1), (2, 1), (2, 4), (1, 4)], max_robots=1)
    initial = {"r0": (1.5, 1.5, 0.0), "r1": (5.0, 1.5, 0.0)}
    comes = Drive("r1", "a", [[1.0, 5.0, 1.5, 0.0], [5.0, 2.2, 3.0, 0.0], [9.0, 5.0, 3.0, 0.0]])
    goes = Drive("r0", "b", [[2.0, 1.5, 1.5, 0.0], [4.0, 7.0, 1.5, 0.0]])
    (told,) = crowded(fleet.records, initial, [comes])
    assert told == "'r1' came into 'homes' at 5.0 s as number 2"
    assert list(crowded(fleet.records, initial, [comes, goes])) == []
