import io
import math
import subprocess
import sys

import pytest
from unified_planning.engines import PlanGenerationResult, PlanGenerationResultStatus

import up_samp.cli
from tests import handmade
from up_samp import cli
from up_samp.cli import main, solving
from up_samp.cli.solving import Progress, schedule_table, table
from up_samp.execution import with_dependencies
from up_samp.io import plan_to_dict, read_plan, write_plan
from up_samp.search.knowledge import ProgressEvent

SCRIPT = """
import sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests import handmade
{body}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return handmade.make(tmp_path_factory.mktemp("hall"))


@pytest.fixture
def script(tmp_path):
    """Write a problem script with the given last lines."""

    def write(body="problem = handmade.make(Path(__file__).parent).problem"):
        root = str(handmade.__file__).rsplit("/", 2)[0]
        path = tmp_path / "hall_problem.py"
        path.write_text(SCRIPT.format(root=root, body=body))
        return str(path)

    return write


class Planner:
    """Stands for UP's OneshotPlanner and gives a result that was made by hand."""

    def __init__(self, result, seen):
        self.result, self.seen = result, seen

    def __call__(self, *, name, params):
        self.seen.update(params, name=name)
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def solve(self, problem, timeout):
        self.seen["timeout"] = timeout
        event = ProgressEvent(1, "schedule", "7 activities", 20, None, 0.2)
        self.seen["progress"](event)
        if isinstance(self.result, BaseException):
            raise self.result
        return self.result


@pytest.fixture
def answer(monkeypatch):
    """Let the solver answer with a given plan, status or exception; return what it was asked."""

    def give(plan=None, status="SOLVED_SATISFICING", error=None):
        seen = {}
        result = error or PlanGenerationResult(
            PlanGenerationResultStatus[status],
            plan,
            "samp-refine[aries]",
            metrics={"lower_bound": "20", "rounds": "3", "bound_kind": "absolute"},
            log_messages=[],
        )
        monkeypatch.setattr(solving, "OneshotPlanner", Planner(result, seen))
        return seen

    return give


def test_solve_prints_schedule_and_verdict_and_writes_files(made, script, answer, capsys, tmp_path):
    seen = answer(made.plan)
    out = tmp_path / "out"
    code = main(["solve", script(), "--out", str(out), "--timeout", "9", "--seed", "3"])
    printed = capsys.readouterr()
    assert code == 0
    assert "move_r0_depot0_to_button" in printed.out
    assert "SOLVED_SATISFICING: makespan 26 (proven lower bound 20, absolute)" in printed.out
    assert "valid: the independent validator found nothing wrong" in printed.out
    assert "round 1: schedule - 7 activities (makespan >= 20)" in printed.err
    assert sorted(p.name for p in out.iterdir()) == [
        "animation.html", "gantt.png", "map.png", "plan.json",
    ]  # fmt: skip
    assert read_plan(out / "plan.json")["makespan"] == 26
    name = f"samp-refine[{solving.DEFAULT_ENGINE}]"
    assert (seen["name"], seen["timeout"], seen["seed"]) == (name, 9.0, 3)


def test_an_invalid_plan_is_told_and_fails(made, script, answer, capsys, tmp_path):
    bad = handmade.make(tmp_path)
    bad.plan.set(bad.pick.start, 25)
    answer(bad.plan)
    assert main(["solve", script(), "--engine", "samp-refine[cpse]"]) == 1
    assert "INVALID: " in capsys.readouterr().out


def test_no_plan_fails(script, answer, capsys):
    answer(None, "TIMEOUT")
    assert main(["solve", script()]) == 1
    assert "no plan, TIMEOUT" in capsys.readouterr().out


def test_ctrl_c_is_130(script, answer, capsys):
    answer(error=KeyboardInterrupt())
    assert main(["solve", script()]) == 130
    assert capsys.readouterr().err.endswith("up-samp: stopped\n")


def test_ctrl_c_while_a_library_is_loaded_is_130(script, answer, capsys):
    wrapped = RuntimeError("Error calling __set_name__")
    wrapped.__cause__ = KeyboardInterrupt()
    answer(error=wrapped)
    assert main(["solve", script()]) == 130
    assert capsys.readouterr().err.endswith("up-samp: stopped\n")


