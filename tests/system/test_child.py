"""Child processes run what this process would, whatever lies in the current folder."""

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from up_samp.geometry import OccupancyGrid
from up_samp.model import (
    Body,
    ControlLaw,
    Deadline,
    Kinematics,
    MotionModel,
    ScheduleStatus,
    UnsupportedError,
)
from up_samp.motion import MotionService
from up_samp.motion.batch import precompute
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

    with open_scheduler(doubles.InSequence, two_after_each_other()) as scheduler:
        report = scheduler.solve(Deadline.after(10.0))
    assert report.status is ScheduleStatus.FOUND, report.message
    assert not list(trap.iterdir())


def test_planning_ahead_does_not_run_the_current_folder(trap):
    service = MotionService(OccupancyGrid(np.zeros((40, 40), dtype=bool), 0.25))
    disc = Body(((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)), Kinematics(MotionModel.SE2))
    ends = [(2.0, 2.0, 0.0), (8.0, 8.0, 0.0), (2.0, 8.0, 0.0)]
    pairs = [(disc, ends[0], ends[1]), (disc, ends[1], ends[2])]
    assert precompute(service, pairs, processes=2) == 2
    assert not list(trap.iterdir())


def test_planning_ahead_names_what_cannot_be_sent():
    law = ControlLaw(lambda q, u, qdot: None, (("v", 0.0, 1.0),), "r0")
    moved = Body(
        ((-0.2, -0.2), (0.2, -0.2), (0.0, 0.2)), Kinematics(MotionModel.CONTROL, control=law)
    )
    service = MotionService(OccupancyGrid(np.zeros((40, 40), dtype=bool), 0.25))
    pairs = [(moved, (2.0, 2.0, 0.0), (8.0, y, 0.0)) for y in (2.0, 8.0)]
    with pytest.raises(UnsupportedError, match="processes=1"):
        precompute(service, pairs, processes=2)


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
        until = time.monotonic() + 30
        while not (note.exists() and note.read_text()) and time.monotonic() < until:
            time.sleep(0.05)
        pid = int(note.read_text())
    finally:
        parent.terminate()
        parent.wait()
    until = time.monotonic() + 10
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
