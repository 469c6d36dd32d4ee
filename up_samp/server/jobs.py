"""Processes beside the server: jobs, and the desk.

Each job has a process of its own, with limits; what it tells is kept until it is forgotten. The
process gets a line of JSON about the job and the request as the client sent it, and writes one JSON
object a line: ``{"event": "progress" | "plan" | "end", ...}``; a plan is the line after its event.
Requests and plans are kept as bytes: what JSON stands for may be far larger.

At the desk, one more process, requests are looked at before they are queued, and plans drawn. What
JSON, YAML and images stand for may be large, and reading them may take long: none of it is unfolded
in the server itself. The process has limits; when it meets one it is ended, the client is told, and
the next question starts another.
"""

from __future__ import annotations

import contextlib
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
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
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
    work: Future[None] = field(default_factory=Future)
    """What waits for its turn in the queue's pool."""
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

    A pool of ``JobLimits.running`` threads takes the jobs that wait, one each at a time: however
    many clients come and go, there are no more threads, processes or folders than that.
    """

    def __init__(self, limits: JobLimits = JobLimits(), command: tuple[str, ...] = ()) -> None:
        self.limits = limits
        self._command = command or WORKER
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._lock = threading.RLock()
        self._pool = ThreadPoolExecutor(limits.running)
        self._busy = 0
        """Jobs that wait, or are being done."""
        self._closed = False

    def __enter__(self) -> JobQueue:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def check_room(self) -> None:
        """Raise :class:`queue.Full` where too many jobs wait."""
        with self._lock:
            waiting = self._busy - self.limits.running
            if self._closed or waiting >= self.limits.waiting:
                raise queue.Full(f"{waiting} jobs are waiting already")

    def submit(self, kind: str, body: bytes, seconds: float) -> Job:
        """Queue a job (``kind``: plan, validate); raise :class:`queue.Full` if too many wait."""
        job = Job(kind, body, min(seconds, self.limits.seconds))
        with self._lock:
            self.check_room()
            self._jobs[job.id] = job
            self._forget()
            self._busy += 1
            job.work = self._pool.submit(self._serve, job)
        job.work.add_done_callback(self._done)
        return job

    def _done(self, _: object) -> None:
        with self._lock:
            self._busy -= 1
            self._forget()

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
            self._forget()  # a job has ended a moment before its thread lets go of older ones
            return [j for j in self._jobs.values() if j.kind == kind]

    def stop(self, job: Job) -> None:
        """End a job; the best plan it had stays. To one that has ended, nothing is done."""
        with job.lock:
            group = None if job.state in ENDED else job.group
            job.ended(JobState.STOPPED)
        job.work.cancel()
        if group is not None:
            group.end()

    def close(self) -> None:
        """End all jobs and wait for their processes."""
        with self._lock:
            self._closed = True
            jobs = list(self._jobs.values())
        for job in jobs:
            self.stop(job)
        self._pool.shutdown()

    # ------------------------------------------------------------------ one job
    def _serve(self, job: Job) -> None:
        try:
            self._run(job)
        except Exception as error:  # whatever happens, the job ends and says so
            job.add({"event": "end", "status": "ERROR", "message": str(error)})
            job.ended(JobState.FAILED)

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


# ------------------ The desk: what clients send is looked at, and plans are drawn


class Desk:
    """Answers one question at a time. Use it as a context: leaving it ends its process."""

    def __init__(self, limits: JobLimits) -> None:
        self.limits = limits
        self._lock = threading.Lock()
        self._group: ProcessGroup | None = None
        self._folder: Path | None = None
        self._closed = False

    def __enter__(self) -> Desk:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed = True
        if (group := self._group) is not None:
            group.end()
        with self._lock:
            self._leave()

    def ask(self, kind: str, *parts: bytes) -> tuple[dict[str, Any], bytes]:
        """Ask for what ``kind`` says of ``parts`` (see ``worker.DESK``); return the answer and the
        bytes that come with it.

        :raises TimeoutError: where there is no answer within the limits.
        """
        head = json.dumps({"kind": kind, "sizes": [len(p) for p in parts]}).encode() + b"\n"
        with self._lock:
            group = self._come()
            seconds = self.limits.look_seconds
            try:
                with group.within(seconds):
                    group.sink.write(b"".join((head, *parts)))
                    group.sink.flush()
                    line = group.source.readline()
                    answer: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {}
                    body = group.source.read(answer.get("size", 0))
                    if not answer or len(body) < answer.get("size", 0):
                        raise EOFError
            except (OSError, EOFError) as error:
                self._leave()
                why = f"it takes more than {seconds:g} s, or too much memory"
                raise TimeoutError(why) from error
            if answer.pop("last"):
                self._leave()
            return answer, body

    def _come(self) -> ProcessGroup:
        if self._closed:
            raise TimeoutError("the service ends")
        if self._group is None or self._group.ended():
            self._leave()
            self._folder = Path(tempfile.mkdtemp(prefix="up-samp-desk-"))
            self._group = started((*WORKER, "desk"), str(self.limits.look_memory), self._folder)
        return self._group

    def _leave(self) -> None:
        if self._group is not None:
            self._group.close()
            self._group = None
        if self._folder is not None:
            with contextlib.suppress(OSError):
                shutil.rmtree(self._folder)
            self._folder = None