def test_bugs_are_one_line_unless_debugging(script, answer, capsys):
    answer(error=RuntimeError("spam"))
    assert main(["solve", script()]) == 2
    assert "internal error, RuntimeError: spam" in capsys.readouterr().err
    with pytest.raises(RuntimeError):
        main(["--debug", "solve", script()])


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("x = 1", "defines neither 'problem' nor 'get_problem()'"),
        ("problem = 3", "is a int; a SchedulingMotionProblem"),
        ("problem = 1 / 0", "failed at line 6: ZeroDivisionError"),
        ("problem = (", "SyntaxError"),
        ("sys.exit(3)", r"left by sys.exit(3)"),
    ],
)
def test_scripts_that_fail_are_told_of(script, body, message, capsys):
    assert main(["solve", script(body)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_get_problem_is_called(made, script, answer, capsys):
    answer(made.plan)
    body = "def get_problem():\n    return handmade.make(Path(__file__).parent).problem"
    assert main(["solve", script(body)]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve", "nowhere.py"], "there is no file 'nowhere.py'"),
        (["solve", "logistics-of-another-kind"], "logistics-of-another-kind"),
        (["validate", "nowhere.py", "none.json"], "none.json' cannot be read"),
        (["draw", "none.json"], "none.json' cannot be read"),
        (
            ["solve", "SCRIPT", "--engine", "nobody"],
            "no engine 'samp-refine[nobody]'; there are: samp-refine[",
        ),
    ],
)
def test_errors_are_one_line(arguments, message, script, capsys):
    arguments = [script() if a == "SCRIPT" else a for a in arguments]
    assert main(arguments) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("up-samp: ")
    assert message in lines[-1]


@pytest.mark.parametrize("arguments", [[], ["dance"], ["demo", "--timeout", "0"]])
def test_wrong_usage_is_argparse_s(arguments, capsys):
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2


def test_validate_and_draw_a_plan_file(made, script, tmp_path, capsys):
    plan = plan_to_dict(made.problem, made.plan)
    good = write_plan(tmp_path / "plan.json", plan)
    assert main(["validate", script(), str(good)]) == 0
    assert capsys.readouterr().out.startswith("valid")
    for row in plan["motions"][0]["samples"]:
        row[2] += 3.0
    bad = write_plan(tmp_path / "bad.json", plan)
    assert main(["validate", script(), str(bad)]) == 1
    assert "INVALID" in capsys.readouterr().out
    assert main(["draw", str(good), "--out", str(tmp_path / "drawn")]) == 0
    assert {p.name for p in (tmp_path / "drawn").iterdir()} == {
        "animation.html", "gantt.png", "map.png",
    }  # fmt: skip


def test_engines_lists_what_is_registered(capsys):
    assert main(["engines"]) == 0
    printed = capsys.readouterr().out
    for name in ("aries-opt", "cpsat", "samp-refine[aries]", "samp-validator"):
        assert name in printed


def test_bench_is_delegated(capsys):
    assert main(["bench", "list", "jobshop"]) == 0
    assert "jobshop-r1-j1-m1" in capsys.readouterr().out


def test_problems_without_motions_are_scheduled_too(script, capsys, tmp_path):
    body = (
        "from unified_planning.shortcuts import *\n"
        "from unified_planning.model.scheduling import SchedulingProblem\n"
        "problem = SchedulingProblem('plain')\n"
        "a = problem.add_activity('a', duration=3)\n"
        "b = problem.add_activity('b', duration=4)\n"
        "problem.add_constraint(LT(a.end, b.start))\n"
        "problem.add_quality_metric(MinimizeMakespan())\n"
    )
    out = tmp_path / "out"
    arguments = ["solve", script(body), "--engine", "cpsat", "--out", str(out)]
    assert main(arguments) == 0, capsys.readouterr().err
    assert "makespan 8" in capsys.readouterr().out
    assert {p.name for p in out.iterdir()} == {"plan.json", "gantt.png"}


class Screen(io.StringIO):
    def isatty(self):
        return True


def event(**given):
    values = {"round": 0, "phase": "p", "message": "", "lower_bound": None, "upper_bound": None}
    return ProgressEvent(**{**values, "elapsed": 1.0, **given})


def test_progress_on_a_terminal_is_one_line_that_goes_away():
    screen = Screen()
    with Progress(screen) as progress:
        progress(event(phase="x" * 500))
        progress(event(phase="second", upper_bound=7))
    text = screen.getvalue()
    assert "\n" not in text
    assert "second (makespan <= 7)" in text
    assert text.endswith("\r\x1b[2K")
    assert max(len(part) for part in text.split("\r\x1b[2K")) < 500


def test_a_line_for_each_better_plan_stays_on_a_terminal():
    screen = Screen()
    with Progress(screen) as progress:
        for makespan in (9, 8):
            progress(event(phase="plan", message=f"plan with makespan {makespan}"))
            progress(event(phase="schedule"))
    kept = [line.rpartition("\x1b[2K")[2] for line in screen.getvalue().split("\n")[:-1]]
    assert [line.rpartition(" ")[2] for line in kept] == ["9", "8"]


def test_what_is_maximised_is_shown_as_its_value():
    stream = io.StringIO()
    with Progress(stream) as progress:
        progress(event(lower_bound=-5, upper_bound=-3, named="gain", sign=-1))
    assert stream.getvalue().rstrip().endswith("(gain >= 3, <= 5)")


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ([], {}),
        (["--first"], {"first_plan": True}),
        (["--timeout", "9"], {"patience": math.inf}),
        (["--timeout", "9", "--patience", "2"], {"patience": 2.0}),
        (["--optimal"], {"optimal": True}),
    ],
)
def test_how_long_a_solve_goes_on(made, script, answer, given, wanted):
    seen = answer(made.plan)
    assert main(["solve", script(), *given]) == 0
    told = {k: seen[k] for k in ("first_plan", "patience", "optimal") if k in seen}
    assert told == wanted
    assert seen["timeout"] == (9.0 if "--timeout" in given else 120.0)


