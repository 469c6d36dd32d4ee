import json
import queue
import sys
import threading
import time
from pathlib import Path

import pytest

psutil = pytest.importorskip("psutil")
from up_samp.server.jobs import JobLimits, JobQueue, JobState  # noqa: E402

FAKE = (sys.executable, str(Path(__file__).with_name("fake_worker.py")))


def jobs(**limits):
    return JobQueue(JobLimits(**limits), FAKE)


def ask(*steps, timeout=30):
    return "plan", json.dumps({"steps": steps}).encode(), timeout


def follow(job, number=0):
    """Numbered events from one on as they come, None while there is none; until the job's end."""
    over = False
    while not over:
        new, over = job.since(number)
        yield from enumerate(new, number)
        number += len(new)
        if not new and not over:
            yield None
            time.sleep(0.01)


def ending(job):
    return [item[1]["event"] for item in follow(job) if item is not None]


def test_a_job_tells_what_happens_and_ends():
    with jobs() as server:
        job = server.submit(*ask("progress", "plan", "end"))
        assert ending(job) == ["progress", "plan", "end"]
        status = job.status()
    assert status["state"] == "done"
    assert (status["makespan"], status["lower_bound"]) == (7, 5)
    assert status["bound_kind"] == "relative"
    assert json.loads(job.plan)["problem"] == "fake"


def test_who_comes_late_hears_everything_and_who_comes_back_the_rest():
    with jobs() as server:
        job = server.submit(*ask("progress", "plan", "end"))
        ending(job)
        assert ending(job) == ["progress", "plan", "end"]
        assert [i[0] for i in follow(job, 2)] == [2]


def test_a_crash_is_an_ending_and_the_plan_stays():
    with jobs() as server:
        job = server.submit(*ask("plan", "crash"))
        ending(job)
        status = job.status()
    assert status["state"] == "done"
    assert "SIGSEGV" in status["message"]
    assert job.plan is not None


def test_a_job_without_a_plan_that_crashes_has_failed():
    with jobs() as server:
        job = server.submit(*ask("crash"))
        ending(job)
        assert job.state is JobState.FAILED


def test_a_job_that_does_not_end_is_ended():
    with jobs(seconds=3.0, grace=0.0) as server:
        job = server.submit(*ask("plan", "60"))
        ending(job)
        assert job.plan is not None
        assert "ended" in job.status()["message"]


def test_more_jobs_than_may_wait_are_turned_away():
    with jobs(running=1, waiting=1) as server:
        first = server.submit(*ask("progress", "60"))
        next(item for item in follow(first) if item is not None)
        server.submit(*ask("end"))
        with pytest.raises(queue.Full, match="1 jobs are waiting"):
            server.submit(*ask("end"))


def test_stopping_ends_the_process_and_all_that_it_started():
    before = {p.pid for p in psutil.process_iter()}
    with jobs() as server:
        job = server.submit(*ask("plan", "child", "60"))
        for item in follow(job):
            if item is not None and item[1].get("phase") == "child":
                break
        server.stop(job)
        ending(job)
        assert job.state is JobState.STOPPED
        assert job.plan is not None
    left = [p for p in psutil.process_iter() if p.pid not in before and _is_fake(p)]
    assert not left


def _is_fake(process):
    try:
        return "fake_worker.py" in " ".join(process.cmdline())
    except psutil.Error:
        return False


def test_a_waiting_job_can_be_stopped_and_never_starts():
    with jobs(running=1) as server:
        first = server.submit(*ask("progress", "60"))
        next(item for item in follow(first) if item is not None)
        second = server.submit(*ask("plan", "end"))
        server.stop(second)
        server.stop(first)
        ending(second)
        assert second.state is JobState.STOPPED
        assert second.plan is None


def test_a_job_that_has_ended_is_never_signalled(monkeypatch):
    """Its number may be another process's by now, and be the leader of a group."""
    with jobs() as server:
        job = server.submit(*ask("plan", "end"))
        ending(job)
        wait_until(lambda: job.group.process.returncode is not None)
        signalled = []
        monkeypatch.setattr("os.killpg", lambda *group: signalled.append(group))
        monkeypatch.setattr("os.kill", lambda *process: signalled.append(process))
        server.stop(job)
    assert signalled == []
    assert job.state is JobState.DONE
    assert job.plan is not None


def test_clients_that_come_and_go_leave_no_threads_and_no_folders(tmp_path, monkeypatch):
    """Each job that was stopped while it waited had a thread and a folder until its turn came."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with jobs(running=1, waiting=2) as server:
        first = server.submit(*ask("progress", "60"))
        next(item for item in follow(first) if item is not None)
        before = threading.active_count()
        for _ in range(150):
            server.stop(server.submit(*ask("60")))
        assert threading.active_count() <= before
        assert len(list(tmp_path.iterdir())) == 1
        waiting = [server.submit(*ask("60")) for _ in range(2)]
        with pytest.raises(queue.Full):
            server.submit(*ask("60"))
        assert threading.active_count() <= before
        server.stop(waiting[0])
        server.submit(*ask("60"))
    assert list(tmp_path.iterdir()) == []


def test_what_is_kept_is_bounded_in_bytes():
    with jobs(kept_bytes=3000) as server:
        found = []
        for _ in range(5):
            kind, body, seconds = ask("end")
            found.append(server.submit(kind, body + b" " * 1000, seconds))
            ending(found[-1])
            wait_until(lambda: not server._busy)
        assert [server.get(job.id) is not None for job in found] == [False] * 3 + [True] * 2


def wait_until(good):
    until = time.monotonic() + 120
    while not good():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_too_much_output_ends_the_job():
    with jobs(output=200_000) as server:
        job = server.submit(*ask("flood"))
        for _ in follow(job):
            pass
        assert job.status()["message"] == "too much output"
        assert job.state is JobState.FAILED


def test_old_results_are_forgotten():
    with jobs(kept=2) as server:
        ids = []
        for _ in range(4):
            job = server.submit(*ask("end"))
            ending(job)
            ids.append(job.id)
            wait_until(lambda: not server._busy)
        known = [server.get(i) is not None for i in ids]
    assert known == [False, False, True, True]


def test_no_more_are_listed_than_are_kept_whenever_they_end():
    with jobs(kept=1, running=1) as server:
        found = [server.submit(*ask("60")) for _ in range(3)]
        for job in found:
            job.ended(JobState.STOPPED)  # as it is for a moment before its thread tells the queue
        assert server.all("plan") == found[-1:]
        for job in found:
            job.work.cancel()
            if job.group is not None:
                job.group.end()


def test_no_folder_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with jobs() as server:
        ending(server.submit(*ask("end")))
        ending(server.submit(*ask("crash")))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wrong", [{"running": 0}, {"seconds": float("nan")}, {"memory": -1}])
def test_limits_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=f"limit '{next(iter(wrong))}'"):
        JobLimits(**wrong)
