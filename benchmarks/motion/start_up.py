"""How long the first use takes, and every later one.

    python benchmarks/motion/start_up.py [PACKAGE ...]

Copies each package folder (by default the installed one; name another checkout's ``up_samp`` to
compare) to an empty folder with an empty cache, and runs it there in fresh processes: once cold,
then again, the fastest of three. Seconds by the clock, and of the processors in brackets: on a busy
machine compare these.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import up_samp

SMALLEST = "jobshop-r1-j1-m1"
RUN = "import sys; from up_samp.cli import main; sys.exit(main({arguments!r}))"
OTHERS = """
import unified_planning.shortcuts as s; s.get_environment().factory
from ortools.sat.python import cp_model
from scipy import ndimage; from scipy.sparse import csgraph
import shapely, numba.core.registry as r; r.cpu_target.target_context.refresh()
"""
STEPS = {
    "`import unified_planning.shortcuts`, its environment used": (
        "import unified_planning.shortcuts as s; s.get_environment().factory"
    ),
    "all imports of others that a solve needs": OTHERS,
    "`import up_samp`": "import up_samp",
    "`up-samp --version`": RUN.format(arguments=["--version"]),
    "`up-samp demo`, with pictures and GIF": RUN.format(arguments=["demo", "--out", "out"]),
    f"`up-samp solve {SMALLEST}`": RUN.format(arguments=["solve", SMALLEST]),
}


def seconds(code: str, folder: Path) -> tuple[float, float]:
    """Return the clock's and the processors' time of a fresh process that uses the package in
    ``folder``.
    """
    env = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "UP_SAMP_CACHE_DIR": str(folder / "cache"),
        "HOME": str(folder),
    }
    env.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation keeps its bytecode
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=env, capture_output=True, text=True
    )
    if done.returncode != 0:
        raise SystemExit(f"{code}\nfailed: {done.stderr}")
    clock, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return clock, used


def measure(package: Path) -> None:
    """Print a Markdown table for one package folder."""
    print(f"\n{package}\n\n| a fresh process that does | cold, s | again, s |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(package, folder / "up_samp", ignore=ignored)
        for step, code in STEPS.items():
            cold = seconds(code, folder)
            again = min(seconds(code, folder) for _ in range(3))
            cells = " | ".join(f"{clock:.2f} ({used:.2f})" for clock, used in (cold, again))
            print(f"| {step} | {cells} |", flush=True)


def main() -> None:
    """Measure every package that the command line names."""
    for name in sys.argv[1:] or [Path(up_samp.__file__).parent]:
        measure(Path(name).resolve())


if __name__ == "__main__":
    main()
