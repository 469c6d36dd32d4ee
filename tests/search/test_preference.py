"""What UP takes for problems with motions; robots with a motion and a control model."""

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.usual import usually
from up_samp.benchmarks import door_sequence, logistics, navigation
from up_samp.model import MotionModel
from up_samp.motion.protocol import MotionCache
from up_samp.upio import read_problem
from up_samp.validation import validate_plan
from up_samp.validation.kinematics import limits_of


def test_up_chooses_our_scheduler_for_problems_with_motions():
    problem = logistics(1, 1)
    with OneshotPlanner(problem_kind=problem.kind) as planner:
        assert planner.name == "samp-refine[cpsat]"
    names = get_environment().factory.preference_list
    assert len(names) == len(set(names))


@pytest.mark.parametrize("build", [navigation, door_sequence])
def test_reader_and_validator_read_both_models_alike(build):
    problem = build(1)
    read = read_problem(problem).objects["robot0"].body.kinematics
    judged = limits_of(problem.object("robot0"))
    assert read.model is MotionModel.REEDSSHEPP
    assert judged.model == "REEDSSHEPP"
    assert (read.v_max, judged.v_max, judged.v_back) == (20.0, 20.0, 20.0)
    assert read.a_max == judged.a_max == 1.0
    assert read.turning_radius == pytest.approx(judged.turning_radius)


def test_navigation_by_cars():
    problem = navigation(2, metric=False)
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem, timeout=60)
    assert validate_plan(problem, result.plan).valid


@pytest.fixture(scope="module")
def motions():
    """What all forms of a problem drive is planned once."""
    return MotionCache()


ENCODINGS = ("fluents", "fluents-uses", "no-fluents", "no-fluents-uses")


@pytest.mark.parametrize("encoding", usually("fluents-uses", "no-fluents", of=ENCODINGS))
def test_published_forms_have_one_optimum(encoding, motions):
    problem = logistics(1, 1, sides="corridor", encoding=encoding)
    with OneshotPlanner(
        name="samp-refine[cpsat]", params={"optimal": True, "cache": motions}
    ) as planner:
        result = planner.solve(problem, timeout=60)
    assert validate_plan(problem, result.plan).valid
    makespan, bound = (int(result.metrics[k]) for k in ("makespan", "lower_bound"))
    assert makespan == bound == 46
