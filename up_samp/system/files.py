"""Files that are written whole or not at all; the folder for what the package can make again."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import signal
import stat
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from platformdirs import user_cache_path

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


# ------------------ Where the package keeps what it can make again


log = logging.getLogger(__name__)

VARIABLE = "UP_SAMP_CACHE_DIR"
"""The environment variable that names the cache folder."""


def cache_folder() -> Path | None:
    """Return the folder for what can be made again: the one that ``UP_SAMP_CACHE_DIR`` names, else
    the user's cache folder; ``None`` where there is neither.
    """
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named).absolute()
    try:
        found = user_cache_path("up-samp", appauthor=False)
    except (OSError, RuntimeError):  # a user without a home
        return None
    return found if found.is_absolute() else None


def only_owner_writes(found: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user (or to root, who may do anything) and
    nobody else may write to it; always true where the system knows no such owners.
    """
    if not hasattr(os, "geteuid"):
        return True
    return found.st_uid in (os.geteuid(), 0) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@functools.cache
def is_private(folder: Path, suffix: str) -> bool:
    """Return whether what lies in ``folder`` was put there by this user (or root), so that it may
    be run. A folder of ours that others could write to is taken from them, and its files that end
    in ``suffix`` are removed; of anybody else's folder nothing is used. Both are said.
    """
    try:
        found = folder.stat()
    except OSError:  # nothing is there: nothing is taken from it
        return True
    if only_owner_writes(found):
        return True
    why = f"owner {found.st_uid}, mode {stat.S_IMODE(found.st_mode):04o}"
    if found.st_uid != os.geteuid():
        say_uncached(folder, f"others may write there: {why}")
        return False
    try:
        folder.chmod(found.st_mode & ~(stat.S_IWGRP | stat.S_IWOTH))
        for file in folder.glob(f"*{suffix}"):
            file.unlink(missing_ok=True)
    except OSError as error:
        say_uncached(folder, f"others may write there: {why}: {error.strerror}")
        return False
    log.warning(
        "others could write to '%s' (%s): now only its owner can, and compiled kernels that lay "
        "there are compiled again",
        folder,
        why,
    )
    return True


def make_private(folder: Path) -> None:
    """Make a folder that nobody else may write to, whatever the umask; leave one that is there."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o755, exist_ok=True)


@functools.cache
def is_writable(folder: Path) -> bool:
    """Return whether files can be made in ``folder`` (which is made if need be)."""
    try:
        make_private(folder)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@functools.cache
def say_uncached(folder: Path | None, why: str) -> None:
    """Say once that nothing can be kept in ``folder``, and what to do about it."""
    log.warning(
        "%s cannot keep compiled motion kernels (%s): they are compiled anew in every process; "
        "set %s to a writable folder",
        "no folder" if folder is None else f"'{folder}'",
        why,
        VARIABLE,
    )
