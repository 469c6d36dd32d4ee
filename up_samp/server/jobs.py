"""Jobs: each in a process of its own, with limits; what they tell is kept until they are forgotten.

A job's process gets a line of JSON about the job and the request as the client sent it, and writes
one JSON object a line: ``{"event": "progress" | "plan" | "end", ...}``; a plan is the line after
its event. Requests and plans are kept as bytes: what JSON stands for may be far larger.
"""

from __future__ import annotations

import enum
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import OrderedDict, deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from up_samp.system.child import ProcessGroup

Event = dict[str, Any]


@dataclass(frozen=True)
class JobLimits:
    """What a server allows. Times in s, sizes in bytes."""

    running: int = 1
    """Jobs at the same time."""
    waiting: int = 8
    """Jobs that may wait; more are turned away."""
    kept: int = 64
    """Ended jobs whose results are kept."""
    kept_bytes: int = 256 * 2**20
    """What requests and results of ended jobs may take; the oldest are forgotten first."""
    seconds: float = 600.0
    """Longest search."""
    grace: float = 60.0
    """Time beyond its search that a job has for reading, judging and writing."""
    memory: int = 6 * 2**30
    """Address space of a job; above this it fails, not the machine."""
    request: int = 8 * 2**20
    """Largest request."""
    arriving: int = 64 * 2**20
    """What all requests that arrive, and are looked at, may take; more are told to come back."""
    body_seconds: float = 30.0
    """Time that a request's body has to arrive."""
    look_seconds: float = 20.0
    """Time to look at a request before it is queued, and to draw a plan."""
    look_memory: int = 3 * 2**30
    """Address space of the process that does that."""
    connections: int = 512
    """Clients at the same time."""
    output: int = 64 * 2**20
    """Most that a job may print."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0 if name in ("waiting", "kept", "kept_bytes", "grace") else 1
            if not value >= least:
                raise ValueError(f"limit '{name}' must be at least {least}")


class JobState(str, enum.Enum):
    """Where a job is."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"


ENDED = frozenset({JobState.DONE, JobState.FAILED, JobState.STOPPED})


@dataclass(eq=False)
class Job:
    """One request (``body``, as it was sent; ``seconds`` for its search) and what came of it.
    ``lock`` guards all fields.
    """

    kind: str
    body: bytes
    seconds: float
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    state: JobState = JobState.WAITING
    events: list[Event] = field(default_factory=list)
    plan: bytes | None = None
    """The best plan, JSON."""
    told: Event = field(default_factory=dict)
    """What the best plan's event said."""
    end: Event | None = None
    group: ProcessGroup | None = None
    lock: Any = field(default_factory=threading.RLock)

    @property
    def size(self) -> int:
        """Bytes that are kept for it."""
        return len(self.body) + len(self.plan or b"")

    def status(self) -> dict[str, Any]:
        """Return where the job is, its bounds and its ending, as JSON would hold it."""
        with self.lock:
            last = next((e for e in reversed(self.events) if e["event"] == "progress"), {})
            end = self.end or {}
            return {
                "id": self.id,
                "state": self.state.value,
                "status": end.get("status"),
                "message": end.get("message", last.get("message", "")),
                "lower_bound": end.get("lower_bound", last.get("lower_bound")),
                "bound_kind": end.get("bound_kind", last.get("bound_kind")),
                "makespan": self.told.get("makespan"),
                "seconds_per_unit": self.told.get("seconds_per_unit"),
            }

    def since(self, number: int) -> tuple[list[Event], bool]:
        """Return the events from ``number`` on, and whether the job has ended."""
        with self.lock:
            return self.events[number:], self.state in ENDED

    def add(self, event: Event, plan: bytes | None = None) -> None:
        """Take in what the job's process told."""
        with self.lock:
            if plan is not None:
                self.plan, self.told = plan, event
            if event["event"] == "end":
                self.end = event
            self.events.append(event)

    def ended(self, state: JobState) -> None:
        """Say how it ended."""
        with self.lock:
            if self.state not in ENDED:
                self.state = state


