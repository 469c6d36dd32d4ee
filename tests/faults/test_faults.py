"""Whatever goes wrong around a solve: the right status, the best plan kept, nothing left behind."""

import random

import pytest

from tests.faults import cases, engines


def test_every_kind_of_bad_engine_is_tried():
    tried = {*cases.ENDING, *cases.DYING, *cases.RAISING, *cases.LYING}
    assert tried == set(engines.FAULTS)
    assert len(tried) >= 30


def test_answers_that_make_no_sense_are_refused(tmp_path):
    make = cases.bad_engines(["LeavesOneOut"], later=False)
    assert make(tmp_path, random.Random(0)) == []


def test_the_best_plan_is_kept_and_all_processes_are_ended(tmp_path):
    make = cases.bad_engines(["Hangs"], later=True, timeout=10.0)
    assert make(tmp_path, random.Random(0)) == []


def test_the_best_plan_is_kept_when_a_part_of_the_search_breaks(tmp_path):
    assert cases.kept_after_a_plan(tmp_path, random.Random(0)) == []


@pytest.mark.long
@pytest.mark.parametrize("fault", cases.FAULT_TABLE, ids=lambda f: f.name)
def test_all_faults(tmp_path, fault):
    rng = random.Random(fault.name)
    for _ in range(min(fault.runs, 3)):
        assert fault.make(tmp_path, rng) == []
