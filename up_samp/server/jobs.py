"""Jobs: each in a process of its own, with limits; what they tell is kept until they are forgotten.

A job's process writes one JSON object a line: ``{"event": "progress" | "plan" | "end", ...}``.
"""

from __future__ import annotations

import enum
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Event = dict[str, Any]


@dataclass(frozen=True)
class Limits:
    """What a server allows. Times in s, sizes in bytes."""

    running: int = 1
    """Jobs at the same time."""
    waiting: int = 8
    """Jobs that may wait; more are turned away."""
    kept: int = 64
    """Ended jobs whose results are kept."""
    seconds: float = 600.0
    """Longest search."""
    grace: float = 60.0
    """Time beyond its search that a job has for reading, judging and writing."""
    memory: int = 6 * 2**30
    """Address space of a job; above this it fails, not the machine."""
    request: int = 8 * 2**20
    """Largest request."""
    output: int = 64 * 2**20
    """Most that a job may print."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0 if name in ("waiting", "kept", "grace") else 1
            if not value >= least:
                raise ValueError(f"limit '{name}' must be at least {least}")


class State(str, enum.Enum):
    """Where a job is."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"


ENDED = frozenset({State.DONE, State.FAILED, State.STOPPED})


class QueueFullError(Exception):
    """There is no room for another job."""


@dataclass
class Job:
    """One request and what came of it. ``changed`` guards all fields and tells of each event."""

    request: dict[str, Any]
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    state: State = State.WAITING
    events: list[Event] = field(default_factory=list)
    plan: dict[str, Any] | None = None
    end: Event | None = None
    process: subprocess.Popen[bytes] | None = None
    changed: threading.Condition = field(default_factory=threading.Condition)

    def status(self) -> dict[str, Any]:
        """Return where the job is, its bounds and its ending, as JSON would hold it."""
        with self.changed:
            last = next((e for e in reversed(self.events) if e["event"] == "progress"), {})
            end = self.end or {}
            return {
                "id": self.id,
                "state": self.state.value,
                "status": end.get("status"),
                "message": end.get("message", last.get("message", "")),
                "lower_bound": end.get("lower_bound", last.get("lower_bound")),
                "makespan": None if self.plan is None else self.plan["makespan"],
                "seconds_per_unit": None if self.plan is None else self.plan["seconds_per_unit"],
            }

    def follow(self, begin: int = 0) -> Iterator[tuple[int, Event] | None]:
        """Yield numbered events from ``begin`` on as they come, None every second without one;
        end with the job.
        """
        number = begin
        while True:
            with self.changed:
                if number >= len(self.events) and self.state not in ENDED:
                    self.changed.wait(timeout=1.0)
                new = self.events[number:]
                over = self.state in ENDED
            if not new and not over:
                yield None
            for event in new:
                yield number, event
                number += 1
            if over and number >= len(self.events):
                return

    def add(self, event: Event) -> None:
        """Take in what the job's process told."""
        with self.changed:
            if event["event"] == "plan":
                self.plan = event.pop("plan")
                event["makespan"] = self.plan["makespan"]
            if event["event"] == "end":
                self.end = event
            self.events.append(event)
            self.changed.notify_all()

    def ended(self, state: State) -> None:
        """Say how it ended."""
        with self.changed:
            if self.state not in ENDED:
                self.state = state
            self.changed.notify_all()