class JobQueue:
    """All jobs of a server. Use it as a context: leaving it ends them all.

    ``JobLimits.running`` threads take the jobs that wait, one each at a time: however many clients
    come and go, there are no more threads, processes or folders than that.
    """

    def __init__(self, limits: JobLimits = JobLimits(), command: tuple[str, ...] = ()) -> None:
        self.limits = limits
        self._command = command or WORKER
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._lock = threading.Lock()
        self._waiting: deque[Job] = deque()
        self._more = threading.Condition(self._lock)
        self._busy = 0
        self._threads: list[threading.Thread] = []
        self._closed = False

    def __enter__(self) -> JobQueue:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def check_room(self) -> None:
        """Raise :class:`queue.Full` where too many jobs wait."""
        with self._lock:
            self._check_room()

    def _check_room(self) -> None:
        waiting = len(self._waiting)
        if self._closed or waiting >= self.limits.waiting + self.limits.running - self._busy:
            raise queue.Full(f"{waiting} jobs are waiting already")

    def submit(self, kind: str, body: bytes, seconds: float) -> Job:
        """Queue a job (``kind``: plan, validate) and return it; raise :class:`queue.Full` where too
        many wait.
        """
        job = Job(kind, body, min(seconds, self.limits.seconds))
        with self._lock:
            self._check_room()
            self._jobs[job.id] = job
            self._forget()
            if len(self._threads) < self.limits.running:
                thread = threading.Thread(target=self._serve, daemon=True)
                self._threads.append(thread)
                thread.start()
            self._waiting.append(job)
            self._more.notify()
        return job

    def _forget(self) -> None:
        """Let go of the oldest ended jobs, beyond the number and the bytes that are kept."""
        ended = [j for j in self._jobs.values() if j.state in ENDED]
        size = sum(j.size for j in ended)
        for i, job in enumerate(ended):
            if len(ended) - i <= self.limits.kept and size <= self.limits.kept_bytes:
                return
            size -= job.size
            del self._jobs[job.id]

    def forget(self, job: Job) -> None:
        """End a job and keep nothing of it."""
        self.stop(job)
        with self._lock:
            self._jobs.pop(job.id, None)

    def get(self, name: str) -> Job | None:
        """Return a job by its id."""
        with self._lock:
            return self._jobs.get(name)

    def all(self, kind: str) -> list[Job]:
        """Return all jobs of a kind that are known, the oldest first."""
        with self._lock:
            return [j for j in self._jobs.values() if j.kind == kind]

    def stop(self, job: Job) -> None:
        """End a job; the best plan it had stays. To one that has ended, nothing is done."""
        with self._lock:
            if job in self._waiting:
                self._waiting.remove(job)
        with job.lock:
            group = None if job.state in ENDED else job.group
            job.ended(JobState.STOPPED)
        if group is not None:
            group.end()

    def close(self) -> None:
        """End all jobs and wait for their processes."""
        with self._lock:
            self._closed = True
            jobs, threads = list(self._jobs.values()), list(self._threads)
            self._more.notify_all()
        for job in jobs:
            self.stop(job)
        for thread in threads:
            thread.join(timeout=10.0)

    # ------------------------------------------------------------------ one job
    def _serve(self) -> None:
        """Do the jobs that wait, one after another."""
        while True:
            with self._lock:
                self._more.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                job = self._waiting.popleft()
                self._busy += 1
            try:
                self._run(job)
            except Exception as error:  # whatever happens, the job ends and says so
                job.add({"event": "end", "status": "ERROR", "message": str(error)})
                job.ended(JobState.FAILED)
            finally:
                with self._lock:
                    self._busy -= 1
                    self._forget()

    def _run(self, job: Job) -> None:
        folder = Path(tempfile.mkdtemp(prefix="up-samp-job-"))
        try:
            with job.lock:
                if job.state is not JobState.WAITING:
                    return
                job.state = JobState.RUNNING
                group = job.group = started(self._command, str(self.limits.memory), folder)
            self._follow(job, group)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _follow(self, job: Job, group: ProcessGroup) -> None:
        """Follow the job's process to its end and take in what it tells."""
        limits = self.limits
        try:
            with group.within(job.seconds + limits.grace):
                self._converse(job, group)
                group.settle(limits.grace)
        finally:
            code = group.close()
        if job.end is None and job.state is not JobState.STOPPED:
            job.add({"event": "end", "status": "ERROR", "message": _why(code)})
        failed = (job.end or {}).get("status") == "ERROR" and job.plan is None
        job.ended(JobState.FAILED if failed else JobState.DONE)

    def _converse(self, job: Job, group: ProcessGroup) -> None:
        head = {"kind": job.kind, "timeout": job.seconds}
        try:
            group.sink.write(json.dumps(head).encode() + b"\n" + job.body)
            group.sink.close()
        except BrokenPipeError:
            return
        left = self.limits.output

        def next_line() -> bytes:
            """Return a whole line, else nothing."""
            nonlocal left
            line = group.source.readline(left + 1)
            left -= len(line)
            return line if line.endswith(b"\n") and left >= 0 else b""

        while line := next_line():
            event = json.loads(line)
            plan = next_line().rstrip() if event["event"] == "plan" else None
            if plan != b"":
                job.add({**event, "at": round(time.time(), 3)}, plan)
        if left < 0:
            job.add({"event": "end", "status": "ERROR", "message": "too much output"})
            group.end()


WORKER = (sys.executable, "-m", "up_samp.server.worker")
"""The process of a job; what it may take of memory is its argument."""


def started(command: tuple[str, ...], argument: str, folder: Path) -> ProcessGroup:
    """Start a process that works in ``folder`` alone."""
    return ProcessGroup(
        [*command, argument],
        cwd=folder,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONSAFEPATH": "1", "TMPDIR": str(folder)},
    )


def _why(code: int | None) -> str:
    if code is not None and code < 0:
        return f"the job's process was ended ({signal.Signals(-code).name}): out of time or memory"
    return f"the job's process ended with exit code {code} and without a result"
