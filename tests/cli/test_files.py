"""Results are never lost: folders are checked first, files written whole, names escaped."""

import errno
import os
import re
import shutil
import subprocess
import sys

import pytest

from tests import handmade
from up_samp.cli import main
from up_samp.io import plan_to_dict, read_plan
from up_samp.model import ProblemError
from up_samp.plotting import animation_html, write_html, write_outputs
from up_samp.system import child
from up_samp.system.files import check_folder, whole, write_whole

NAMES = ("</script><script>document.title='broken'</script>", "<!--<script>", "{{scene}}", "a&b<i>")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    made = handmade.make(tmp_path_factory.mktemp("hall"))
    return plan_to_dict(made.problem, made.plan, engine="e", status="SOLVED_SATISFICING")


def test_files_appear_whole_or_not_at_all(tmp_path):
    path = tmp_path / "file"
    write_whole(path, "first")
    for error in (OSError(errno.ENOSPC, "full"), KeyboardInterrupt(), RuntimeError("bug")):
        with pytest.raises(type(error)):
            fail_while_writing(path, error)
        assert path.read_text() == "first"
        assert [p.name for p in tmp_path.iterdir()] == ["file"]
    write_whole(path, "second")
    assert path.read_text() == "second"
    assert path.stat().st_mode & 0o077 == 0o077 & 0o666 & ~current_umask()


def fail_while_writing(path, error):
    with whole(path) as stream:
        stream.write(b"half of the sec")
        raise error


def current_umask():
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def test_every_output_is_whole_where_the_disk_is_full(data, tmp_path):
    """A limit on the size of files stands for the disk: old files stay, nothing half-written."""
    script = (
        "import json, resource, signal, sys\n"
        "from pathlib import Path\n"
        "from up_samp.plotting import write_outputs\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))\n"
        "plan = json.load(sys.stdin)\n"
        "try:\n    write_outputs(plan, Path(sys.argv[1]))\n"
        "except OSError as error:\n    print(error.strerror)\n"
    )
    import json

    (tmp_path / "plan.json").write_text("old")
    done = subprocess.run(
        child.command(script, [str(tmp_path)]),
        env=child.environment(),
        input=json.dumps(data),
        capture_output=True,
        text=True,
    )
    assert "File too large" in done.stdout, done.stderr
    assert {p.name for p in tmp_path.iterdir()} == {"plan.json"}
    assert (tmp_path / "plan.json").read_text() == "old"


def test_the_folder_is_checked_before_solving(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for option in ("--out", "--trace"):
        code = main(["solve", "jobshop-r1-j1-m1", option, str(tmp_path / "file" / "x")])
        error = capsys.readouterr().err
        assert code == 2
        assert f"{option}: cannot write to" in error
        assert "prepare" not in error
    with pytest.raises(ProblemError, match="cannot write"):
        check_folder(tmp_path / "file", "--out")


SOLVE = """
import sys, types
sys.path.insert(0, {root!r})
import os
from pathlib import Path
from tests import handmade
from unified_planning.engines import PlanGenerationResult, PlanGenerationResultStatus as S
from up_samp import plotting
from up_samp.cli import solving, main, commands
plotting.write_outputs = lambda *given, **named: []  # what is looked at is written before
solving._with_dependencies = lambda problem, plan: plan
made = handmade.make(Path({folder!r}))
made.problem.name = "Fabrik-Süd → 東"
result = PlanGenerationResult(S.SOLVED_SATISFICING, made.plan, "e", metrics={{}})
solving._solve = lambda *given: result
commands.find_problem = lambda *a: made.problem
sys.argv = ["up-samp", "solve", "x", "--out", {folder!r}]
sys.exit(main())
"""


@pytest.mark.parametrize("how", ["ascii", "closed", "full"])
def test_a_plan_is_not_lost_with_standard_output(tmp_path, how):
    root = str(handmade.__file__).rsplit("/", 2)[0]
    code = SOLVE.format(root=root, folder=str(tmp_path))
    command = child.command(code)
    env = child.environment({"PYTHONIOENCODING": "ascii"} if how == "ascii" else {})
    if how == "closed":
        command = ["sh", "-c", 'exec "$@" >&-', "sh", *command]
    if how == "full":
        command = ["sh", "-c", 'exec "$@" >/dev/full', "sh", *command]
    done = subprocess.run(command, env=env, capture_output=True, timeout=120)
    assert read_plan(tmp_path / "plan.json")["makespan"] == 26
    if how == "full":
        assert done.returncode == 2
        assert b"No space left" in done.stderr
    else:
        assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize("name", ["plan.toml", "dir/problem", "problem.txt", "x.pyc"])
def test_a_problem_file_is_known_by_its_suffix(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dir").mkdir()
    (tmp_path / name).write_text("open('run', 'w')")
    assert main(["solve", name]) == 2
    assert "is no problem file" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def named(data, name):
    """The plan with an object, a problem and an activity of that name."""
    text = repr(data)
    plan = eval(text)
    plan["problem"] = name
    for entry in (*plan["objects"], *plan["motions"]):
        for key in ("name", "object"):
            if entry.get(key) == "r0":
                entry[key] = name
    plan["activities"][0]["name"] = plan["motions"][0]["activity"] = f"go {name}"
    return plan


@pytest.mark.parametrize("name", NAMES)
def test_names_are_data_in_the_page(data, name):
    page = animation_html(named(data, name))
    assert page.count("<script") == page.count("</script") == 1
    assert "<!--" not in page
    assert re.search(r"const scene = \{.*\};", page)


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs a browser")
@pytest.mark.parametrize("name", NAMES[:3])
def test_a_browser_shows_the_page(data, name, tmp_path):
    page = write_html(named(data, name), tmp_path / "page.html")
    done = subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/b",
         "--virtual-time-budget=3000", "--dump-dom", page.as_uri()],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    shown = re.sub(r"(?s)<script.*</script>", "", done.stdout)
    assert re.search(r'id="clock"[^>]*>\s*[\d.]+ / [\d.]+ s', shown), done.stdout[-2000:]
    assert "<title>broken" not in done.stdout


def test_long_names_are_drawn_short(data, tmp_path):
    plan = named(data, "n" * 900)
    files = write_outputs(plan, tmp_path)
    assert {f.name for f in files} == {"plan.json", "gantt.png", "map.png", "animation.html"}
    assert "n" * 100 not in (tmp_path / "animation.html").read_text()
    assert sys.getsizeof((tmp_path / "gantt.png").read_bytes()) > 1000


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "site.py",
            "fleet = 1",
            "is a Python script, and a problem file (*.yaml, *.json) is needed",
        ),
        ("plan.json", '{"format": "up-samp-plan"}', "is a plan, and a problem file is needed"),
        ("empty.yaml", "\n", "is empty; a problem file has keys such as map"),
        ("folder", None, "is a folder; name the file in it"),
    ],
)
@pytest.mark.parametrize("command", ["check", "day"])
def test_a_command_says_which_file_it_takes(command, name, text, said, tmp_path, capsys):
    path = tmp_path / name
    if text is None:
        path.mkdir()
    else:
        path.write_text(text)
    assert main([command, str(path)]) == 2
    told = capsys.readouterr().err
    assert name in told
    assert said in told
    assert len(told.splitlines()) == 1
