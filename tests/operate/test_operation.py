"""Orders come in, plans are made, robots drive; judged on what was driven."""

import math
import os
import random
import time
from dataclasses import replace

import pytest

from tests.operate.days import Day, Here
from tests.operate.sites import hall
from up_samp.execution.floor import Delays
from up_samp.fleet.faults import FleetError
from up_samp.model import ProblemError
from up_samp.operate import Operation, RealClock, Settings, SimulatedClock, Store
from up_samp.operate.order_file import OrderFile
from up_samp.operate.simulated import Mishaps, SimulatedRobots


@pytest.fixture
def day(tmp_path, request):
    made = Day(tmp_path, **getattr(request, "param", {}))
    yield made
    made.operation.close()


@pytest.mark.parametrize(
    "day",
    [
        {
            "robots": 3,
            "mishaps": Mishaps(Delays(0.3, 0.6, 5.0, 0.0, 0.3, noise=0.02), 0.1, 0.1),
            "planner": None,
        }
    ],
    indirect=True,
)
def test_orders_that_come_all_the_time_are_done_once(day):
    for k in range(4):
        day.order(f"o{k}", due=day.clock.now() + 120.0)
        if k:
            stop = day.clock.now() + 12.0
            day.until(lambda stop=stop: day.clock.now() >= stop)
    day.run()
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())
    assert {day.state(f"o{k}") for k in range(4)} == {"done"}
    taken = [c for c in day.operation.costs if c[4]]
    assert len(taken) >= 3


TWO_DAYS = [
    {"robots": 3, "seed": 0},
    pytest.param({"robots": 3, "seed": 1}, marks=pytest.mark.long),
]


@pytest.mark.parametrize("day", TWO_DAYS, indirect=True)
def test_who_has_an_order_next_does_not_drive_home_for_others_behind_it(day):
    """All bring to one dock: who leaves it is in the way of who comes next, and goes first."""
    for k in range(6):
        day.order(f"o{k}", delivery="dock1", due=0.0)
    day.run(1200.0)
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())
    rows = [d.rows for d in day.robots.drives if "_to_home" in d.activity]
    ways = [math.dist(r[0][1:3], r[-1][1:3]) for r in rows]
    assert sum(way > 3.5 for way in ways) <= 5, ways  # three go home in the end


def test_a_plan_counts_on_being_followed_a_tick_after_it_is_there(day):
    """Robots drive on meanwhile: who is to wait by it has to be where it still can."""
    day.order("o0", "rack0", "dock0")
    day.until(lambda: day.operation._asked is not None)
    question, since, _ = day.operation._asked
    day.until(lambda: day.operation.costs)
    there, *_ = day.operation.costs[0]
    assert there + day.settings.tick <= since + question.settings.lead


def test_activities_of_several_days_are_never_called_alike(tmp_path):
    """Robots run on while the floor's days begin anew, and would take one for done by its name."""
    told = []
    for _ in range(2):
        robots, clock = SimulatedRobots({"r0": (1.5, 1.5, 0.0)}), RealClock(time.time())
        settings = Settings(budget=30.0, tick=0.0)
        day = Operation(
            hall(tmp_path, robots=1), store=Store(tmp_path / f"{len(told)}.db"), robots=robots,
            clock=clock, planner=Here(), settings=settings,
        )  # fmt: skip
        day.add({"id": "o0", "at": "rack0", "duration": 4})
        while not day.meanings:
            day.step()
        told.append(set(day.meanings))
        day.close()
    assert told[0].isdisjoint(told[1])


def test_a_robot_may_start_at_a_pose_of_its_own(tmp_path):
    fleet = hall(tmp_path, robots=1)
    fleet.add_robot("late", "agv", [3, 11, 0])
    robots = SimulatedRobots({"r0": (1.5, 1.5, 0.0), "late": (3.0, 11.0, 0.0)})
    day = Operation(fleet, store=Store(tmp_path / "day.db"), robots=robots, clock=SimulatedClock())
    assert day.poses["late"] == (3.0, 11.0, 0.0)
    day.close()