class JobQueue:
    """All jobs of a server. Use it as a context: leaving it ends them all."""

    def __init__(self, limits: Limits | None = None, command: tuple[str, ...] = ()) -> None:
        self.limits = limits or Limits()
        self._command = command or (sys.executable, "-m", "up_samp.server.worker")
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._lock = threading.Lock()
        self._slots = threading.Semaphore(self.limits.running)
        self._threads: set[threading.Thread] = set()
        self._closed = False

    def __enter__(self) -> JobQueue:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def submit(self, request: dict[str, Any]) -> Job:
        """Queue a job and return it; raise :class:`QueueFullError` where too many wait."""
        with self._lock:
            waiting = sum(j.state is State.WAITING for j in self._jobs.values())
            running = sum(j.state is State.RUNNING for j in self._jobs.values())
            room = self.limits.waiting + max(0, self.limits.running - running)
            if self._closed or waiting >= room:
                raise QueueFullError(f"{waiting} jobs are waiting already")
            job = Job(request)
            self._jobs[job.id] = job
            self._forget()
            thread = threading.Thread(target=self._run, args=(job,), daemon=True)
            self._threads.add(thread)
        thread.start()
        return job

    def _forget(self) -> None:
        ended = [j.id for j in self._jobs.values() if j.state in ENDED]
        for name in ended[: max(0, len(ended) - self.limits.kept)]:
            del self._jobs[name]

    def get(self, name: str) -> Job | None:
        """Return a job by its id."""
        with self._lock:
            return self._jobs.get(name)

    def stop(self, job: Job) -> None:
        """End a job; the best plan it had stays."""
        job.ended(State.STOPPED)
        _end(job.process)

    def close(self) -> None:
        """End all jobs and wait for their processes."""
        with self._lock:
            self._closed = True
            jobs, threads = list(self._jobs.values()), list(self._threads)
        for job in jobs:
            if job.state not in ENDED:
                self.stop(job)
        for thread in threads:
            thread.join(timeout=10.0)

    # ------------------------------------------------------------------ one job
    def _run(self, job: Job) -> None:
        folder = Path(tempfile.mkdtemp(prefix="up-samp-job-"))
        try:
            with self._slots:
                with job.changed:
                    if job.state is not State.WAITING:
                        return
                    job.state = State.RUNNING
                self._follow(job, folder)
        except Exception as error:  # whatever happens, the job ends and says so
            job.add({"event": "end", "status": "ERROR", "message": str(error)})
            job.ended(State.FAILED)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            with self._lock:
                self._threads.discard(threading.current_thread())

    def _follow(self, job: Job, folder: Path) -> None:
        """Run the job's process to its end and take in what it tells."""
        limits = self.limits
        seconds = min(float(job.request["timeout"]), limits.seconds)
        process = subprocess.Popen(
            [*self._command, str(limits.memory)],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, "PYTHONSAFEPATH": "1", "TMPDIR": str(folder)},
        )
        job.process = process
        overdue = threading.Timer(seconds + limits.grace, _end, (process,))
        overdue.daemon = True
        overdue.start()
        try:
            if job.state is State.STOPPED:  # stopped before its process was there
                _end(process)
            self._converse(job, process, seconds)
            process.wait(timeout=limits.grace)
        except subprocess.TimeoutExpired:
            pass  # it has closed its output and does not end: it is ended
        finally:
            overdue.cancel()
            _end(process)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
        if job.end is None and job.state is not State.STOPPED:
            job.add({"event": "end", "status": "ERROR", "message": _why(process.returncode)})
        failed = (job.end or {}).get("status") == "ERROR" and job.plan is None
        job.ended(State.FAILED if failed else State.DONE)

    def _converse(self, job: Job, process: subprocess.Popen[bytes], seconds: float) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps({**job.request, "timeout": seconds}).encode())
            process.stdin.close()
        except BrokenPipeError:
            return
        left = self.limits.output
        for line in process.stdout:
            left -= len(line)
            if left < 0:
                job.add({"event": "end", "status": "ERROR", "message": "too much output"})
                _end(process)
                return
            event = json.loads(line)
            event["at"] = round(time.time(), 3)
            job.add(event)


def _end(process: subprocess.Popen[bytes] | None) -> None:
    """End a process with all that it started."""
    if process is None:
        return
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        process.kill()
    process.wait()


def _why(code: int | None) -> str:
    if code is not None and code < 0:
        return f"the job's process was ended ({signal.Signals(-code).name}): out of time or memory"
    return f"the job's process ended with exit code {code} and without a result"
