"""The parent's end of a worker process: start it, ask it, end it, always in time."""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import signal
import subprocess
import tempfile
import threading
import time
import weakref
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import IO, Any

from up_samp.model import Deadline, EngineError
from up_samp.scheduling.worker import GRACE, ONE_WAIT, WorkerAnswer, WorkerTask
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
        to_read, self._tasks = Pipe(duplex=False)
        self._answers, to_write = Pipe(duplex=False)
        self._process = subprocess.Popen(
            child.command(child.bare("up_samp.scheduling.worker")),
            stdin=to_read.fileno(),
            stdout=to_write.fileno(),
            stderr=self._errors,
            env=child.environment({"TMPDIR": self._folder, "TMP": self._folder}),
            start_new_session=True,
        )
        to_read.close()
        to_write.close()
        streams = (self._tasks, self._answers, self._errors)
        self._senders: list[threading.Thread] = []
        """Those that send a task: the last one may still do so when its process is ended."""
        self._end = weakref.finalize(
            self, _end, self._process, self._folder, self._senders, streams
        )

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
            # a pipe holds little, and the worker may still be loading
            data = pickle.dumps(task, protocol=pickle.HIGHEST_PROTOCOL)
            sender = threading.Thread(target=_send, args=(self._tasks, data), daemon=True)
            sender.start()
            self._senders[:] = [sender]
            _wait(self._answers, deadline)
            answer: Any = self._answers.recv()
        except (EOFError, OSError) as error:
            reason = self._reason()
            self.close()
            raise EngineError(f"the engine's process died ({reason})") from error
        except BaseException:
            self.close()
            raise
        assert isinstance(answer, WorkerAnswer)
        return answer

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


def _send(tasks: Connection, data: bytes) -> None:
    with contextlib.suppress(OSError):  # who waits for the answer is told that the worker is gone
        tasks.send_bytes(data)


def _wait(answers: Connection, deadline: Deadline) -> None:
    """Wait until there is an answer, or nobody to give one.

    Raises:
        OverrunError: there is not until shortly after the deadline.
    """
    while True:
        left = deadline.moment + GRACE - time.monotonic()
        if answers.poll(max(0.0, min(left, ONE_WAIT))):
            return
        if left <= ONE_WAIT:
            raise OverrunError("no answer by the deadline")


def _end(
    process: subprocess.Popen[bytes],
    folder: str,
    senders: list[threading.Thread],
    streams: tuple[Any, ...],
) -> None:
    # once its end was taken in, another process may lead a group of that number: what the worker
    # left behind is found by its folder then
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    child.end_all_with("TMPDIR", folder)  # servers in sessions of their own
    for sender in senders:  # with nobody left to read it is over at once
        sender.join()
    for stream in streams:
        with contextlib.suppress(OSError):
            stream.close()
    shutil.rmtree(folder, ignore_errors=True)
