"""Engines that overrun, die, lie or cannot: reported as such, and nothing is left behind."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
from unified_planning.engines import PlanGenerationResultStatus

from tests.scheduling import doubles
from tests.scheduling.problems import fetch_and_return, two_after_each_other
from tests.system.test_child import is_alive
from up_samp.engines.plain import schedule_plainly
from up_samp.model import (
    Deadline,
    OutOfTimeError,
    ProblemError,
    ScheduleStatus,
    UnsupportedError,
    in_force,
)
from up_samp.scheduling import engine_scheduler, is_compatible, open_scheduler, process
from up_samp.scheduling.compilers.constraints import compile_differences
from up_samp.scheduling.compilers.translate import read_plain
from up_samp.scheduling.engine_scheduler import chain, compilers_for
from up_samp.scheduling.process import OverrunError, WorkerProcess
from up_samp.scheduling.quirks import Quirks
from up_samp.search import Parameters
from up_samp.validation import validate_schedule

pytestmark = pytest.mark.usefixtures("on_the_clock")


def check(problem, schedule):
    return [str(v) for v in validate_schedule(problem, schedule).violations]


def gone(pids, seconds=60.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if not any(is_alive(p) for p in pids):
            return True
        time.sleep(0.05)
    return False


def is_written(path):
    return path.exists() and len(path.read_text().split()) == 3


def read_note(path, seconds=120.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if is_written(path):
            worker, child, folder = path.read_text().split()
            return [int(worker), int(child)], folder
        time.sleep(0.05)
    raise AssertionError("the engine never started")


@dataclass(frozen=True)
class OnceWritten(Deadline):
    """Ends when a note is there."""

    note: Path = Path()

    @property
    def moment(self):
        return 0.0 if is_written(self.note) else math.inf


def test_an_engine_that_overruns_is_ended_with_all_its_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(process, "ONE_WAIT", 0.1)
    note = tmp_path / "note"
    with open_scheduler(
        doubles.Sleeper, two_after_each_other(), params={"note": str(note)}
    ) as scheduler:
        report = scheduler.solve(OnceWritten(note=note))
        assert report.status is ScheduleStatus.OUT_OF_TIME
        assert "Sleeper did not stop" in report.message
        pids, folder = read_note(note)
        assert gone(pids)
        assert not os.path.exists(folder)


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGINT]
)
def test_nothing_is_left_when_the_caller_is_killed(tmp_path, how):
    note = tmp_path / "note"
    script = (
        # where the tests run in the background, they and their children ignore Ctrl-C
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from tests.scheduling import doubles, problems\n"
        "from up_samp.scheduling import open_scheduler\n"
        "from up_samp.model import Deadline\n"
        "s = open_scheduler(doubles.Sleeper, problems.two_after_each_other(),"
        f" params={{'note': {str(note)!r}}})\n"
        "s.solve(Deadline.after(60))\n"
    )
    root = str(Path(__file__).parents[2])
    caller = subprocess.Popen(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": root},
        stderr=subprocess.PIPE,
    )
    pids, folder = read_note(note)
    caller.send_signal(how)
    _, errors = caller.communicate(timeout=120)
    if how == signal.SIGINT:
        assert b"KeyboardInterrupt" in errors
    assert gone(pids)
    assert not os.path.exists(folder)


def test_a_dying_engine_is_an_error_and_the_next_call_starts_afresh():
    with open_scheduler(doubles.Dying, two_after_each_other()) as scheduler:
        for _ in range(2):
            report = scheduler.solve(Deadline.after(120.0))
            assert report.status is ScheduleStatus.ERROR
            assert "exit code 7" in report.message
            assert "out of luck" in report.message


def test_nobody_is_signalled_by_the_number_of_a_worker_that_has_ended(monkeypatch):
    """By then another process may have it."""
    worker = WorkerProcess()
    os.kill(worker._process.pid, signal.SIGKILL)
    worker._process.wait()
    signalled = []
    monkeypatch.setattr(os, "killpg", lambda group, how: signalled.append(group))
    assert not worker.alive
    worker.close()
    assert signalled == []


@pytest.mark.parametrize(
    ("engine", "text"),
    [
        (doubles.Raising, "ValueError: no idea"),
        (doubles.Wrong, "returned a wrong schedule"),
        (doubles.Planless, "SOLVED_SATISFICING"),
    ],
)
def test_a_wrong_answer_never_becomes_a_schedule(engine, text):
    with open_scheduler(engine, two_after_each_other(), check=check) as scheduler:
        report = scheduler.solve(Deadline.after(120.0))
    assert report.status is ScheduleStatus.ERROR
    assert report.schedule is None
    assert text in report.message
    assert engine.__name__ in report.message


def test_engines_that_cannot_are_refused_by_name():
    problem = two_after_each_other()
    assert is_compatible(doubles.Wrong) is True
    assert "does not support scheduling" in is_compatible(doubles.NotAScheduler)
    with pytest.raises(UnsupportedError, match="NotAScheduler"):
        open_scheduler(doubles.NotAScheduler, problem)
    with pytest.raises(ProblemError, match="nonesuch"):
        open_scheduler("nonesuch", problem)

    class Local(doubles.Double):
        pass

    with pytest.raises(UnsupportedError, match="Local"):
        open_scheduler(Local, problem)


def test_features_that_remain_after_compilation_are_named():
    problem = fetch_and_return()  # its conditions need integer variables in the precedence form
    with (
        open_scheduler(doubles.Wrong, problem) as scheduler,
        pytest.raises(UnsupportedError, match=r"Wrong: .*INT_ACTION_PARAMETERS"),
    ):
        scheduler.solve(Deadline.after(120.0))


def test_a_message_that_aries_would_refuse_is_refused_by_its_size(monkeypatch):
    small = Quirks(optional=False, assignments=True, message_limit=500)
    monkeypatch.setattr("up_samp.scheduling.engine_scheduler.quirks_of", lambda engine: small)
    with (
        open_scheduler("aries", fetch_and_return()) as scheduler,
        pytest.raises(UnsupportedError, match="at most 500 bytes"),
    ):
        scheduler.solve(Deadline.after(120.0))


def test_a_task_that_the_worker_does_not_take_is_given_up_in_time():
    with closing(WorkerProcess()) as worker:
        os.kill(worker._process.pid, signal.SIGSTOP)
        with pytest.raises(OverrunError):  # a pipe holds far less
            worker.ask(bytes(10_000_000), Deadline.after(0.05))
        assert not worker.alive


def test_compilers_look_at_the_clock():
    problem, passes = (
        read_plain(fetch_and_return()),
        compilers_for(Quirks(optional=False, assignments=False)),
    )
    with in_force(Deadline.after(0.0)):
        with pytest.raises(OutOfTimeError):
            compile_differences(problem)
        with pytest.raises(OutOfTimeError):
            chain(problem, passes)
    chain(problem, passes)


def test_an_expired_deadline_starts_nothing():
    with open_scheduler(doubles.Sleeper, two_after_each_other()) as scheduler:
        report = scheduler.solve(Deadline.after(0.0))
    assert report.status is ScheduleStatus.OUT_OF_TIME


@pytest.mark.parametrize(
    ("engine", "status"),
    [
        (doubles.InSequence, PlanGenerationResultStatus.SOLVED_SATISFICING),
        (doubles.Optimist, PlanGenerationResultStatus.TIMEOUT),
    ],
)
def test_the_best_plan_at_the_deadline_is_a_timeout_where_optima_are_promised(
    engine, status, monkeypatch
):
    # however long it takes to begin, it is to stop at once
    monkeypatch.setattr(engine_scheduler, "_engine_stops", lambda _: time.monotonic())
    wrapping = SimpleNamespace(
        _engine_class=engine,
        engine_params={},
        params=Parameters(),
        name="wrapping",
        satisfies=engine.satisfies,
    )
    result = schedule_plainly(wrapping, two_after_each_other(), Deadline.after(120.0), True)
    assert result.status is status
    assert result.metrics["makespan"] == "7"
