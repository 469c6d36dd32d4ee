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
from up_samp.benchmarks.one_run import RunSpec, select, sweep
from up_samp.benchmarks.runner import execute
from up_samp.model import ProblemError
from up_samp.model.tunable import Tunables
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.tuning import Tuning, changes, read_tuning, tuning_of

ROOT = Path(__file__).parents[2]


def test_a_file_changes_what_it_names(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[search]\ndeals = 3\n[motion.fleet]\nknots = [11, 2]\n")
    tuning = read_tuning(file)
    assert tuning.search.deals == 3
    assert tuning.motion.fleet.knots == (11, 2)
    assert changes(tuning) == {
        "search": {"deals": 3},
        "motion": {"fleet": {"knots": (11, 2)}},
    }
    assert tuning_of(str(file)) == tuning_of(file) == tuning
    assert tuning_of(None) == Tuning() == tuning_of({})
    assert Tuning.read(json.loads(json.dumps(tuning.table()))) == tuning


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[search]\ndeal = 3", "unknown tunable 'search.deal' .*'deals'"),
        ("[serch]\ndeals = 3", "unknown tunable 'serch' .*'search'"),
        ("[motion]\nfleet = 3", "'motion.fleet' is a table"),
        ("[search]\nrounds = -1", "search.rounds: .*0 or more"),
        ("[search]\nrounds = 2.5", "whole number"),
        ("[search]\ncold = nan", "finite number"),
        ("[search]\ncold = true", "finite number"),
        ("[search]\ncold = 1.5", "1 or less"),
        ("[motion.fleet]\nknots = 3", "list of numbers"),
        ("[motion.fleet]\nknots = []", "list of numbers"),
        ("[motion.fleet]\nknots = [1, 'x']", "whole number"),
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
    seen = set()
    for path, part in Tuning().walk():
        assert isinstance(part, Tunables)
        assert type(part).__dataclass_params__.frozen
        assert path not in seen
        seen.add(path)
        for field in dataclasses.fields(part):
            for name in ("unit", "what"):
                assert field.metadata[name], (path, field.name)
    assert len(seen) >= 5


def test_the_page_on_tuning_is_true():
    spec = importlib.util.spec_from_file_location("tuning_page", ROOT / "scripts" / "tuning.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.PAGE.read_text(encoding="utf-8") == script.page(), "run scripts/tuning.py"


def test_components_and_schedulers_get_their_tunables(tmp_path, monkeypatch):
    given = {
        "search": {"deals": 1},
        "cpsat": {"tiny": 0},
    }
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

    tuning = tuning_of({"motion": {"fleet": {"again": 7}}})
    service = MotionService(None, tuning=tuning.motion)
    assert workspace_of(service).tuning.again == 7
    assert MotionService(None).tuning == Tuning().motion
    with pytest.raises(ProblemError, match="must be 0 or more"):
        tuning_of({"motion": {"fleet": {"first": -1}}})


@pytest.mark.parametrize("name", ["samp-refine[cpsat]", "cpsat"])
def test_engines_refuse_unknown_tunables(tmp_path, name):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")
    plain = SchedulingProblem("plain")
    plain.add_activity("work", 3)
    given = {"tuning": {"cpsat": {"tinny": 1}}}
    with (
        OneshotPlanner(name=name, params=given) as planner,
        pytest.raises(ProblemError, match="did you mean 'tiny'"),
    ):
        planner.solve(plain if name == "cpsat" else hall.problem)


def test_a_benchmarks_run_gets_its_tunables_in_its_process(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[cpsat]\ntiny = 0\n")
    chosen = select(["logistics-do-oc-r1-i1"])
    specs = sweep(chosen, ["samp-refine[cpsat]"], tunings=["", _tuning(file)])
    assert [s.tuning for s in specs] == ["", '{"cpsat": {"tiny": 0}}']
    assert len({s.key for s in specs}) == len({s.column for s in specs}) == 2
    wrong = RunSpec(chosen[0].name, "samp-refine[cpsat]", tuning='{"cpsat": {"x": 1}}')
    record = execute(wrong)
    assert "unknown tunable 'cpsat.x'" in record["error"]