def test_progress_elsewhere_is_not_repeated():
    stream = io.StringIO()
    with Progress(stream) as progress:
        for i in range(50):
            progress(event(round=i, phase=("a", "b")[i % 2]))
        progress(event(phase="a", lower_bound=3))
    assert len(stream.getvalue().splitlines()) == 3


def test_tables_are_aligned(made):
    text = table(("a", "bb"), [("1", "x"), ("22", "yyy")], right=(0,))
    assert text.splitlines() == [" a  bb", "--  ---", " 1  x", "22  yyy"]
    lines = schedule_table(plan_to_dict(made.problem, made.plan)).splitlines()
    assert lines[0].split() == ["start", "end", "length", "activity", "moves", "driving"]
    assert any(line.split()[3:5] == ["open_door_r0", "door"] for line in lines)


def test_the_command_is_installed():
    done = subprocess.run(
        [sys.executable, "-m", "up_samp", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == f"up-samp {up_samp.__version__}"


def test_simulate_prints_a_table_and_writes_files(made, tmp_path, capsys):
    plan = write_plan(
        tmp_path / "plan.json",
        with_dependencies(made.problem, plan_to_dict(made.problem, made.plan)),
    )
    out = tmp_path / "out"
    code = main(["simulate", str(plan), "--delays", "30%", "--runs", "2", "--out", str(out)])
    assert code == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:5]] == ["timed", "staircase", "reorder"]
    assert len((out / "runs.csv").read_text().splitlines()) == 7
    record = read_plan(out / "executed-staircase.json")
    assert len(record["activities"]) == 6
    assert (out / "executed-staircase.png").stat().st_size > 1000
    assert main(["draw", str(out / "executed-staircase.json"), "--out", str(tmp_path / "d")]) == 0
    assert main(["simulate", str(plan), "--delays", "fast=2"]) == 2
    assert "NAME=NUMBER of slow" in capsys.readouterr().err


def test_a_command_loads_what_it_needs_and_no_other():
    """The version is told at once: what commands import takes a second and more."""
    told = (
        "import sys; from up_samp.cli import main\n"
        "try: main(['--version'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numba', 'numpy', 'ortools', 'unified_planning.model'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("up-samp ")
    words = cli.make_parser(list(cli.COMMANDS)).format_help().split()
    assert set(cli.COMMANDS) <= set(words)
    for name in cli.COMMANDS:
        with pytest.raises(SystemExit) as ended:
            cli.main([name, "--help"])
        assert ended.value.code == 0, name