def test_an_order_begins_no_earlier_than_it_is_released_and_recurs(tmp_path):
    day = Day(tmp_path, robots=2)
    try:
        day.order("bin", "shelf0", "dock0", release=40.0, repeat={"every": 60.0, "times": 2})
        assert [*day.operation.jobs] == ["bin", "bin_2"]
        day.until(lambda: day.clock.now() >= 15.0)
        assert not day.operation.meanings  # nobody has it yet
        day.run()
        begun = {h.what: h.start for h in day.robots.handled if h.kind == "pick"}
        assert 40.0 <= begun["bin"] <= 50.0
        assert 100.0 <= begun["bin_2"] <= 110.0
        assert day.verdict().good, day.story()
        early = replace(day.operation.jobs["bin"].record, release=60.0)
        day.operation.jobs["bin"] = replace(day.operation.jobs["bin"], record=early)
        assert "'bin' was begun at" in day.verdict().elsewhere[0]
        with pytest.raises(ProblemError, match="'bin' is done: it cannot be changed"):
            day.order("bin", "shelf1", "dock0", repeat={"every": 60.0, "times": 3})
        assert "bin_3" not in day.operation.jobs
        with pytest.raises(FleetError, match=r"one of the two"):
            day.order("can", "shelf0", "dock0", repeat={"every": 60.0})
        day.order("can", "shelf0", "dock0", release=500, repeat={"every": 60.0, "until": 600.0})
        assert [name for name in day.operation.jobs if "can" in name] == ["can", "can_2"]
    finally:
        day.operation.close()


def test_orders_of_a_file_are_added_changed_and_cancelled_as_it_changes(tmp_path):
    day, file = Day(tmp_path, robots=1), tmp_path / "orders.yaml"

    def write(text):
        before = file.stat().st_mtime_ns if file.exists() else 0
        file.write_text(text)
        os.utime(file, ns=(before + 10**9, before + 10**9))

    def looked():
        return orders.look() or orders.look()

    try:
        with pytest.raises(FleetError, match=r"orders\.yaml"):
            OrderFile(day.operation, file)
        one = "- {id: a, pickup: shelf0, delivery: dock0}\n"
        write(one + "- {id: b, pickup: rack0, delivery: dock1, release: 500}\n")
        orders = OrderFile(day.operation, file)
        assert looked() == looked() == []
        assert [*day.operation.jobs] == ["a", "b"]
        write(one + "- {id: b, pickup: rack1, delivery: dock1, release: 500}\n")
        assert looked() == []
        assert day.operation.jobs["b"].record.pickup.at == ("rack1",)
        assert day.operation.jobs["a"].came == 0.0
        write(one + "- {id: c, pickup: nowhere, delivery: dock1}\n")
        (refused,) = looked()
        assert "nowhere" in refused
        assert day.state("b") == "cancelled"
        day.until(lambda: day.state("a") == "begun")
        day.restart()
        orders = OrderFile(day.operation, file)
        assert len(looked()) == 1  # still c
        write("orders:\n- {id: d, pickup: shelf1, delivery: dock1}\n")
        assert looked() == ["'a' is begun: it cannot be cancelled"]
        write("- {id: d")
        (refused,) = looked()
        assert "orders.yaml" in refused
        day.run()
        assert (day.state("a"), day.state("d")) == ("done", "done")
    finally:
        day.operation.close()


@pytest.mark.parametrize("seed", range(3))
def test_a_file_of_orders_that_is_being_written_cancels_nothing(tmp_path, seed):
    """It is empty first, then half there: what is cancelled can never be ordered again."""
    rng, day, file = random.Random(seed), Day(tmp_path, robots=1), tmp_path / "orders.yaml"
    entries = [f"- {{id: o{k}, pickup: rack{k % 3}, delivery: dock0}}\n" for k in range(6)]
    rng.shuffle(entries)
    text = "".join(entries)
    try:
        file.write_text(text)
        orders = OrderFile(day.operation, file)
        for _ in range(2):
            assert orders.look() == []
        file.write_text("")
        orders.look()
        file.write_text("".join(entries[: rng.randrange(1, 6)]))
        orders.look()
        file.write_text(text + "# changed\n")
        for _ in range(3):
            assert orders.look() == []
        assert {day.state(f"o{k}") for k in range(6)} == {"waiting"}
        file.write_text(entries[0])
        for _ in range(3):
            assert orders.look() == []
        assert sorted(j.state.value for j in day.operation.jobs.values()) == [
            *["cancelled"] * 5, "waiting",
        ]  # fmt: skip
    finally:
        day.operation.close()
