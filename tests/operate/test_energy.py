"""Batteries over a day: who is low charges, nobody falls below its reserve, and whoever is told to
charge does.
"""

from functools import partial

import pytest

from tests.operate.days import Day
from tests.operate.sites import hall
from tests.operate.wire import AgvFloor
from up_samp.model import ProblemError, UnsupportedError
from up_samp.operate.planner import check_site
from up_samp.operate.records import Settings
from up_samp.operate.simulated import SimulatedRobots
from up_samp.operate.upkeep import charge_task, low, start_levels, with_levels

BATTERY = {"capacity": 100.0, "per_metre": 0.5, "per_second": 0.05, "reserve": 10.0, "level": 60.0}
PATIENT = Settings(stretch=20.0)


def charged_hall(folder, robots=1, **battery):
    fleet = hall(folder, robots, battery={**BATTERY, **battery})
    fleet.add_place("charger", 4.0, 1.5, charger={"per_second": 2.0})
    return fleet


@pytest.fixture
def days(tmp_path):
    made = []

    def begin(**options):
        made.append(Day(tmp_path, settings=PATIENT, **options))
        return made[-1]

    yield begin
    for day in made:
        day.operation.close()


def test_a_robot_that_is_told_to_charges_and_goes_home(days, tmp_path):
    day = days(fleet=charged_hall(tmp_path))
    job = day.operation.charge("r0")
    assert job.id == "charge.r0.0"
    with pytest.raises(ProblemError, match="'r0' is to charge already"):
        day.operation.charge("r0")
    day.run()
    assert day.state(job.id) == "done"
    assert day.robots.levels["r0"] > 0.95
    assert day.robots.pose("r0")[:2] == pytest.approx((1.5, 1.5), abs=0.02)
    assert day.verdict().good


@pytest.mark.long
def test_who_is_low_charges_by_itself_and_its_level_is_kept(days, tmp_path):
    day = days(fleet=charged_hall(tmp_path, level=50.0))
    for k in range(3):
        day.order(f"o{k}", "rack0", "dock0")
    least = []
    day.until(lambda: least.append(min(day.robots.levels.values())) or day.operation.idle, 1500)
    assert min(least) >= 0.10
    assert [day.state(f"o{k}") for k in range(3)] == ["done"] * 3
    assert any(n.startswith("charge.r0.") for n in day.operation.jobs)
    assert day.verdict().good, day.story()


def test_an_agv_charges_and_stops_in_the_words_of_vda_5050(days, tmp_path):
    pytest.importorskip("paho.mqtt", reason="needs the extra [mqtt]: paho-mqtt")
    quiet = partial(AgvFloor, lost=0.0, twice=0.0, late=0.0)
    day = days(fleet=charged_hall(tmp_path), floor=quiet)
    agv = day.robots.agvs["r0"]
    day.operation.step()
    job = day.operation.charge("r0")
    day.run()
    (action,) = [a for o in agv.orders for n in o["nodes"] for a in n["actions"]]
    assert action["actionType"] == "startCharging"
    assert "stopCharging" in agv.told
    assert agv.charge == 100.0
    assert not agv.charging
    assert day.state(job.id) == "done"


def test_batteries_without_a_charger_are_refused(tmp_path):
    with pytest.raises(UnsupportedError, match="'agv' has a battery, and nobody can charge"):
        check_site(hall(tmp_path, 1, battery=BATTERY).records)


def test_levels_of_a_plan(tmp_path):
    site = charged_hall(tmp_path, 2).records
    assert low(site, {"r0": 0.36, "r1": 0.38}, 0.3) == ["r0"]
    task = charge_task(site, "r0", 0.4, "charge.r0.7", 12.0)
    assert (task.at, task.duration, task.robots, task.due) == (("charger",), 30.0, ("r0",), 12.0)
    begins = start_levels(site, {"r0": 0.5, "r1": 0.02}, {}, {}, ())
    assert begins == {"r0": 50.0, "r1": pytest.approx(10.1)}
    told = with_levels(site, begins, ["r1"])
    assert (told.robots["r0"].level, told.robots["r1"].level) == (50.0, 100.0)
    assert all(place.charger is None for place in told.places.values())
    with pytest.raises(ProblemError, match="'r0' has no battery"):
        charge_task(hall(tmp_path, 1).records, "r0", 0.4, "charge.r0.7", 0.0)


def test_drives_take_and_chargers_give(tmp_path):
    robots = SimulatedRobots({}, site=charged_hall(tmp_path).records)
    robots.discharge("r0", 10.0, 20.0)
    assert robots.levels["r0"] == pytest.approx(0.6 - (5.0 + 1.0) / 100)
    robots.discharge("r0", 0.0, 20.0)
    robots.charge("r0", 5.0)
    assert robots.levels["r0"] == pytest.approx(0.64)
    robots.charge("r0", 500.0)
    assert robots.levels == {"r0": 1.0}
    assert SimulatedRobots({}).levels == {}
