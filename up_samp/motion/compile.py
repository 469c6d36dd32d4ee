"""Compile the kernels that a problem needs, before any time limit runs, side by side.

They are kept on disk (:mod:`up_samp.geometry.kernel_cache`), so this happens once per machine and
version. A part that was compiled leaves a mark that lists its files: where one is gone or damaged,
the part is compiled again.
"""

from __future__ import annotations

import contextlib
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
from up_samp.motion.models import MODELS
from up_samp.system import child
from up_samp.system.files import write_whole

_done: set[MotionModel] = set()


def warm_up(model: MotionModel) -> float:
    """Compile what single motions of this kind need, if it is not compiled yet; return the
    seconds. So that a first query does not spend its time limit on compiling.
    """
    if model in _done:
        return 0.0
    _done.add(model)
    return 0.0 if is_compiling() else precompile([model], several=False)


log = logging.getLogger(__name__)

SECONDS = {
    "paths": 13.0,
    "shortcuts": 3.5,
    "bounds": 2.0,
    "groups": 9.0,
    "knots": 5.0,
    "planar": 4.0,
}
"""Parts and about how long each takes (s of one processor, where other processes compile what it
shares with others); only the ratios count.
"""

SEVERAL = ("groups", "knots")
"""Parts that only problems with several moving bodies need."""

SELDOM = ("knots",)
"""Parts that most problems with several moving bodies are solved without: a search that needs one
compiles it then, and all deadlines stand still meanwhile.
"""

Report = Callable[[int, int], None]
"""Told how many parts are ready, of how many."""


def parts_for(models: Iterable[MotionModel], *, several: bool = True) -> list[str]:
    """Return the parts that bodies of these motion models need, each once; ``several``: whether
    more than one of them moves.
    """
    wanted = set(models)
    found = dict.fromkeys(
        part for model, row in MODELS.items() if model in wanted for part in row.kernels
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


def _is_marked(part: str) -> bool:
    mark = _mark(part)
    return mark is not None and mark.exists()


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
    lines = [kernel_cache.module_key(f) for f in files if kernel_cache.kernels_need(f)]
    # an image with machine code for any processor is run on others than it was built on
    processor = os.environ.get("NUMBA_CPU_NAME") or llvmlite.binding.get_host_cpu_name()
    lines += [kernel_cache.platform_key(), processor]
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
    """Compile all that bodies of these motion models may need and is missing; return the seconds
    it took.
    """
    return Compilation(missing(parts_for(models, several=several))).wait(report)


def begin(models: Iterable[MotionModel], *, several: bool) -> Compilation:
    """Begin to compile what every plan for bodies of these motion models needs and is missing."""
    wanted = parts_for(models, several=several)
    return Compilation(missing(part for part in wanted if part not in SELDOM))


class Compilation:
    """Parts that are compiled in processes of their own, one a processor, the longest first.

    Two that need the same kernel compile it once. Where nothing can be kept on disk, or such a
    process fails, this process compiles.
    """

    def __init__(self, parts: Sequence[str]):
        self.parts = tuple(parts)
        self._began = time.monotonic()
        self._processes: list[tuple[list[str], subprocess.Popen[bytes]]] = []
        if not self.parts:
            return
        log.warning("compiling motion kernels (once on this machine, less than a minute)")
        for part in self.parts:  # what is there is not whole
            mark = _mark(part)
            if mark is not None:
                with contextlib.suppress(OSError):
                    mark.unlink()
        if kernel_cache.can_write():
            for share in shared_out(self.parts, os.cpu_count() or 1):
                self._processes.append((share, _start(share)))

    def wait(self, report: Report | None = None) -> float:
        """Wait until the parts are compiled; return the seconds it took."""
        if not self.parts:
            return 0.0
        self._watch(report)
        for part in missing(self.parts):
            compile_part(part)
        return time.monotonic() - self._began

    def _watch(self, report: Report | None) -> None:
        """Wait for the processes, end those that are left, and say so where one failed."""
        waiting, told = list(self._processes), 0
        until = time.monotonic() + 600.0
        try:
            while waiting and time.monotonic() < until:
                time.sleep(0.02)
                for share, process in list(waiting):
                    if process.poll() is not None:
                        waiting.remove((share, process))
                        if process.returncode != 0:
                            _say_failed(share, process)
                ready = len(self.parts) if not waiting else sum(map(_is_marked, self.parts))
                if report is not None and ready > told:
                    told = ready
                    report(ready, len(self.parts))
        finally:
            for _, process in self._processes:
                _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
    process.communicate()


def shared_out(parts: Iterable[str], processes: int) -> list[list[str]]:
    """Return at most so many lists of parts that take about the same time: each part, the longest
    first, goes to the list with the least to do.
    """
    shares: list[list[str]] = [[] for _ in range(processes)]
    for part in sorted(parts, key=lambda p: -SECONDS[p]):
        min(shares, key=lambda share: sum(SECONDS[p] for p in share)).append(part)
    return [share for share in shares if share]


def _start(parts: Sequence[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        child.command(child.bare(__name__), parts),
        env=child.environment(),
        stdin=subprocess.PIPE,  # its end tells the child that this process is gone
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for this process, which ends the child
    )


def _say_failed(parts: Sequence[str], process: subprocess.Popen[bytes]) -> None:
    errors: IO[bytes] | None = process.stderr
    said = b"" if errors is None else errors.read()
    lines = said.decode(errors="replace").strip().splitlines()
    log.warning(
        "compiling %s in a process of its own failed (exit status %s%s): compiling here",
        " and ".join(parts),
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
