"""Where the package keeps what it can make again."""

from __future__ import annotations

import functools
import logging
import os
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


@functools.cache
def is_writable(folder: Path) -> bool:
    """Return whether files can be made in ``folder`` (which is made if need be)."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
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
