"""Fleets of what sites asked for of late (``modern``), before the judge of ``buildings``."""

import copy

import pytest

from tests.fleet.buildings import built
from tests.fleet.modern import Modern, looser
from tests.fleet.rulebook import Rulebook
from tests.fleet.test_buildings import Answer, told
from tests.usual import usually

SEEDS = (16, 28, 474)
GOOD, CARRIED, TURNED = 977, 1898, 69
HALL = [[0, 0], [15, 0], [15, 8], [0, 8]]


def modern(seed, folder):
    return told(seed, folder, draw=Modern, looser=looser)


@pytest.mark.parametrize("seed", usually(16, of=SEEDS))
def test_plans_keep_the_newest_rules(seed, tmp_path):
    assert modern(seed, tmp_path) == []


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 400, 25))
def test_many_plans_keep_the_newest_rules(first, tmp_path):
    findings = {seed: modern(seed, tmp_path) for seed in range(first, first + 25)}
    assert {seed: found for seed, found in findings.items() if found} == {}


def crawling(spec):
    spec["zones"]["all"] = {"polygon": HALL, "v_max": 0.01}


def westward(spec):
    spec["zones"]["all"] = {"polygon": HALL, "one_way": 3.14159265}


def turning(spec):
    spec["zones"]["all"] = {"polygon": HALL, "pivoting": "never"}


def backing(spec):
    spec["types"]["agv"] |= {"reverse": "slow", "reverse_v_max": 0.001}


def shut(spec):
    spec["automatic_doors"]["all"] = {"polygon": HALL, "shut": [[0, 1e5]]}


def locked(spec):
    for name in ("one", "two"):
        spec["automatic_doors"][name] = {"polygon": HALL, "airlock": "all"}


def missed(spec):
    spec["tasks"][0]["window"] = [[1e5, 2e5], [3e5, 4e5]]


def alone(spec):
    spec["tasks"][0]["crew"] = 2


def low(spec):
    spec["types"]["agv"]["battery"]["level"] = 1.0


def stopping(spec):
    spec["zones"]["all"] = {"polygon": HALL, "stopping": "never"}


def pivoting(spec):
    spec["types"]["agv"]["pivoting"] = "never"


def setting_up(spec):
    kinds = ("red", "blue")
    spec["resources"]["oven"]["setup"] = {kind: dict.fromkeys(kinds, 1e4) for kind in kinds}


def one_by_one(spec):
    spec["resources"]["oven"]["capacity"] = 0


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    spec = Modern(GOOD, folder).spec
    return spec, Answer(spec, built(spec), 3, 20.0).result


HARMS = (
    crawling, westward, backing, shut, locked, missed, alone, low, stopping, setting_up, one_by_one,
)  # fmt: skip


@pytest.mark.parametrize("harm", HARMS)
def test_the_judge_sees_what_is_wrong(harm, good):
    spec, result = copy.deepcopy(good[0]), good[1]
    assert Rulebook(spec, result).faults == []
    harm(spec)
    assert Rulebook(spec, result).faults


def test_the_judge_sees_turns_on_the_spot(tmp_path):
    spec = Modern(TURNED, tmp_path).spec
    result = Answer(spec, built(spec), 3, 20.0).result
    assert Rulebook(spec, result).faults == []
    for harm in (turning, pivoting):
        harmed = copy.deepcopy(spec)
        harm(harmed)
        assert Rulebook(harmed, result).faults


def test_the_judge_sees_a_place_with_more_than_it_has_room_for(tmp_path):
    spec = Modern(CARRIED, tmp_path).spec
    result = Answer(spec, built(spec), 3, 20.0).result
    assert Rulebook(spec, result).faults == []
    for place in spec["places"].values():
        place |= {"room": 0, "holds": 0}
    assert any("holds" in fault for fault in Rulebook(spec, result).faults)
