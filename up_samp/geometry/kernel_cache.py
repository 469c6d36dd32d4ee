"""Compiled kernels on disk: one file for each kernel and types of arguments.

numba's own cache lies beside the sources (so it goes with them, and cannot be written where they
cannot), trusts what it reads, and does not see that a kernel which another one has inlined has
changed. Here a file is named by a hash of all that goes into it: the sources of the kernel's module
and of every module that it takes kernels or constants from, the types, the versions and the
processor. It carries a checksum, is written whole or not at all, and none is ever trusted blindly:
what is missing, damaged or cannot be loaded is compiled again. A checksum is no help against
malice, and to read a pickle is to run it: files are taken only if this user (or root) owns them
and their folder, and nobody else may write to either.

The classes use what numba's dispatcher asks of its cache (``load_overload``, ``save_overload``).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import re
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from up_samp.model.deadline import clock, do_not_count
from up_samp.system.files import (
    cache_folder,
    is_private,
    is_writable,
    make_private,
    only_owner_writes,
    say_uncached,
    whole,
)
from up_samp.system.imports import load_numba_arrays

try:
    import fcntl
except ImportError:  # Windows: two processes may then compile the same kernel
    fcntl = None  # type: ignore[assignment]

log = logging.getLogger(__name__)

SUFFIX = ".kernel"
_LONGEST_WAIT = 60.0
_PACKAGE = Path(__file__).parents[1]
_CHECKSUM = hashlib.sha256().digest_size
_IMPORT = re.compile(r"^from (up_samp[.\w]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_COMPILED = re.compile(r"^\s*@(lean_)?(kernel|inner)\b|^class \w+\(NamedTuple\)", re.MULTILINE)
_CONSTANT = re.compile(r"\b_?[A-Z][A-Z0-9_]*\b")

used: dict[str, int] = {}
"""Files that this process has read or written, with their sizes."""


def folder() -> Path | None:
    """Return where kernels are kept, whether or not it can be written; ``None``: nowhere (there is
    no cache folder, or others may write to it, which is said).
    """
    base = cache_folder()
    place = None if base is None else base / "kernels"
    return place if place is not None and is_private(place, SUFFIX) else None


def can_write() -> bool:
    """Return whether kernels can be kept for other processes; say so once where not."""
    place = folder()
    if place is not None and is_writable(place):
        return True
    if place is not None:
        say_uncached(place, "it cannot be written")
    elif cache_folder() is None:
        say_uncached(None, "no home and no cache folder")
    return False


@functools.cache
def platform_key() -> str:
    """Return what decides, next to sources and types, whether machine code can be used."""
    switches = sorted(
        (name, value)
        for name, value in os.environ.items()
        if name.startswith("NUMBA_") and name not in ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")
    )
    return repr((numba.__version__, llvmlite.__version__, sys.version, switches))


@functools.cache
def module_key(path: Path) -> str:
    """Return a hash of a module's source and of all modules that it takes kernels or constants
    from.
    """
    sources: dict[Path, str] = {}
    todo = [path, Path(__file__).with_name("records.py")]
    while todo:
        here = todo.pop()
        if here in sources:
            continue
        sources[here] = here.read_text(encoding="utf-8")
        todo += _compiled_in(sources[here])
    digest = hashlib.sha256()
    for source in sorted(sources):
        digest.update(sources[source].encode())
    return digest.hexdigest()


def _compiled_in(source: str) -> list[Path]:
    """Return the files of our modules whose kernels or constants a source uses."""
    found = []
    for module, names in _IMPORT.findall(source):
        for file in _files(module, names):
            passes_on = file.name == "__init__.py" or _CONSTANT.search(names) is not None
            if passes_on or kernels_need(file):
                found.append(file)
    return found


@functools.cache
def kernels_need(file: Path) -> bool:
    """Return whether a source file defines kernels or records (whose fields they take by place)."""
    return _COMPILED.search(file.read_text(encoding="utf-8")) is not None


def _files(module: str, names: str) -> list[Path]:
    """Return the files that ``from module import names`` reads."""
    path = _PACKAGE.joinpath(*module.split(".")[1:])
    source = path.with_suffix(".py")
    if source.is_file():  # a folder beside it may be left of what it once was
        return [source]
    parts = [path / f"{name}.py" for name in re.findall(r"\w+", names)]
    return [p for p in (path / "__init__.py", *parts) if p.is_file()]


class KernelCache:
    """The files of one kernel; numba's dispatcher asks it before it compiles."""

    def __init__(self, function: Callable[..., Any]):
        code = function.__code__
        self._name = f"{Path(code.co_filename).stem}.{function.__qualname__}"
        self._module = Path(code.co_filename)
        self._qualname = function.__qualname__
        self._locks: list[Any] = []
        self._missed: list[float] = []

    @property
    def cache_path(self) -> str | None:
        """The folder of all kernels."""
        place = folder()
        return None if place is None else str(place)

    def enable(self) -> None:
        """Do nothing: it is always on."""

    def disable(self) -> None:
        """Do nothing: it is always on."""

    def flush(self) -> None:
        """Do nothing: what is old has another name."""

    def load_overload(self, types: Any, context: Any) -> Any:
        """Return the compiled kernel for argument ``types``, or ``None`` to have it compiled."""
        rtsys.initialize(context)  # all that loaded code needs; the compiler loads its registries
        path = self._path(types, context.codegen())
        found = None if path is None else self._read(path, context, types)
        if found is not None:
            return found
        load_numba_arrays()
        self._missed.append(clock())
        if path is not None and path.parent.is_dir():
            self._lock(path)  # another process may be compiling it
            found = self._read(path, context, types)
            if found is not None:
                self._unlock()
                self._end_of_wait()
        return found

    def watched(self, compiles: Callable[..., CompileResult]) -> Callable[..., CompileResult]:
        """Return what compiles this kernel; where that fails, nobody waits for it any longer."""

        def attempt(*types: Any) -> CompileResult:
            try:
                return compiles(*types)
            except BaseException:  # numba asks to save no overload then
                self._unlock()
                self._end_of_wait()
                raise

        return attempt

    def _end_of_wait(self) -> None:
        """Take the time since this kernel was found missing out of all time limits (what kernels
        within it took has been taken out by them).
        """
        if self._missed:
            do_not_count(clock() - self._missed.pop())

    def save_overload(self, types: Any, compiled: Any) -> None:
        """Keep a compiled kernel."""
        try:
            path = self._path(types, compiled.library.codegen)
            if path is not None and _cachable(compiled):
                _write(path, dumps(compiled._reduce()))
        finally:
            self._unlock()
            self._end_of_wait()

    def _path(self, types: Any, codegen: Any) -> Path | None:
        place = folder()
        if place is None:
            return None
        key = (platform_key(), module_key(self._module), str(types), codegen.magic_tuple())
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:32]
        return place / f"{self._name.replace('<', '').replace('>', '')}-{digest}{SUFFIX}"

    def _read(self, path: Path, context: Any, types: Any) -> Any:
        try:
            with open(path, "rb") as stream:
                owned = only_owner_writes(os.fstat(stream.fileno()))
                data = stream.read() if owned else b""
        except OSError:
            return None
        found, why = None, "is damaged and" if owned else "may be written by others and is"
        if owned and is_whole(data):
            try:
                found = CompileResult._rebuild(context, *pickle.loads(data[_CHECKSUM:]))
            except Exception as error:  # whatever a file of another time or place may raise
                why = f"cannot be loaded ({type(error).__name__}) and is"
        if found is None or not self._is_ours(found, types):
            log.warning("a compiled kernel %s compiled again: %s", why, path)
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        used[path.name] = len(data)
        return found

    def _is_ours(self, found: Any, types: Any) -> bool:
        """Return whether it is this kernel for these types: a whole file may lie in another's
        place, and to call it would end the process.
        """
        return found.fndesc.qualname == self._qualname and tuple(found.signature.args) == tuple(
            types
        )

    def _lock(self, path: Path) -> None:
        """Wait until no other process compiles this kernel (locks end with their process), but not
        for ever: compiling it twice does no harm.
        """
        if fcntl is None:
            return
        lock = path.with_suffix(".lock")
        with contextlib.suppress(OSError):
            stream = open(lock, "ab")  # noqa: SIM115 (closed in _unlock)
            self._locks.append((stream, lock))
            until = time.monotonic() + _LONGEST_WAIT
            while time.monotonic() < until:
                try:
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                except BlockingIOError:
                    time.sleep(0.02)

    def _unlock(self) -> None:
        if self._locks:
            stream, path = self._locks.pop()
            with contextlib.suppress(OSError):
                path.unlink()
            stream.close()


def is_whole(data: bytes) -> bool:
    """Return whether a file's content is what was written."""
    return hashlib.sha256(data[_CHECKSUM:]).digest() == data[:_CHECKSUM] and len(data) > _CHECKSUM


def _cachable(compiled: Any) -> bool:
    return not compiled.library.has_dynamic_globals and all(x.can_cache for x in compiled.lifted)


def _write(path: Path, content: bytes) -> None:
    """Write a file with its checksum; a disk that is full or cannot be written costs no more than
    compiling again.
    """
    data = hashlib.sha256(content).digest() + content
    try:
        make_private(path.parent)
        with whole(path, stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IROTH) as stream:
            stream.write(data)
    except OSError as error:
        say_uncached(path.parent, error.strerror or type(error).__name__)
        return
    used[path.name] = len(data)
