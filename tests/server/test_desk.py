"""The process at the desk: whatever its parent holds, and however it came to its end."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("fastapi")
from up_samp.server.jobs import Desk, JobLimits

WRONG = b'{"problem": 1}'


def ask(desk):
    answer, body = desk.ask("plan", WRONG)
    assert answer["faults"]
    assert body == b""
    return desk._group.process.pid if desk._group is not None else None


def test_one_process_answers_all_questions_also_of_a_parent_that_holds_much():
    """What a process is told of its peak counts what its parent held when it was started."""
    held = bytearray(b"x") * (700 * 2**20)
    with Desk(JobLimits(look_seconds=120.0)) as desk:
        pids = {ask(desk) for _ in range(3)}
    assert len(held)
    assert len(pids) == 1
    assert None not in pids


@pytest.mark.skipif(not hasattr(os, "waitid"), reason="the system does not tell who has ended")
def test_one_that_was_ended_between_two_questions_is_followed_by_another():
    with Desk(JobLimits(look_seconds=120.0)) as desk:
        first = ask(desk)
        os.kill(first, signal.SIGKILL)
        until = time.monotonic() + 60.0
        while not desk._group.ended() and time.monotonic() < until:
            time.sleep(0.01)
        assert ask(desk) != first


def test_one_that_has_grown_large_says_so_and_the_next_question_is_answered(monkeypatch, tmp_path):
    grown = "import up_samp.server.worker as w; w._LARGE = 0.0; raise SystemExit(w.main())"
    monkeypatch.setattr("up_samp.server.jobs.WORKER", (sys.executable, "-c", grown))
    with Desk(JobLimits(look_seconds=120.0)) as desk:
        assert [ask(desk) for _ in range(2)] == [None] * 2


def test_the_peak_is_this_program_s_own():
    held = bytearray(b"x" * (300 * 2**20))
    code = "from up_samp.system.child import peak_memory as peak; print(peak())"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert len(held)
    assert 5.0 < float(told.stdout) < 200.0
