"""Rules of driving over a day: zones with a speed, a direction, or no turning on the spot, and
robots that are slow backwards or never drive so. What was driven is judged twice: as days are, and
by shapes alone (:mod:`tests.fleet.driving`).
"""

from dataclasses import asdict, replace
from functools import partial

import pytest
from shapely.geometry import Polygon

from tests.fleet import driving
from tests.operate.days import Day
from tests.operate.sites import hall
from tests.operate.wire import AgvFloor
from up_samp.execution.floor import Delays, Drive
from up_samp.operate.judge import record_of_day, unruly
from up_samp.operate.records import Settings
from up_samp.operate.simulated import Mishaps
from up_samp.operate.zones import stretches_told

ZONES = {
    "crossing": {"polygon": [(7.2, 0.3), (8.7, 0.3), (8.7, 13.7), (7.2, 13.7)], "v_max": 0.4},
    "north": {"polygon": [(9, 10.2), (16.5, 10.2), (16.5, 13.7), (9, 13.7)], "one_way": 0.0},
    "south": {"polygon": [(9, 0.3), (16.5, 0.3), (16.5, 3.8), (9, 3.8)], "one_way": 3.14159},
    "racks": {
        "polygon": [(16.8, 0.3), (17.8, 0.3), (17.8, 13.7), (16.8, 13.7)], "pivoting": "never",
    },
}  # fmt: skip
NOISY = Mishaps(Delays(0.3, 0.6, 5.0, 0.0, 0.3, noise=0.02))


def ruled(folder, zones=ZONES, **kind):
    fleet = hall(folder, 3, **kind)
    for name, rules in zones.items():
        fleet.add_zone(name, **rules)
    return fleet


def broken(day, within=0.0):
    """What was driven against the rules ``within`` m of the edges of zones, by shapes alone."""
    site, found = day.fleet.records, []
    zones = {n: {k: v for k, v in asdict(z).items() if v} for n, z in site.zones.items()}
    for zone in zones.values():
        zone["polygon"] = [*Polygon(zone["polygon"]).buffer(-within).exterior.coords]
    kind = {k: v for k, v in asdict(site.robot_types["agv"]).items() if v}
    spec = {"types": {"agv": kind}, "zones": zones, "floors": {}}
    record = record_of_day(site, day.robots.initial, day.robots.drives)
    driving.check(spec, record, lambda *words: found.append(words))
    return found


FLOORS = {
    "simulated": None,
    "vda 2.1": partial(AgvFloor, lost=0.05, twice=0.05, late=0.2),
    "vda 3.0": partial(AgvFloor, lost=0.0, twice=0.0, late=0.1, version="3.0.0"),
}


@pytest.mark.long
@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize(
    "kind", [{"reverse": "slow", "reverse_v_max": 0.3}, {"reverse": "never"}], ids=["slow", "never"]
)
def test_rules_are_kept_all_day(tmp_path, floor, kind):
    zones = {n: z for n, z in ZONES.items() if floor == "simulated" or "pivoting" not in z}
    day = Day(
        tmp_path, fleet=ruled(tmp_path, zones, **kind), mishaps=NOISY, floor=FLOORS[floor],
        settings=Settings(stretch=5.0, tick=0.4),
    )  # fmt: skip
    try:
        for k in range(8):
            day.order(f"o{k}")
        day.run(1500)
        assert {day.state(f"o{k}") for k in range(8)} == {"done"}
        verdict = day.verdict()
        if floor != "simulated":  # AGVs drive the edges' polylines, and turn where these bend
            verdict = replace(verdict, unruly=())
        assert verdict.good, (verdict, day.story())
        assert broken(day, 0.0 if floor == "simulated" else 0.15) == []
        # the zones are driven through, and where half as much is allowed both judges say so
        slow = {n: replace(z, v_max=0.2) for n, z in day.fleet.records.zones.items() if z.v_max}
        day.fleet._hold(replace(day.fleet.records, zones=slow))
        assert list(unruly(day.fleet.records, day.robots.drives))
        assert broken(day)
    finally:
        day.operation.close()


def test_robots_are_told_how_fast_they_may_drive_where(tmp_path):
    zones = {"crossing": ZONES["crossing"]}
    day = Day(tmp_path, fleet=ruled(tmp_path, zones, reverse="slow", reverse_v_max=0.3))
    try:
        day.order("o0", "rack1", "dock1", robots=["r0"])
        day.until(lambda: day.operation.meanings)
        executor = day.operation.executor
        seen = set()
        for motion in executor.plan["motions"]:
            path = executor.drives[motion["activity"], motion["object"]].path
            whole = motion["progress"][-1]
            for piece, low, high, speed in stretches_told(motion, path, {whole / 2}):
                middle = path.poses_at([(low + high) / 2])[0]
                if piece.direction in ("forward", "backward"):
                    inside = 7.2 <= middle[0] <= 8.7
                    seen.add((piece.direction, inside))
                    assert 0 < speed <= (0.4 if inside else 1.5)
                    assert speed <= 0.3 or piece.direction == "forward"
            # a turn by rounding at its end: telling of it ended the day
            (since, x, y, theta), s = motion["samples"][-1], motion["progress"]
            last = [since + 1e-3, x, y, theta + 2e-6]
            turned = {**motion, "samples": [*motion["samples"], last], "progress": [*s, s[-1]]}
            told = [(low, high) for _, low, high, _ in stretches_told(turned, path)]
            assert told == [(low, high) for _, low, high, _ in stretches_told(motion, path)]
        assert {("forward", False), ("forward", True)} <= seen
    finally:
        day.operation.close()


def test_what_is_driven_against_rules_is_seen(tmp_path):
    site = ruled(tmp_path, reverse="slow", reverse_v_max=0.3).records
    fast = Drive("r0", "a", [[k / 10, 6.0 + 0.08 * k, 2.0, 0.0] for k in range(51)])
    (too_fast, wrong) = unruly(site, [fast])
    assert "in a zone that allows 0.4" in too_fast
    assert "against the direction of a zone" in wrong
    back = Drive("r0", "b", [[0.0, 6.0, 2.0, 0.0], [1.0, 5.0, 2.0, 0.0]])
    assert ["backwards" in text for text in unruly(site, [back])] == [True]
    turns = Drive("r1", "c", [[0.0, 17.0, 9.0, 0.0], [2.0, 17.0, 9.0, 1.0]])
    assert ["turns on the spot" in text for text in unruly(site, [turns])] == [True]


def test_the_page_says_what_zones_ask_for(tmp_path):
    floor = pytest.importorskip("up_samp.server.floor", reason="needs fastapi")
    zones = ruled(tmp_path).records.zones
    assert {n: floor._rule(z) for n, z in zones.items()} == {
        "crossing": "at most 0.4 m/s", "north": "one way, heading 0.0 rad",
        "south": "one way, heading 3.14159 rad", "racks": "no turning on the spot",
    }  # fmt: skip
