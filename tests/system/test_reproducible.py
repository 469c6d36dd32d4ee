"""The same seed, one worker: the same plan file, byte for byte, in every process."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.fuzz.problems import SECONDS, Writer, build, random_case
from tests.usual import usually
from up_samp.benchmarks import instance
from up_samp.io import dump_plan, result_to_dict
from up_samp.model import Deadline, OutOfTimeError, ProblemError, UnsupportedError, deadline
from up_samp.model.deadline import TICK, check_time, in_force
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


RANDOM = """
import sys, json
sys.path.insert(0, sys.argv[1])
from tests.system.test_reproducible import plans
print(json.dumps(plans(sys.argv[2], json.loads(sys.argv[3]), float(sys.argv[4]))))
"""


def plans(folder, seeds, limit):
    """Return seed (as JSON has it) -> status and plan of what comes to its end by itself."""
    get_environment().credits_stream = None
    params = {"seed": 3, "reproducible": True, "seconds_per_unit": SECONDS}
    told = {}
    for seed in seeds:
        case = random_case(seed)
        problem = Writer(case, Path(folder) / str(seed) / f"{case.floor.kind}.yaml").write()
        began = time.monotonic()
        with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
            result = planner.solve(problem, timeout=limit)
        if time.monotonic() - began < 0.9 * limit:
            plan = "" if result.plan is None else dump_plan(result_to_dict(problem, result))
            told[str(seed)] = result.status.name + plan
    return told


def same_in_processes(folder, seeds, hash_seeds, *, limit=600):
    """Equal plans here and in other processes of what comes to its end in time, on a machine that
    is as busy as it is: the time limit itself goes by the clock.
    """
    for seed in seeds:
        (folder / str(seed)).mkdir()
        build(random_case(seed), folder / str(seed))
    root = str(Path(__file__).parents[2])
    burner = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    told = [plans(folder, seeds, limit)]
    try:
        for hash_seed in hash_seeds:
            done = subprocess.run(
                child.command(RANDOM, [root, str(folder), json.dumps(seeds), str(limit)]),
                env=child.environment({"PYTHONHASHSEED": hash_seed}),
                capture_output=True,
                text=True,
                timeout=1.5 * limit * len(seeds),
            )
            assert done.returncode == 0, done.stderr
            told.append(json.loads(done.stdout))
    finally:
        burner.kill()
        burner.wait()
    ended = set.intersection(*map(set, told))
    assert len(ended) > len(seeds) / 2
    for seed in ended:
        assert len({process[seed] for process in told}) == 1, seed
    assert any('"motions"' in told[0][seed] for seed in ended)


def test_a_few_plans_are_the_same_beside_a_busy_process(tmp_path):
    same_in_processes(tmp_path, [108], ["77"])


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 160, 10))
def test_plans_are_the_same_beside_a_busy_process(tmp_path, first):
    same_in_processes(tmp_path, list(range(first, first + 10)), ["0", "1", "77"], limit=60)


def test_counted_deadlines_go_by_work():
    whole = Deadline.counted(100.0)
    part = whole.within(0.005)
    looks = 0
    while not part.expired():
        looks += 1
    assert looks == round(0.005 / TICK) - 1
    assert not whole.expired()
    left = whole.remaining()
    whole.spend(30.0)
    assert whole.remaining() == pytest.approx(left - 30.0)
    assert whole.within(50.0).within(5.0).remaining() == pytest.approx(5.0)
    whole.spend(1000.0)
    assert whole.remaining() == pytest.approx(10.0)  # when it ends is for the clock to say
    assert not whole.expired()
    with in_force(whole):
        check_time()
    assert whole.lengthen()
    assert whole.remaining() == pytest.approx(20.0)
    over = Deadline.counted(0.0)
    assert not over.lengthen()
    assert not Deadline.after(1.0).lengthen()
    assert over.expired()
    assert over.remaining() == 0.0
    assert over.within(5.0).expired()
    with in_force(over), pytest.raises(OutOfTimeError):
        check_time()


@pytest.mark.parametrize(
    "name",
    usually("logistics-dc-oc-r2-i3", of=("jobshop-r2-j1-m2", "logistics-dc-oc-r2-i3")),
)
def test_who_has_done_all_work_that_was_counted_on_goes_on_as_long_as_there_is_time(
    name, monkeypatch
):
    monkeypatch.setattr(deadline, "TICK", 1.0)  # as if the machine was so much quicker
    problem = instance(name).build()
    params = {"reproducible": True, "seed": 1, "workers": 1, "first_plan": True}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.plan is not None, result.log_messages


@pytest.mark.parametrize(
    ("engine", "params", "error"),
    [("aries", {}, UnsupportedError), ("cpsat", {"workers": 2}, ProblemError)],
)
def test_what_hangs_on_the_clock_is_refused(tmp_path, engine, params, error):
    problem = build(random_case(103), tmp_path)
    params = {"reproducible": True, **params}
    with (
        OneshotPlanner(name=f"samp-refine[{engine}]", params=params) as planner,
        pytest.raises(error, match="reproducible=True"),
    ):
        planner.solve(problem, timeout=10)
