import pytest

from tests.scheduling.cpsat.differential import disagreement, grown_disagreement
from up_samp.tuning import Tuning

FEW = 120
MANY = 3000
# problems this small would be solved at once
NONE_TINY = Tuning(tiny=0)


@pytest.mark.parametrize("block", range(5))
def test_agrees_with_brute_force(block):
    size = FEW // 5
    found = {s: disagreement(s) for s in range(block * size, (block + 1) * size)}
    assert not {s: d for s, d in found.items() if d is not None}


def test_two_searches_side_by_side_agree_with_brute_force():
    found = {s: disagreement(s, workers=2, tuning=NONE_TINY) for s in range(200, 230)}
    assert not {s: d for s, d in found.items() if d is not None}


def test_growing_a_problem_gives_what_a_fresh_one_gives():
    # 50610: the first constraint on the global end is appended, when there is a model already
    found = {s: grown_disagreement(s) for s in [*range(25), 50610]}
    assert not {s: d for s, d in found.items() if d is not None}


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_agrees_with_brute_force_on_many(block):
    size = MANY // 10
    found = {s: disagreement(s) for s in range(10_000 + block * size, 10_000 + (block + 1) * size)}
    assert not {s: d for s, d in found.items() if d is not None}


@pytest.mark.long
def test_two_searches_side_by_side_agree_with_brute_force_on_many():
    found = {s: disagreement(s, workers=2, tuning=NONE_TINY) for s in range(20_000, 21_000)}
    assert not {s: d for s, d in found.items() if d is not None}


@pytest.mark.long
def test_growing_many():
    found = {s: grown_disagreement(s) for s in range(10_000, 10_500)}
    assert not {s: d for s, d in found.items() if d is not None}
