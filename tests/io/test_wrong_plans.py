"""Plan files that say wrong things: every field with every wrong type, and every contradiction."""

import copy
import json
import time

import pytest

from tests import handmade
from up_samp.cli import main
from up_samp.io import check_plan, contradictions, plan_to_dict, read_plan, write_plan
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError

WRONG = (
    None, True, 3, 2.5, -1, 1e308, 10**400, float("nan"), float("inf"), "x", "", "n" * 20_000,
    [], [1], [[1, 2], [3]], [None], {}, {"a": 1}, [{}], [[[]]], [[1e308] * 4],
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return handmade.make(tmp_path_factory.mktemp("hall"))


@pytest.fixture(scope="module")
def data(made):
    return plan_to_dict(made.problem, made.plan, engine="e", status="SOLVED_SATISFICING")


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("script") / "hall_problem.py"
    root = str(handmade.__file__).rsplit("/", 2)[0]
    path.write_text(
        f"import sys\nsys.path.insert(0, {root!r})\n"
        "from pathlib import Path\nfrom tests import handmade\n"
        "problem = handmade.make(Path(__file__).parent).problem\n"
    )
    return str(path)


def fields(value, path=()):
    """Every place in a plan dictionary, rows of samples by their first and last only."""
    if path:
        yield path
    if isinstance(value, dict):
        for key in value:
            yield from fields(value[key], (*path, key))
    elif isinstance(value, list):
        for i in sorted({0, len(value) - 1}) if value else ():
            yield from fields(value[i], (*path, i))


def spoilt(data, path, value):
    """A plan with another value somewhere; all else is shared with the plan that is given."""
    plan = here = copy.copy(data)
    for key in path[:-1]:
        here[key] = here = copy.copy(here[key])
    here[path[-1]] = value
    return plan


def refusal(plan):
    """What check_plan says against a plan, if anything."""
    try:
        check_plan(plan, "the plan")
    except ProblemError as error:
        return str(error)
    return None


def test_every_field_with_every_wrong_type_is_taken_or_refused_by_name(data):
    refused = taken = 0
    for path in fields(data):
        for value in WRONG:
            said = refusal(spoilt(data, path, value))
            if said is None:
                taken += 1
                continue
            refused += 1
            assert len(said) < 400
            keys = [k for k in path if isinstance(k, str)]
            assert any(k[:6] in said for k in keys), (path, said)
    assert refused > 1000
    assert taken > 50


def test_missing_fields_are_named(data):
    for path in fields(data):
        if isinstance(path[-1], str):
            plan = copy.deepcopy(data)
            here = plan
            for key in path[:-1]:
                here = here[key]
            del here[path[-1]]
            said = refusal(plan)
            assert said is None or path[-1] in said


def run(capsys, *arguments):
    code = main(list(map(str, arguments)))
    printed = capsys.readouterr()
    assert "internal error" not in printed.err, printed.err
    assert "Traceback" not in printed.err
    return code, printed.out + printed.err


def odd_plans(data):
    """Plans that pass the check of shapes though one field of each is odd."""
    for path in fields(data):
        for value in (-1, "x", "n" * PRECISION.name, [], {}, None, 9_000_000):
            plan = spoilt(data, path, value)
            if refusal(plan) is None:
                yield path, plan


@pytest.mark.parametrize(
    "every", [pytest.param(24, id="some"), pytest.param(1, id="all", marks=pytest.mark.long)]
)
def test_commands_end_soon_and_without_internal_errors(data, script, tmp_path, capsys, every):
    file = tmp_path / "plan.json"
    plans = list(odd_plans(data))
    assert len(plans) > 80
    for i, (path, plan) in enumerate(plans[::every]):
        file.write_text(json.dumps(plan))
        began = time.process_time()
        run(capsys, "validate", script, file)
        if i % 3 == 0:
            run(capsys, "draw", file, "--out", tmp_path / "out")
        assert time.process_time() - began < 20, path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "is not JSON"),
        ('{"format": "up-samp-plan", "version": 1, "makespan": NaN}', "NaN is no JSON number"),
        ('{"format": "up-samp-plan", "version": ' + "1" * 5000 + "}", "is not JSON"),
        ('{"format": "up-samp-plan", "version": true}', "version True"),
        ("\x00\x01", "is not JSON"),
        ("{}", "is no plan"),
        ('"up-samp-plan"', "is no plan"),
    ],
)
def test_hostile_files_are_refused(text, said, tmp_path):
    file = tmp_path / "plan.json"
    file.write_text(text)
    with pytest.raises(ProblemError, match=said):
        read_plan(file)


def other_map(plan, folder):
    (folder / "other").mkdir()
    yaml = handmade.write_map(folder / "other")
    yaml.write_text(yaml.read_text().replace("0.1\n", "0.2\n"))
    plan["map"]["yaml"] = str(yaml)


