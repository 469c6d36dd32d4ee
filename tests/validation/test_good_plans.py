"""Good plans are accepted by the validator and by ``up-samp validate``.

``benchmarks/reliability/good_plans.py`` shows them a thousand.
"""

import pytest

from benchmarks.reliability.good_plans import judged


@pytest.mark.long
@pytest.mark.parametrize("seed", range(30))
def test_good_plans_are_accepted(tmp_path, seed):
    row = judged(seed, tmp_path, 40)
    print(f"world {seed}: {row['plans']} plans")
    assert row["refused"] == []
