"""The same seed, one worker: the same plan file, byte for byte, in every process."""

import subprocess

import pytest

from up_samp.system import child

CODE = """
import sys
from unified_planning.shortcuts import OneshotPlanner, get_environment
from up_samp.benchmarks import instance
from up_samp.io import result_to_dict, dump_plan
get_environment().credits_stream = None
problem = instance(sys.argv[1]).build()
params = {"seed": 3, "workers": 1}
with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
    result = planner.solve(problem, timeout=120)
sys.stdout.write(dump_plan(result_to_dict(problem, result)))
"""


@pytest.mark.long
@pytest.mark.parametrize("name", ["jobshop-r1-j1-m1", "logistics-dc-oc-r2-i2"])
def test_equal_seeds_give_equal_plan_files(name):
    plans = set()
    for hash_seed in ("0", "1", "77"):
        done = subprocess.run(
            child.command(CODE, [name]),
            env=child.environment({"PYTHONHASHSEED": hash_seed}),
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        plans.add(done.stdout)
    assert len(plans) == 1
    assert '"motions"' in plans.pop()
