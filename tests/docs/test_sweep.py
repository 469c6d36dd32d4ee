"""How scripts/sweep.py chooses other values, and what it calls a difference."""

import importlib.util
from pathlib import Path

import pytest

from up_samp.tuning import Tuning, tuning_of

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def sweep():
    spec = importlib.util.spec_from_file_location("sweep", ROOT / "scripts" / "sweep.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_other_values_make_sense_and_are_others(sweep, factor):
    found = 0
    for name in sweep.tunables():
        table = sweep.setting([name], factor)
        if table:
            found += 1
            assert tuning_of(table) != Tuning(), name
    assert found > 0.9 * len(sweep.tunables())


def test_what_is_found_counts_before_how_good_it_is(sweep):
    base = {"found": 1, "makespan": 100.0, "bound": 90.0, "rounds": 1.0, "cpu": 2.0}
    assert sweep.differences(base, dict(base)) == []
    assert sweep.differences(base, base | {"found": 0, "makespan": 1.0}) == ["found worse"]
    assert sweep.differences(base, base | {"makespan": 110.0, "cpu": 2.9}) == [
        "makespan 100 -> 110 worse"
    ]
    assert sweep.differences(base, base | {"bound": 95.0, "cpu": 9.0}) == [
        "bound 90 -> 95 better",
        "cpu 2 -> 9 worse",
    ]
    assert sweep.differences(base, base | {"makespan": 100.5}) == ["makespan 100 -> 100.5 other"]


def test_the_cases_that_were_run_are_there(sweep):
    assert set(sweep.Sweep(sweep.KEPT).kept["base"]) <= set(sweep.cases())


def test_a_run_tells_which_tunables_it_reads(sweep, on_the_clock):
    told = sweep.run("random: 4", {}, 60.0, reads=True)
    assert "tiny" in told["reads"]
    assert set(told["reads"]) < set(sweep.tunables())
