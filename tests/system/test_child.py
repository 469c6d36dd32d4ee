"""Child processes run what this process would, whatever lies in the current folder."""

import json
import os
import subprocess
import sys
import time

import pytest

from up_samp.model import (
    Deadline,
    ScheduleStatus,
)
from up_samp.scheduling import open_scheduler
from up_samp.system import child

NAMES = (
    "importlib", "linecache", "numpy", "numba", "pickle", "queue", "types", "unified_planning",
    "encodings", "typing", "struct", "up_samp", "json", "threading", "site",
)  # fmt: skip


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """Go to a folder full of modules that leave a mark when they are run."""
    marks = tmp_path / "marks"
    marks.mkdir()
    folder = tmp_path / "trap"
    folder.mkdir()
    for i, name in enumerate(NAMES):
        code = f"open({str(marks / name)!r}, 'w').close()\nraise SystemExit('trapped by {name}')\n"
        if i % 2:
            (folder / f"{name}.py").write_text(code)
        else:
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text(code)
    monkeypatch.chdir(folder)
    # what a console script has: no relative entries
    monkeypatch.setattr(sys, "path", [p for p in sys.path if os.path.isabs(p)])
    return marks


def run(code, *arguments):
    command = child.command(code, arguments)
    return subprocess.run(
        command, env=child.environment(), capture_output=True, text=True, timeout=60
    )


def test_the_current_folder_is_not_run(trap):
    done = run("import json, numpy, pickle, linecache\nprint(json.dumps(sys.argv))", "a", "b c")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == ["-c", "a", "b c"]
    assert not list(trap.iterdir())


def test_workers_do_not_run_the_current_folder(trap):
    from tests.scheduling import doubles
    from tests.scheduling.problems import two_after_each_other

    with open_scheduler(doubles.Raising, two_after_each_other()) as scheduler:
        report = scheduler.solve(Deadline.after(60.0))
    assert report.status is ScheduleStatus.ERROR
    assert "ValueError: no idea" in report.message  # the engine has been run
    assert not list(trap.iterdir())


def test_a_child_finds_what_its_parent_finds(tmp_path, monkeypatch):
    (tmp_path / "of_the_script.py").write_text("value = 3\n")
    (tmp_path / "of_the_session.py").write_text("value = 4\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    done = run("import of_the_session as s, of_the_script as t; print(s.value + t.value)")
    assert done.stdout.strip() == "7", done.stderr


def test_a_bare_child_registers_nothing():
    code = child.bare("os").replace(".main()", ".getpid()")
    done = run(code + "print('up_samp.engines.registration' in sys.modules)")
    assert done.stdout.strip() == "False", done.stderr


def test_a_child_ends_with_its_parent(tmp_path):
    note = tmp_path / "pid"
    middle = (
        "import subprocess, sys, time\n"
        "from up_samp.system import child\n"
        "code = 'import sys, time; from up_samp.system import child;'"
        " 'child.die_with(0); time.sleep(60)'\n"
        "p = subprocess.Popen(child.command(code), env=child.environment(),"
        " stdin=subprocess.PIPE, start_new_session=True)\n"
        f"open({str(note)!r}, 'w').write(str(p.pid))\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen(child.command(middle), env=child.environment())
    try:
        until = time.monotonic() + 120
        while not (note.exists() and note.read_text()) and time.monotonic() < until:
            time.sleep(0.05)
        pid = int(note.read_text())
    finally:
        parent.terminate()
        parent.wait()
    until = time.monotonic() + 60
    while is_alive(pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert not is_alive(pid)


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat", encoding="utf-8") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
