"""Compile the kernels that a problem needs, before any time limit runs, side by side.

They are kept on disk (:mod:`up_samp.geometry.kernel_cache`), so this happens once per machine and
version. A part that was compiled leaves a mark that lists its files: where one is gone or damaged,
the part is compiled again.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import importlib
import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import IO

import llvmlite.binding

from up_samp.geometry import kernel_cache
from up_samp.model import MotionModel
from up_samp.system import child
from up_samp.system.files import write_whole

log = logging.getLogger(__name__)

_MOST_SECONDS = 600.0


PARTS = ("paths", "groups", "knots", "search", "planar")
"""Parts that are compiled each in a process of its own."""

PARTS_FOR: dict[MotionModel, tuple[str, ...]] = {
    MotionModel.REEDSSHEPP: ("paths", "groups", "knots", "search"),
    MotionModel.SE2: ("planar", "groups", "knots"),
    MotionModel.PIVOT: ("planar", "groups", "knots"),
}
"""Parts that bodies of each motion model need."""

SEVERAL = ("groups", "knots", "search")
"""Parts that only problems with several moving bodies need."""

Report = Callable[[int, int], None]
"""Told how many parts are ready, of how many."""


def parts_for(models: Iterable[MotionModel], *, several: bool = True) -> list[str]:
    """Return the parts that bodies of these motion models need, each once; ``several``: whether
    more than one of them moves.
    """
    wanted = set(models)
    found = dict.fromkeys(
        part for model in PARTS_FOR if model in wanted for part in PARTS_FOR[model]
    )
    return [part for part in found if several or part not in SEVERAL]


def missing(parts: Iterable[str]) -> tuple[str, ...]:
    """Return which of the parts have not been compiled, as the code is now, or not any more."""
    if "NUMBA_DISABLE_JIT" in os.environ:
        return ()
    return tuple(part for part in parts if part not in _compiled_here and not _is_ready(part))


_compiled_here: set[str] = set()
"""Parts that this process has compiled (all that counts where nothing can be kept)."""

_compiling: list[str] = []
"""The part that this process is compiling."""


def is_compiling() -> bool:
    """Return whether this process is compiling a part just now."""
    return bool(_compiling)


def _is_ready(part: str) -> bool:
    """Return whether a part's mark and all files that it lists are there and whole."""
    mark = _mark(part)
    try:
        if mark is None:
            return False
        files: dict[str, int] = json.loads(mark.read_text(encoding="utf-8"))
        for name, size in files.items():
            data = (mark.parent / name).read_bytes()
            if len(data) != size or not kernel_cache.is_whole(data):
                return False
    except (OSError, ValueError):
        return False
    return True


def _mark(part: str) -> Path | None:
    folder = kernel_cache.folder()
    return None if folder is None else folder / f"{part}-{_state_of_code()}.json"


@functools.cache
def _state_of_code() -> str:
    """Return what decides whether the kernels on disk can be used: all their sources, the
    versions, and the processor.
    """
    package = Path(__file__).parents[1]
    files = sorted([*(package / "geometry").rglob("*.py"), *(package / "motion").rglob("*.py")])
    lines = [kernel_cache.module_key(f) for f in files if kernel_cache.uses_kernels(f)]
    lines += [kernel_cache.platform_key(), llvmlite.binding.get_host_cpu_name()]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:32]


def workload(part: str) -> Callable[[], None]:
    """Return what is run to compile a part (imported only for that: it needs all of motion)."""
    workloads = importlib.import_module("up_samp.motion.workloads")
    work: Callable[[], None] = getattr(workloads, f"compile_{part}")
    return work


def compile_part(part: str) -> None:
    """Compile a part and leave a mark that says so."""
    before = dict(kernel_cache.used)
    kernel_cache.used.clear()
    _compiling.append(part)
    try:
        workload(part)()
        needed = dict(kernel_cache.used)
    finally:
        _compiling.pop()
        kernel_cache.used.update(before)
    _compiled_here.add(part)
    mark = _mark(part)
    if mark is not None and kernel_cache.can_write():
        write_whole(mark, json.dumps(needed))


def precompile(
    models: Iterable[MotionModel] = (MotionModel.REEDSSHEPP,),
    *,
    several: bool = True,
    report: Report | None = None,
) -> float:
    """Compile what bodies of these motion models need and is missing; return the seconds it took.

    Each part has a process of its own; two that need the same kernel compile it once. Where
    nothing can be kept on disk, or such a process fails, this process compiles.
    """
    needed = missing(parts_for(models, several=several))
    if not needed:
        return 0.0
    began = time.monotonic()
    log.warning("compiling motion kernels (once on this machine, less than a minute)")
    if kernel_cache.can_write():
        _in_processes(needed, report)
    for part in missing(needed):
        compile_part(part)
    return time.monotonic() - began


def _in_processes(parts: Sequence[str], report: Report | None) -> None:
    """Compile parts in processes of their own; say so where one fails."""
    processes = {part: _start(part) for part in parts}
    waiting = dict(processes)
    until = time.monotonic() + _MOST_SECONDS
    try:
        while waiting and time.monotonic() < until:
            time.sleep(0.02)
            for part, process in list(waiting.items()):
                if process.poll() is None:
                    continue
                del waiting[part]
                if process.returncode != 0:
                    _say_failed(part, process)
                if report is not None:
                    report(len(parts) - len(waiting), len(parts))
    finally:
        for process in processes.values():
            if process.poll() is None:
                process.kill()
            process.communicate()


def _start(part: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        child.command(child.bare(__name__), [part]),
        env=child.environment(),
        stdin=subprocess.PIPE,  # its end tells the child that this process is gone
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for this process, which ends the child
    )


def _say_failed(part: str, process: subprocess.Popen[bytes]) -> None:
    errors: IO[bytes] | None = process.stderr
    said = b"" if errors is None else errors.read()
    lines = said.decode(errors="replace").strip().splitlines()
    log.warning(
        "compiling %s in a process of its own failed (exit status %s%s): compiling here",
        part,
        process.returncode,
        f", {lines[-1]}" if lines else "",
    )


def main() -> None:
    """Compile the parts that the command line names; end when the parent goes away."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    child.die_with(sys.stdin.fileno())
    gc.disable()  # nothing of what numba builds can be freed before the end: a sixth of the time
    for part in sys.argv[1:]:
        compile_part(part)
