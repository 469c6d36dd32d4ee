"""Where the package keeps what it can make again."""

from __future__ import annotations

import functools
import logging
import os
import stat
import tempfile
from pathlib import Path

from platformdirs import user_cache_path

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
