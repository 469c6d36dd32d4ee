"""Two threads that solve problems of their own do not disturb each other."""

import threading

from unified_planning.shortcuts import OneshotPlanner

from tests.fuzz.problems import SECONDS, build, random_case
from up_samp.model import Deadline, OutOfTimeError
from up_samp.model.deadline import check_time, in_force
from up_samp.validation import validate_plan

SEEDS = ((101, 103, 104), (106, 107, 108))


def solve(problem):
    params = {"seconds_per_unit": SECONDS, "reproducible": True}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=60)


def test_two_threads_find_what_one_does(tmp_path):
    problems = {}
    for seed in (s for seeds in SEEDS for s in seeds):
        folder = tmp_path / str(seed)
        folder.mkdir()
        # UP's environment, in which problems are written, is not for several threads
        problems[seed] = build(random_case(seed), folder)
    found = {}

    def work(seeds):
        for seed in seeds:
            found[seed] = solve(problems[seed])

    threads = [threading.Thread(target=work, args=(seeds,)) for seeds in SEEDS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(found) == set(problems)
    for seed, problem in problems.items():
        alone, beside = solve(problem), found[seed]
        assert alone.status == beside.status
        assert alone.metrics["makespan"] == beside.metrics["makespan"]
        assert validate_plan(problem, beside.plan, seconds_per_unit=SECONDS).valid


def test_a_deadline_in_force_is_that_of_its_thread():
    seen = []

    def other():
        try:
            check_time()
            seen.append("free")
        except OutOfTimeError:
            seen.append("late")

    with in_force(Deadline.after(0.0)):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert seen == ["free"]
