"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from up_samp.model.errors import ProblemError


@contextlib.contextmanager
def whole(path: Path, mode: int = 0o666) -> Iterator[IO[bytes]]:
    """Give a stream of bytes; the file appears when all is written, or not at all; with ``mode``,
    less what the umask takes.

    Whatever goes wrong (a full disk, Ctrl-C), an older file stays as it was.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
    try:
        with open(handle, "wb") as stream:
            yield stream
        os.chmod(name, mode & ~_umask())  # mkstemp's files are private, a plan need not be
        os.replace(name, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file (text as UTF-8) whole or not at all."""
    with whole(path) as stream:
        stream.write(content.encode() if isinstance(content, str) else content)
    return path


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the end (in the main thread; signals are for no other)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    # to block them would not do: another thread, of a library, may take them
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for late in dict.fromkeys(came):
            signal.raise_signal(late)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def check_folder(folder: Path, what: str) -> None:
    """Make a folder for results; raise :class:`ProblemError` where nothing can be written there,
    before any work is done for it. ``what`` names it: an option.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(b"x")
    except OSError as error:
        raise ProblemError(f"{what}: cannot write to '{folder}': {error.strerror}") from error
