"""Orders come in, plans are made, robots drive; judged on what was driven."""

import pytest

from tests.operate.days import Day
from tests.operate.sites import hall
from up_samp.execution.simulate import Delays
from up_samp.operate import Operation, SimulatedClock, Store
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


def test_a_robot_may_start_at_a_pose_of_its_own(tmp_path):
    fleet = hall(tmp_path, robots=1)
    fleet.add_robot("late", "agv", [3, 11, 0])
    robots = SimulatedRobots({"r0": (1.5, 1.5, 0.0), "late": (3.0, 11.0, 0.0)})
    day = Operation(fleet, store=Store(tmp_path / "day.db"), robots=robots, clock=SimulatedClock())
    assert day.poses["late"] == (3.0, 11.0, 0.0)
    day.close()
