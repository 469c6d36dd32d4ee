"""Start Python processes that import what this one would, and nothing else; their memory.

Python puts the current folder in front of ``sys.path`` for ``-c`` and ``-m``: a file named like
a module that lies there by chance, or by malice, would be run. Children get this process's path.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

_PATH = """
import sys
sys.path[:] = [p for p in sys.path if p] + [p for p in sys.argv.pop().split("\\n") if p]
"""

_BARE = """
import importlib, types
package = types.ModuleType("up_samp")
package.__path__ = [{folder!r}]
sys.modules["up_samp"] = package
importlib.import_module("up_samp.system.imports").own_the_process()
importlib.import_module({module!r}).main()
"""


def command(code: str, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs Python ``code`` with ``sys.argv[1:] == arguments`` in a process
    of its own; start it with :func:`environment`.
    """
    # an engine may be a module in the folder that an interactive session was started in
    later = [os.path.abspath(p) for p in sys.path if not os.path.isabs(p)]
    return [sys.executable, *_flags(), "-c", _PATH + code, *arguments, "\n".join(later)]


def bare(module: str) -> str:
    """Return code that runs ``module.main()`` without what ``import up_samp`` registers: such a
    child starts sooner.
    """
    return _BARE.format(folder=str(Path(__file__).parents[1]), module=module)


def _flags() -> list[str]:
    # Python 3.10 has no -P, and imports nothing before the first line of -c
    return ["-P"] if sys.version_info >= (3, 11) else []


def environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return this process's environment variables with ``extra``, and its path for the child."""
    paths = [p for p in sys.path if os.path.isabs(p)]
    return {**os.environ, **(extra or {}), "PYTHONPATH": os.pathsep.join(paths)}


def end_all_with(variable: str, value: str) -> None:
    """Kill all processes that have ``variable=value`` in their environment but this one: those
    that a child started, and they in turn, whatever session they are in (where the system shows
    environments as Linux does; nowhere else).
    """
    wanted = f"{variable}={value}".encode()
    for _ in range(_ROUNDS):
        found = [pid for pid in _pids() if pid != os.getpid() and _has(pid, wanted)]
        if not found:
            return
        for pid in found:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)


_ROUNDS = 5
"""Times to look again: a process may start another one before it is killed."""


def _pids() -> list[int]:
    try:
        return [int(entry) for entry in os.listdir("/proc") if entry.isdigit()]
    except OSError:
        return []


def _has(pid: int, wanted: bytes) -> bool:
    try:
        with open(f"/proc/{pid}/environ", "rb") as stream:
            return wanted in stream.read().split(b"\0")
    except OSError:  # another user's, or gone
        return False


def die_with(descriptor: int) -> None:
    """End this process at once, with the group that it leads, when ``descriptor`` (the read end
    of a pipe that only the parent holds open) is closed, however the parent goes away.
    """

    def watch() -> None:
        # not a buffered stream: its lock would be in the way when the interpreter ends
        while os.read(descriptor, 1):
            pass
        if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class ProcessGroup:
    """A process in a process group of its own, which is ended with all that it started. ``sink`` is
    its standard input, ``source`` its output.

    It is signalled only while its end has not been taken in (until then no other process can have
    its number): nothing else may wait for it or poll it.
    """

    def __init__(self, command: Sequence[str], **given: Any) -> None:
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            command, start_new_session=True, stdin=pipe, stdout=pipe, **given
        )
        self.sink = cast(BinaryIO, self.process.stdin)
        self.source = cast(BinaryIO, self.process.stdout)
        self._lock = threading.Lock()

    def ended(self) -> bool:
        """Return whether the process has ended, as far as the system can tell before it is ended
        from here.
        """
        with self._lock:
            if self.process.returncode is not None:
                return True
            options = os.WEXITED | os.WNOWAIT | os.WNOHANG if hasattr(os, "waitid") else 0
            return bool(options) and os.waitid(os.P_PID, self.process.pid, options) is not None

    def settle(self, seconds: float) -> None:
        """Wait until the process ends by itself, so long at most (where the system can tell)."""
        until = time.monotonic() + seconds
        while hasattr(os, "waitid") and time.monotonic() < until and not self.ended():
            time.sleep(0.01)

    def end(self) -> int:
        """End the process and its group, if that has not been done; return its exit code."""
        with self._lock:
            if self.process.returncode is None:
                with contextlib.suppress(OSError):
                    if hasattr(os, "killpg"):
                        os.killpg(self.process.pid, signal.SIGKILL)
                    else:  # not a POSIX system
                        self.process.kill()
                self.process.wait()
            return self.process.returncode

    @contextlib.contextmanager
    def within(self, seconds: float) -> Iterator[threading.Event]:
        """End the process once ``seconds`` have passed; the event tells that."""
        late = threading.Event()

        def end() -> None:
            late.set()
            self.end()

        overdue = threading.Timer(seconds, end)
        overdue.daemon = True
        overdue.start()
        try:
            yield late
        finally:
            overdue.cancel()

    def close(self) -> int:
        """End the process and close this end of its pipes, which nobody may use now; return its
        exit code.
        """
        code = self.end()
        for pipe in (self.sink, self.source):
            with contextlib.suppress(OSError):  # what could not be written any more
                pipe.close()
        return code


# ------------------ How much memory this process holds, and may hold


try:
    import resource
except ImportError:  # not a POSIX system
    resource = None  # type: ignore[assignment]


def peak_memory() -> float | None:
    """Return the most memory (MiB) that this process has held so far; None where it is unknown.

    Where the system tells it of this program alone, that counts: ``ru_maxrss`` is also what the
    process held before it became this program, which is what its parent held.
    """
    with contextlib.suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        told = re.search(r"VmHWM:\s*(\d+) kB", status.read())
        if told is not None:
            return int(told[1]) / 1024.0
    if resource is None:
        return None
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return held / (1024.0 * 1024.0 if sys.platform == "darwin" else 1024.0)


def limit_memory(size: int, what: str = "AS") -> None:
    """Limit this process's address space (or its ``DATA``; each by itself also its children's), in
    bytes, where the system can.
    """
    if resource is None:
        return
    kind = getattr(resource, f"RLIMIT_{what}")
    _, most = resource.getrlimit(kind)
    if most != resource.RLIM_INFINITY:
        size = min(size, most)
    resource.setrlimit(kind, (size, most if what == "DATA" else size))