CONTRADICTIONS = {
    "problem": (lambda p: p.update(problem="another"), "is for problem 'another', not 'hall'"),
    "status": (lambda p: p.update(status="SOLVED"), "status 'SOLVED'"),
    "makespan": (lambda p: p.update(makespan=1), "makespan 1, but"),
    "bound": (lambda p: p.update(lower_bound=40), "lower bound 40, which is above"),
    "optimal": (lambda p: p.update(lower_bound=3, status="SOLVED_OPTIMALLY"), "called optimal"),
    "no map": (lambda p: p["map"].update(yaml=None), "the plan's map is none"),
    "lost map": (lambda p: p["map"].update(yaml="/nowhere.yaml"), "cannot be read"),
    "small": (
        lambda p: p["objects"][0].update(footprint=[[0, 0], [0.01, 0], [0, 0.01]]),
        "object 'r0' has footprint",
    ),
    "type": (lambda p: p["objects"][0].update(type="van"), "object 'r0' has type van"),
    "model": (lambda p: p["objects"][0].update(model="SE2"), "'r0' has model SE2"),
    "radius": (lambda p: p["objects"][0].update(turning_radius=0.1), "has turning_radius 0.1"),
    "v_max": (lambda p: p["objects"][0].update(v_max=9), "has v_max 9"),
    "a_max": (lambda p: p["objects"][1].pop("a_max"), "object 'r1' has a_max None"),
    "initial": (lambda p: p["objects"][0].update(initial=None), "'r0' has initial None"),
    "moved": (lambda p: p["objects"][2]["initial"].__setitem__(0, 15.1), "object 'door' has init"),
    "no object": (lambda p: p["objects"].pop(1), "'r1' of the problem is not in the plan"),
    "two objects": (lambda p: p["objects"].append(p["objects"][0]), "'r0' is in the plan 2 times"),
    "extra object": (
        lambda p: p["objects"].append({**p["objects"][0], "name": "r7"}),
        "'r7' of the plan is not in the problem",
    ),
    "two activities": (
        lambda p: p["activities"].append(p["activities"][0]),
        "'move_r0_depot0_to_button' is in the plan 2 times",
    ),
    "extra activity": (
        lambda p: p["activities"].append({"name": "x", "start": 0, "end": 1}),
        "activity 'x' of the plan is not in the problem",
    ),
    "parameter": (lambda p: p["activities"][0].update(parameters={"to": "x"}), "no parameter 'to'"),
    "variable": (lambda p: p.update(parameters={"late": True}), "no variable 'late'"),
    "no motion": (
        lambda p: p["motions"].pop(0),
        "motion of 'r0' in activity 'move_r0_depot0_to_button' of the problem is not in",
    ),
    "first copy": (
        lambda p: p["motions"].insert(0, {**p["motions"][0], "samples": [[0.0, 1.0, 1.0, 0.0]]}),
        "motion of 'r0' in activity 'move_r0_depot0_to_button' is in the plan 2 times",
    ),
    "extra motion": (
        lambda p: p["motions"].append(
            {"activity": "open_door_r0", "object": "door", "samples": [[9.0, 15.0, 4.0, 0.0]]}
        ),
        "motion of 'door' in activity 'open_door_r0' of the plan is not in the problem",
    ),
    "no change": (
        lambda p: p["changes"].clear(),
        "change of 'door' by activity 'open_door_r0' of the problem is not in the plan",
    ),
    "two changes": (
        lambda p: p["changes"].append(p["changes"][0]),
        "change of 'door' by activity 'open_door_r0' is in the plan 2 times",
    ),
    "late change": (lambda p: p["changes"][0].update(time=3), "has time 3 in the plan, not 10"),
    "other change": (
        lambda p: p["changes"][0].update(configuration=[15.0, 8.0, 0.0]),
        "has configuration [15.0, 8.0, 0.0] in the plan, not",
    ),
    "extra change": (
        lambda p: p["changes"].append({**p["changes"][0], "activity": "pick_r0_item"}),
        "change of 'door' by activity 'pick_r0_item' of the plan is not in the problem",
    ),
}


@pytest.mark.parametrize("kind", [*CONTRADICTIONS, "another map"])
def test_what_contradicts_the_problem_is_named(kind, made, data, script, tmp_path, capsys):
    plan = copy.deepcopy(data)
    spoil, said = CONTRADICTIONS.get(kind, (None, "is not the problem's map"))
    other_map(plan, tmp_path) if spoil is None else spoil(plan)
    found = contradictions(made.problem, plan)
    assert any(said in f for f in found), found
    if kind in ("problem", "no change", "first copy", "another map"):
        write_plan(tmp_path / "plan.json", plan)
        code, printed = run(capsys, "validate", script, tmp_path / "plan.json")
        assert code == 1
        assert said in printed


def test_good_plans_contradict_nothing(made, data, script, tmp_path, capsys):
    assert contradictions(made.problem, data) == []
    later = {**copy.deepcopy(data), "minor": 9, "weather": "fine"}
    later["objects"][0]["colour"] = "red"
    assert contradictions(made.problem, later) == []
    file = write_plan(tmp_path / "plan.json", later)
    assert run(capsys, "validate", script, file)[0] == 0
    rounded = plan_to_dict(made.problem, made.plan, seconds_per_unit=1 / 3)
    assert contradictions(made.problem, rounded) == []
