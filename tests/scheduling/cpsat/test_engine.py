import signal
import subprocess
import sys
import textwrap
import time

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    AnytimePlanner,
    BoolType,
    MinimizeMakespan,
    OneshotPlanner,
    Or,
    Oversubscription,
)
from unified_planning.test.examples.scheduling import get_example_problems

import up_samp  # noqa: F401  (registers the engine)
from up_samp.benchmarks import instance
from up_samp.model import ProblemError
from up_samp.validation import validate_schedule


def shop(n=4):
    problem = SchedulingProblem("shop")
    activities = [problem.add_activity(f"a{i}", 1 + i % 3) for i in range(n)]
    for i, a in enumerate(activities):
        for b in activities[:i]:
            problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


@pytest.mark.parametrize("name", sorted(get_example_problems()))
def test_examples_of_unified_planning(name):
    problem = get_example_problems()[name].problem
    with OneshotPlanner(name="cpsat", params={"workers": 2}) as planner:
        assert planner.supports(problem.kind)
        result = planner.solve(problem, timeout=60)
    wanted = Status.SOLVED_OPTIMALLY if problem.quality_metrics else Status.SOLVED_SATISFICING
    assert result.status is wanted
    assert validate_schedule(problem, result.plan).valid


def test_anytime_plans_get_better():
    problem = shop(6)
    with AnytimePlanner(name="cpsat", params={"workers": 1}) as planner:
        results = list(planner.get_solutions(problem, timeout=60))
    lengths = [int(r.metrics["makespan"]) for r in results]
    assert lengths == sorted(lengths, reverse=True)
    assert results[-1].status is Status.SOLVED_OPTIMALLY
    assert all(r.status is Status.INTERMEDIATE for r in results[:-1])
    assert results[-1].metrics["lower_bound"] == results[-1].metrics["makespan"]


def test_anytime_can_be_left_early():
    with AnytimePlanner(name="cpsat", params={"workers": 1}) as planner:
        for result in planner.get_solutions(shop(14), timeout=60):
            assert result.plan is not None
            break


def test_unsolvable():
    problem = shop(2)
    problem.get_activity("a0").add_deadline(0)
    with OneshotPlanner(name="cpsat") as planner:
        assert planner.solve(problem).status is Status.UNSOLVABLE_PROVEN


def test_a_problem_without_activities_may_have_another_metric_than_makespan():
    """What is left of a schedule in which no optional activity is present."""
    problem = SchedulingProblem("empty")
    flag = problem.add_fluent("flag", BoolType(), default_initial_value=True)
    problem.add_quality_metric(Oversubscription({flag(): 3}))
    with OneshotPlanner(name="cpsat") as planner:
        result = planner.solve(problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert result.plan.activities == []


def test_motions_are_refused_by_name():
    problem = instance("logistics-do-oc-r1-i1").build("fluents", True)
    with OneshotPlanner(name="cpsat") as planner:
        planner.skip_checks = True
        result = planner.solve(problem)
    assert result.status is Status.UNSUPPORTED_PROBLEM
    assert "samp-refine[cpsat]" in result.log_messages[0].message


def test_options_are_checked():
    with pytest.raises(ProblemError, match="speed"):
        OneshotPlanner(name="cpsat", params={"speed": 3})


def test_warm_start():
    problem = shop()
    with OneshotPlanner(name="cpsat", params={"workers": 1}) as planner:
        first = planner.solve(problem)
        again = planner.solve(problem, warm_start_plan=first.plan)
    assert again.metrics["makespan"] == first.metrics["makespan"]


def test_ctrl_c_is_passed_on():
    script = textwrap.dedent(
        """
        import random, signal
        # where the tests run in the background, they and their children ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from unified_planning.shortcuts import *
        from unified_planning.model.scheduling import SchedulingProblem
        import up_samp
        p = SchedulingProblem("hard")
        resources = [p.add_resource(f"m{i}", 1) for i in range(15)]
        r = random.Random(1)
        for j in range(15):
            before = None
            for k in r.sample(range(15), 15):
                a = p.add_activity(f"a{j}_{k}", r.randint(1, 99))
                a.uses(resources[k])
                if before is not None:
                    p.add_constraint(LE(before.end, a.start))
                before = a
        p.add_quality_metric(MinimizeMakespan())
        print("go", flush=True)
        with OneshotPlanner(name="cpsat") as planner:
            planner.solve(p, timeout=120)
        """
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout.readline().strip() == "go" or process.stdout.readline()
        time.sleep(2)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert "KeyboardInterrupt" in errors
