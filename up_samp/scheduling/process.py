"""The parent's end of a worker process: start it, ask it, end it, always in time."""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import shutil
import signal
import subprocess
import tempfile
import time
import weakref
from typing import IO, Any

from up_samp.model import Deadline, EngineError
from up_samp.scheduling.worker import GRACE, LENGTH, ONE_WAIT, WorkerAnswer, WorkerTask, packed
from up_samp.system import child


class OverrunError(EngineError):
    """The engine did not answer by its deadline."""


class WorkerProcess:
    """A worker in a process group of its own with a private temporary folder.

    The group (the worker and whatever servers its engines start) is killed when a call overruns
    its deadline, when the caller is interrupted, and on :meth:`close`.
    """

    def __init__(self) -> None:
        self._folder = tempfile.mkdtemp(prefix="up-samp-")
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed in _end)
        self._process = subprocess.Popen(
            child.command(child.bare("up_samp.scheduling.worker")),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=child.environment({"TMPDIR": self._folder, "TMP": self._folder}),
            start_new_session=True,
        )
        self._end = weakref.finalize(self, _end, self._process, self._folder, self._errors)

    @property
    def alive(self) -> bool:
        """Whether the worker can take a task."""
        return self._end.alive and self._process.poll() is None

    def ask(self, task: WorkerTask, deadline: Deadline) -> WorkerAnswer:
        """Send a task and wait for the answer until shortly after the deadline.

        Raises:
            OverrunError: no answer in time; the process group has been killed.
            EngineError: the worker died.
        """
        try:
            self._write(packed(task), deadline)
            header = self._read(LENGTH.size, deadline)
            answer: Any = pickle.loads(self._read(LENGTH.unpack(header)[0], deadline))
        except (BrokenPipeError, EOFError) as error:
            reason = self._reason()
            self.close()
            raise EngineError(f"the engine's process died ({reason})") from error
        except BaseException:
            self.close()
            raise
        assert isinstance(answer, WorkerAnswer)
        return answer

    def _write(self, data: bytes, deadline: Deadline) -> None:
        """Write a task. A pipe holds little, and the worker may still be loading."""
        assert self._process.stdin is not None
        descriptor = self._process.stdin.fileno()
        os.set_blocking(descriptor, False)
        rest = memoryview(data)
        while rest:
            _wait(descriptor, select.POLLOUT | select.POLLHUP, deadline)
            rest = rest[os.write(descriptor, rest) :]

    def _read(self, size: int, deadline: Deadline) -> bytes:
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        data = b""
        while len(data) < size:
            _wait(descriptor, select.POLLIN | select.POLLHUP, deadline)
            chunk = os.read(descriptor, size - len(data))
            if not chunk:
                raise EOFError
            data += chunk
        return data

    def _reason(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(2.0)
        code = self._process.returncode
        how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
        self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, self._errors.tell() - 1500))
        said = self._errors.read().decode(errors="replace").strip()
        return f"{how}: {said}" if said else how

    def close(self) -> None:
        """Kill the process group and remove the temporary folder."""
        self._end()


def _wait(descriptor: int, event: int, deadline: Deadline) -> None:
    """Wait until a pipe is ready.

    Raises:
        OverrunError: it is not until shortly after the deadline.
    """
    waiting = select.poll()
    waiting.register(descriptor, event)
    while True:
        left = deadline.remaining() + GRACE if deadline.at != float("inf") else None
        if deadline.expired():
            left = max(0.0, deadline.moment + GRACE - time.monotonic())
        once = None if left is None else min(left, ONE_WAIT)
        if waiting.poll(None if once is None else 1000.0 * once):
            return
        if once == left:
            raise OverrunError("no answer by the deadline")


def _end(process: subprocess.Popen[bytes], folder: str, errors: IO[bytes]) -> None:
    # once its end was taken in, another process may lead a group of that number: what the worker
    # left behind is found by its folder then
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    child.end_all_with("TMPDIR", folder)  # servers in sessions of their own
    for stream in (process.stdin, process.stdout, errors):
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()
    shutil.rmtree(folder, ignore_errors=True)
