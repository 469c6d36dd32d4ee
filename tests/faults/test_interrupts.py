"""Ctrl-C while CP-SAT runs in a thread: the thread is over before anything else happens."""

import signal
import subprocess
import threading

import pytest
from unified_planning.shortcuts import OneshotPlanner

from tests.fuzz.problems import SECONDS, build
from tests.fuzz.small import small_case
from up_samp import cli
from up_samp.model.errors import InterruptedSearch
from up_samp.scheduling.cpsat.solve.runner import _interruptible
from up_samp.search import resolve
from up_samp.system import child


class Solver:
    """Works until it is told to stop, and notes it."""

    def __init__(self):
        self.stopped = threading.Event()
        self.working = 0

    def work(self):
        self.working += 1
        self.stopped.wait(10.0)
        self.working -= 1

    def stop_search(self):
        self.stopped.set()


def interrupt_in(monkeypatch, name, times):
    """Let the first calls of a thread's method be interrupted once they have done their work."""
    inner = getattr(threading.Thread, name)
    left = [times]

    def interrupted(thread, *args):
        inner(thread, *args)
        if left[0] and threading.current_thread() is threading.main_thread():
            left[0] -= 1
            raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, name, interrupted)


@pytest.mark.parametrize(("where", "times"), [("start", 1), ("join", 1), ("join", 3)])
def test_ctrl_c_leaves_no_thread_at_work(monkeypatch, where, times):
    solver = Solver()
    before = set(threading.enumerate())
    with monkeypatch.context() as patch:
        interrupt_in(patch, where, times)
        with pytest.raises(KeyboardInterrupt):
            _interruptible(solver.work, solver, threading.Event())
        assert set(threading.enumerate()) <= before
    assert solver.working == 0


def test_ctrl_c_before_the_thread_begins_means_that_it_does_nothing(monkeypatch):
    solver = Solver()
    begun = []

    def late(thread):
        begun.append(thread)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", late)
        with pytest.raises(KeyboardInterrupt):
            _interruptible(solver.work, solver, threading.Event())
    threading.Thread.start(begun[0])
    begun[0].join(60.0)
    assert not begun[0].is_alive()
    assert solver.working == 0


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, cli.INTERRUPTED), (signal.SIGTERM, cli.TERMINATED)],
)
def test_a_command_that_is_stopped_while_it_loads_says_so_shortly(tmp_path, number, code):
    """The parser is made of all that the commands need: much of the start of a short command."""
    script = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from up_samp import cli\n"
        "inner = cli.make_parser\n"
        f"cli.make_parser = lambda words: os.kill(os.getpid(), {int(number)}) or inner(words)\n"
        "sys.argv = ['up-samp', 'engines']\n"
        "sys.exit(cli.main())\n"
    )
    done = subprocess.run(child.command(script), env=child.environment(), capture_output=True)
    assert done.returncode == code
    assert done.stderr.strip() == b"up-samp: stopped"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_waits_until_a_plan_is_written(tmp_path, number):
    script = (
        "import os, signal, sys, time\n"
        "from pathlib import Path\n"
        "from up_samp.system.files import uninterrupted\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "with uninterrupted():\n"
        f"    os.kill(os.getpid(), {int(number)})\n"
        "    Path(sys.argv[1]).write_text('whole')\n"
        "time.sleep(5)\n"
    )
    done = subprocess.run(
        child.command(script, [str(tmp_path / "plan")]),
        env=child.environment(),
        capture_output=True,
        timeout=60,
    )
    assert (tmp_path / "plan").read_text() == "whole"
    assert done.returncode in (-number, 1 if number is signal.SIGTERM else 130)


def test_ctrl_c_behind_another_error_keeps_the_plan(tmp_path, monkeypatch):
    """It came while a module was loaded, whose class could not be made then."""

    def interrupted(*_):
        raise RuntimeError("Error calling __set_name__") from KeyboardInterrupt()

    monkeypatch.setattr(resolve, "_with_motions_optional", interrupted)
    case = small_case(279)  # its last pass has a drive to leave out
    params = {"seconds_per_unit": SECONDS}
    with (
        OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner,
        pytest.raises(InterruptedSearch) as caught,
    ):
        planner.solve(build(case, tmp_path), timeout=30.0)
    assert caught.value.result.plan is not None
