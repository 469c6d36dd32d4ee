"""The desk: a process beside the server that looks at what clients send, and draws plans.

What JSON, YAML and images stand for may be large, and reading them may take long: none of it is
unfolded in the server itself. The process has limits; when it meets one it is ended, the client is
told, and the next question starts another.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

from up_samp.server.jobs import WORKER, JobLimits, started
from up_samp.system.child import ProcessGroup


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
