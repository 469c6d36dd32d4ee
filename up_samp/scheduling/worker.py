"""Runs UP engines in a process of its own (started by ``process.WorkerProcess``).

The parent sends a :class:`WorkerTask` and gets a :class:`WorkerAnswer` back, one after the other,
over the worker's standard input and output (what an engine prints goes to standard error). When the
parent goes away, however that happens, the worker ends its whole process group, removes its
temporary folder and so leaves nothing behind.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import queue
import shutil
import signal
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

from unified_planning.grpc.proto_writer import ProtobufWriter
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.plain import PlainProblem
from up_samp.system import child

# times (s) that the system and known engines set, not ours to tune
GRACE = 0.5
"""That an engine gets beyond its deadline to hand over what it has."""
ONE_WAIT = 1e6
"""Of one wait at most: the system counts milliseconds, in 32 bits."""
_ENGINE_LIMIT = 2.0e6
"""The longest time limit for an engine: aries counts milliseconds in 32 bits."""


class SlimWriter:
    """Wraps UP's protobuf writer: a scheduling problem is measured against ``limit`` bytes.

    UP writes every base constraint twice (plain and scoped). Engines that read the plain ones get
    only those.
    """

    def __init__(self, writer: ProtobufWriter, limit: int):
        self._writer = writer
        self.limit = limit
        self._last: tuple[SchedulingProblem, Any] | None = None

    def convert(self, value: Any, *args: Any) -> Any:
        """Return the protobuf message.

        Raises:
            UnsupportedError: the message is larger than the limit.
        """
        if self._last is not None and self._last[0] is value:
            return self._last[1]
        message = self._writer.convert(value, *args)
        if isinstance(value, SchedulingProblem):
            del message.scheduling_extension.scoped_constraints[:]
            size = message.ByteSize()
            if size > self.limit:
                raise UnsupportedError(
                    f"a problem of {size:,} bytes after compilation: the engine's server takes at "
                    f"most {self.limit:,} bytes"
                )
            self._last = (value, message)
        return message


def slim_down(engine: Any, problem: SchedulingProblem, limit: int) -> None:
    """Make ``engine`` (one that keeps UP's writer in ``_writer``) send small messages, and write
    that for ``problem`` now: it takes a while that the engine does not count as its own time.
    """
    if not isinstance(engine._writer, SlimWriter):
        engine._writer = SlimWriter(engine._writer, limit)
    engine._writer.convert(problem)


@dataclass(frozen=True)
class WorkerTask:
    """Solve ``problem`` with the engine class ``module.name`` made with ``params``.

    ``until`` (of ``time.monotonic()``, which processes share) is when the engine has to stop
    itself; ``message_limit`` in bytes for engines that are reached through protobuf messages;
    ``environment`` variables are set before.
    """

    module: str
    name: str
    params: Mapping[str, Any]
    problem: PlainProblem
    until: float | None = None
    message_limit: int | None = None
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class WorkerAnswer:
    """``status`` is the name of UP's status, ``unsupported`` or ``exception``."""

    status: str
    times: Mapping[str, tuple[int, int]] | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    message: str = ""


def engine_of(task: WorkerTask, known: dict[tuple[str, str, str], Any]) -> Any:
    """Return the engine of a task: one for each class and parameters, kept in ``known``."""
    key = (task.module, task.name, repr(sorted(task.params.items())))
    if key not in known:
        found: Any = importlib.import_module(task.module)
        for part in task.name.split("."):
            found = getattr(found, part)
        known[key] = found(**task.params)
    return known[key]


def run(task: WorkerTask, engines: dict[tuple[str, str, str], Any]) -> WorkerAnswer:
    """Solve one task; every failure of the engine becomes an answer."""
    from up_samp.scheduling.compilers.translate import ProblemWriter
    from up_samp.upio.plan import to_candidate, words_told

    try:
        os.environ.update(task.environment)
        engine = engine_of(task, engines)
        written = ProblemWriter(task.problem)
        problem = written.up
        if task.message_limit is not None:
            slim_down(engine, problem, task.message_limit)
        lacking = sorted(problem.kind.features - engine.supported_kind().features)
        if lacking:
            raise UnsupportedError(f"{', '.join(lacking)} (after compilation)")
        engine.skip_checks = True  # just done, with the features' names
        timeout = None
        if task.until is not None:
            timeout = min(max(0.1, task.until - time.monotonic()), _ENGINE_LIMIT)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = engine.solve(problem, timeout=timeout)
        logs = "; ".join(map(str, words_told(result)))
        if result.plan is None:
            return WorkerAnswer(result.status.name, message=logs[-2000:])
        found = written.read_back(to_candidate(result.plan))
        return WorkerAnswer(result.status.name, found.times, found.parameters, logs[-2000:])
    except UnsupportedError as error:
        return WorkerAnswer("unsupported", message=str(error))
    except Exception as error:
        return WorkerAnswer("exception", message=_told(error))


def _told(error: Exception) -> str:
    """Return what went wrong in one line (remote calls give theirs as ``details()``) and where."""
    details = getattr(error, "details", None)
    said = details() if callable(details) else str(error)
    tail = "".join(traceback.format_tb(error.__traceback__)[-3:])
    return f"{type(error).__name__}: {said}".strip()[:1500] + f"\n{tail}"


def _clean(folder: str) -> None:
    """Remove the files that an engine left in the temporary folder."""
    for entry in os.scandir(folder):
        with contextlib.suppress(OSError):
            shutil.rmtree(entry.path) if entry.is_dir() else os.unlink(entry.path)


def _read_tasks(stream: Connection, tasks: queue.SimpleQueue[WorkerTask], folder: str) -> None:
    """Put what the parent sends into the queue; when it is gone, end the process group."""
    try:
        while True:
            tasks.put(stream.recv())
    except (EOFError, OSError):
        child.end_all_with("TMPDIR", folder)
        shutil.rmtree(folder, ignore_errors=True)
        os.killpg(os.getpgid(0), signal.SIGKILL)


def main() -> None:
    """Serve tasks until the parent closes the worker's standard input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    answers = Connection(os.dup(1), readable=False)
    os.dup2(2, 1)
    tasks: queue.SimpleQueue[WorkerTask] = queue.SimpleQueue()
    folder = tempfile.gettempdir()
    stdin = Connection(os.dup(0), writable=False)
    threading.Thread(target=_read_tasks, args=(stdin, tasks, folder), daemon=True).start()
    import unified_planning.shortcuts as shortcuts

    shortcuts.get_environment().credits_stream = None
    engines: dict[tuple[str, str, str], Any] = {}
    while True:
        answer = run(tasks.get(), engines)
        _clean(folder)
        answers.send(answer)
