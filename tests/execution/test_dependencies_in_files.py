import json
from importlib.resources import files

import jsonschema
import pytest

from tests.execution import floors
from up_samp.execution import Delays, Executor, dependencies_of, simulate, with_dependencies
from up_samp.io import check_plan, read_plan, write_plan
from up_samp.model import ProblemError


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    yaml = floors.hall(tmp_path_factory.mktemp("hall"))
    return floors.random_floor(3, yaml)


@pytest.fixture(scope="module")
def schema():
    return json.loads((files("up_samp.io") / "plan.schema.json").read_text())


def test_a_plan_with_dependencies_fits_the_schema(made, schema):
    problem, plan = made
    jsonschema.Draft7Validator.check_schema(schema)
    validator = jsonschema.Draft7Validator(schema)
    validator.validate(plan)  # version 1.0
    full = with_dependencies(problem, plan)
    # minor versions only add fields: the second way of some orders is new in 3
    plain = with_dependencies(problem, plan, localisation=0.0)
    assert plain["minor"] == (3 if plain["dependencies"].get("choices") else 1)
    assert not {"localisation", "narrow"} & plain["dependencies"].keys()
    assert (full["minor"], full["dependencies"]["localisation"]) == (5, 0.05)
    assert full["dependencies"]["edges"]
    validator.validate(full)
    full["dependencies"]["edges"][0]["first"] = ["reach", "a", "b"]
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(full)


def test_a_plan_file_is_followed_like_the_plan_with_its_problem(made, tmp_path):
    """The file alone says as much as plan and problem: the same run, second by second."""
    problem, plan = made
    found = dependencies_of(problem, plan)
    path = write_plan(tmp_path / "plan.json", with_dependencies(problem, plan))
    read = read_plan(path)
    again = Executor(read).dependencies
    assert again.choices == found.choices
    assert [e.free for e in again.graph.edges] == [e.free for e in found.graph.edges]
    delays = Delays.of_share(0.5)
    for seed in range(3):
        one = simulate(found, plan, delays, seed)
        two = simulate(again, read, delays, seed)
        assert one.makespan == two.makespan
        assert one.record["activities"] == two.record["activities"]
        assert one.record["motions"] == two.record["motions"]


def test_progress_belongs_to_the_samples(made):
    problem, plan = made
    for motion in with_dependencies(problem, plan)["motions"]:
        assert len(motion["progress"]) == len(motion["samples"])
        assert motion["progress"] == sorted(motion["progress"])
        assert motion["progress"][0] == 0.0


def test_wrong_files_are_refused_by_name(made):
    problem, plan = made
    with pytest.raises(ProblemError, match="no dependencies: give its problem"):
        Executor(plan)
    full = with_dependencies(problem, plan)
    with pytest.raises(ProblemError, match="'minor'"):
        check_plan({**full, "minor": "1"}, "x")
    with pytest.raises(ProblemError, match="'dependencies'"):
        check_plan({**full, "dependencies": []}, "x")
    broken = json.loads(json.dumps(full))
    broken["dependencies"]["edges"][0]["then"] = ["start", "nobody"]
    with pytest.raises(ProblemError, match="speak of nobody, which is not in the plan"):
        Executor(broken)
    ring = json.loads(json.dumps(full))
    for edge in list(ring["dependencies"]["edges"]):
        ring["dependencies"]["edges"].append({**edge, "first": edge["then"], "then": edge["first"]})
    with pytest.raises(ProblemError, match="cycle"):
        Executor(ring)
