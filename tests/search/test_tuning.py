"""Tunables: read, checked, and handed on to whoever is to heed them."""

import dataclasses
import importlib.util
import json
from pathlib import Path

import pytest
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import OneshotPlanner

from tests.upio.hall import Hall
from up_samp.benchmarks.cli import _tuning
from up_samp.benchmarks.runner import RunSpec, execute, select, sweep
from up_samp.model import ProblemError
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.tuning import Tuning, read_tuning, tuning_of

ROOT = Path(__file__).parents[2]


def test_a_file_changes_what_it_names(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("exchanges = 3\nknots = [11, 2]\n")
    tuning = read_tuning(file)
    assert tuning.changes() == {"exchanges": 3, "knots": (11, 2)}
    assert tuning_of(str(file)) == tuning_of(file) == tuning
    assert tuning_of(None) == Tuning() == tuning_of({})
    assert tuning_of(json.loads(json.dumps(tuning.changes()))) == tuning


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("exchange = 3", "unknown tunable 'exchange' .*'exchanges'"),
        ("[search]\nexchanges = 3", "unknown tunable 'search' .*known: large"),
        ("exchanges = -1", "'exchanges' must be 0 or more"),
        ("exchanges = 2.5", "whole number"),
        ("cold = nan", "finite number"),
        ("cold = true", "finite number"),
        ("cold = 1.5", "1 or less"),
        ("knots = 3", "list of numbers"),
        ("knots = []", "list of numbers"),
        ("knots = [1, 'x']", "whole number"),
        ("[cpsat", "tuning file"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused_by_name(tmp_path, text, message):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(ProblemError, match=message) as error:
        read_tuning(file)
    assert "mine.toml" in str(error.value)


@pytest.mark.parametrize("given", [3, ["a"], "/no/such/file.toml"])
def test_what_is_no_tuning_is_refused(given):
    with pytest.raises(ProblemError, match="tuning"):
        tuning_of(given)


def test_every_tunable_tells_what_it_is():
    for field in dataclasses.fields(Tuning):
        assert field.metadata["unit"], field.name
        assert field.metadata["what"], field.name
        assert (ROOT / "up_samp" / field.metadata["room"]).is_dir(), field.name


def test_the_page_on_tuning_is_true():
    spec = importlib.util.spec_from_file_location("tuning_page", ROOT / "scripts" / "tuning.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.PAGE.read_text(encoding="utf-8") == script.page(), "run scripts/tuning.py"


def test_components_and_schedulers_get_their_tunables(tmp_path, monkeypatch):
    given = {"exchanges": 1, "tiny": 0}
    sessions = []
    init = CpsatSession.__init__

    def spy(self, *args, **keywords):
        init(self, *args, **keywords)
        sessions.append(self.tuning.tiny)

    monkeypatch.setattr(CpsatSession, "__init__", spy)
    hall = Hall(tmp_path, robots=2)
    for robot in (0, 1):
        hall.move(f"go{robot}", robot, f"left{robot}", f"right{robot}")
    with OneshotPlanner(name="samp-refine[cpsat]", params={"tuning": given}) as planner:
        result = planner.solve(hall.problem, timeout=60)
    assert result.plan is not None
    assert set(sessions) == {0}


def test_motion_planning_gets_its_tunables():
    from up_samp.motion import MotionService
    from up_samp.motion.fleet.workspace import workspace_of

    service = MotionService(None, tuning=tuning_of({"knots": [7]}))
    assert workspace_of(service).tuning.knots == (7,)
    assert MotionService(None).tuning == Tuning()
    with pytest.raises(ProblemError, match="must be 1 or more"):
        tuning_of({"knots": [0]})


@pytest.mark.parametrize("name", ["samp-refine[cpsat]", "cpsat"])
def test_engines_refuse_unknown_tunables(tmp_path, name):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")
    plain = SchedulingProblem("plain")
    plain.add_activity("work", 3)
    given = {"tuning": {"tinny": 1}}
    with (
        OneshotPlanner(name=name, params=given) as planner,
        pytest.raises(ProblemError, match="did you mean 'tiny'"),
    ):
        planner.solve(plain if name == "cpsat" else hall.problem)


def test_a_benchmarks_run_gets_its_tunables_in_its_process(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("tiny = 0\n")
    chosen = select(["logistics-do-oc-r1-i1"])
    specs = sweep(chosen, ["samp-refine[cpsat]"], tunings=["", _tuning(file)])
    assert [s.tuning for s in specs] == ["", '{"tiny": 0}']
    assert len({s.key for s in specs}) == len({s.column for s in specs}) == 2
    wrong = RunSpec(chosen[0].name, "samp-refine[cpsat]", tuning='{"x": 1}')
    record = execute(wrong)
    assert "unknown tunable 'x'" in record["error"]
