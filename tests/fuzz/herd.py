"""Many problems in one process, watched by another: what kills or hangs it costs one problem only.

Rows are appended to a file, a line of JSON each. The process says which seed it begins with; when
it ends before the row is there, or says nothing for long, that seed gets a row that tells so.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import psutil

from up_samp.system import child

TURN = 400
"""Problems of one process: UP's environment keeps what they were written with."""
MOST_MEGABYTES = 2000
PATIENCE = 400.0
"""Seconds for one problem with its attacks, on a busy machine."""
MARK = "UP_SAMP_FUZZ"
"""All that is started on the way carries the watched process's id in this variable."""


def read_rows(file: Path) -> list[dict]:
    """Return the rows of a file: a line each, or (older files) one list."""
    text = file.read_text() if file.exists() else ""
    if text.startswith("["):
        return json.loads(text)
    return [json.loads(line) for line in text.splitlines()]


def append(file: Path, row: dict) -> None:
    """Add a row to a file."""
    with file.open("a") as stream:
        stream.write(json.dumps(row) + "\n")


def work(seeds: Iterable[int], row_of: Callable[[int], dict], out: Path) -> None:
    """Write the rows of seeds, as the watched process; stop early where memory runs short."""
    own = psutil.Process()
    for done, seed in enumerate(seeds, start=1):
        print(seed, flush=True)
        began = time.process_time()
        row = row_of(seed)
        megabytes = round(own.memory_info().rss / 1e6)
        append(out, row | {"cpu": round(time.process_time() - began, 2), "megabytes": megabytes})
        if done >= TURN or megabytes > MOST_MEGABYTES:
            return


def watch(command: Sequence[str], seeds: Sequence[int], out: Path, stop: float) -> None:
    """Have a process write the rows of ``seeds``, another one after it, until ``stop`` (monotonic).

    ``command`` is what starts one, the seeds left come on its standard input.
    """
    left = list(seeds)
    while left and time.monotonic() < stop:
        wrong, at = _one_process(command, left, out, stop)
        known = {r["seed"] for r in read_rows(out)}
        if wrong and at is not None and at not in known:
            append(out, {"seed": at, "engine": "?", "status": "", "wrong": [wrong]} | _NOTHING)
            known.add(at)
        elif wrong and at is None:
            raise RuntimeError(f"the process that solves does not start: {wrong}")
        left = [s for s in left if s not in known]


_NOTHING = {"sort": "small", "attacks": 0, "faster": [], "seconds": 0.0}


def _one_process(
    command: Sequence[str], seeds: Sequence[int], out: Path, stop: float
) -> tuple[str, int | None]:
    """Return what went wrong ("" if nothing), and the seed at which it ended."""
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
        env=child.environment({MARK: mark}),
        start_new_session=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(" ".join(map(str, seeds[:TURN])))
            process.stdin.close()
        at = None
        try:
            while True:
                wait = min(PATIENCE, max(0.1, stop - time.monotonic()))
                if not select.select([process.stdout], [], [], wait)[0]:
                    ended = time.monotonic() >= stop
                    return ("" if ended else f"hung: no answer for {PATIENCE:g} s"), at
                line = process.stdout.readline()
                if not line:
                    code = process.wait()
                    return (f"the process ended, exit code {code}" if code else ""), at
                at = int(line)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            child.end_all_with(MARK, mark)


def again(script: Path, arguments: Sequence[str]) -> list[str]:
    """Return the command that runs a script as the watched process."""
    return [sys.executable, str(script), *arguments, "--child"]
