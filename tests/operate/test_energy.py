"""Batteries over a day: who is low charges, nobody falls below its reserve, and whoever is told to
charge does.
"""

import random
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from tests.operate.days import Day
from tests.operate.sites import hall
from tests.operate.wire import AgvFloor
from up_samp.fleet.meanings import Kind, Meaning
from up_samp.model import ProblemError, UnsupportedError
from up_samp.operate.horizon import Cut
from up_samp.operate.planner import _solved, check_site
from up_samp.operate.records import Settings, job_record
from up_samp.operate.simulated import SimulatedRobots
from up_samp.operate.stitch import Kept, Question
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


@pytest.mark.parametrize("told", [True, False])
def test_who_tells_no_level_of_its_battery_is_noted_once(days, tmp_path, told):
    """It counted as full as at first for ever, and nothing said so."""
    day = days(fleet=charged_hall(tmp_path, robots=2))
    if not told:
        del day.robots.batteries["r0"], day.robots.levels["r0"]
    day.order("o0", "rack0", "dock0", robots=["r0"])
    day.run()
    assert day.story(500).count("tells no level") == (not told)
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
    task = charge_task(site, "r0", "charge.r0.7", 12.0)
    assert (task.at, task.duration, task.robots, task.due) == (("charger",), 45.0, ("r0",), 12.0)
    assert start_levels(site, {"r0": 0.5, "r1": 0.02}, {}, {}, ()) == {"r0": 50.0, "r1": 10.0}
    assert start_levels(site, {"r1": 0.4}, {}, {}, ()) == {"r0": 60.0, "r1": 40.0}
    told = with_levels(site, {"r0": 50.0})
    assert (told.robots["r0"].level, told.robots["r1"].level) == (50.0, None)
    assert all(place.charger is None for place in told.places.values())
    with pytest.raises(ProblemError, match="'r0' has no battery"):
        charge_task(hall(tmp_path, 1).records, "r0", "charge.r0.7", 0.0)


def test_what_is_kept_takes_after_a_charge_too(tmp_path):
    site, path = charged_hall(tmp_path).records, SimpleNamespace(length=20.0)
    path.natural = SimpleNamespace(times=[0.0, 40.0])
    drives = {("there", "r0"): SimpleNamespace(path=path), ("on", "r0"): SimpleNamespace(path=path)}
    meanings = {n: Meaning(Kind.MOVE, "", "r0") for n in ("there", "on")}
    meanings["plug"] = Meaning(Kind.TASK, "charge.r0.0", "r0")
    for kept, level in (
        (("there", "on"), 26.0), (("there", "plug"), 100.0), (("there", "plug", "on"), 88.0),
    ):  # fmt: skip
        assert start_levels(site, {"r0": 0.5}, drives, meanings, kept) == {"r0": level}


def test_who_is_to_charge_may_use_its_reserve_on_the_way_there(tmp_path):
    """Else it stood where it was for good: no order is planned any more, and no charge either."""
    site = charged_hall(tmp_path, reserve=10.0).records
    job = charge_task(site, "r0", "charge.r0.0", 0.0)
    cut = Cut(since=0.0, poses={"r0": site.places["rack0"].pose})
    ask = Question(
        1, site, tmp_path, cut, Kept(), (job,), ("r0",), levels={"r0": 10.5}, computing=True
    )
    written, plan = _solved(ask, None)
    assert any(written.meanings[a["name"]].what == "charge.r0.0" for a in plan["activities"])


@pytest.mark.parametrize("seed", range(2))
def test_who_is_to_charge_is_planned_from_what_it_has(tmp_path, seed):
    """The order is on the way to the charger, and cannot be done before with what is there."""
    rng = random.Random(seed)
    site = charged_hall(tmp_path, reserve=rng.choice([0.0, 10.0])).records
    names = [*site.places]
    rng.shuffle(names)
    site = replace(site, places={n: site.places[n] for n in names})
    reserve = site.robot_types["agv"].battery.reserve
    level = reserve + rng.uniform(11.0, 13.0)
    order = job_record({"id": "o0", "pickup": "rack2", "delivery": "dock2"})
    jobs = [charge_task(site, "r0", "charge.r0.0", 0.0), order]
    rng.shuffle(jobs)
    cut = Cut(since=0.0, poses={"r0": site.places["rack0"].pose})
    ask = Question(
        1, site, tmp_path, cut, Kept(), tuple(jobs), ("r0",), levels={"r0": level},
        computing=True,
    )  # fmt: skip
    written, plan = _solved(ask, None)
    rows = {m["activity"]: np.array(m["samples"]) for m in plan["motions"]}
    least = level
    for a in sorted(plan["activities"], key=lambda a: a["start"]):
        if a["name"] in rows:
            way = rows[a["name"]]
            level -= 0.5 * np.hypot(*np.diff(way[:, 1:3], axis=0).T).sum()
            level -= 0.05 * (way[-1, 0] - way[0, 0])
        elif written.meanings[a["name"]].what == "charge.r0.0":
            level = 100.0
        least = min(least, level)
    assert least >= reserve - 1e-6


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
