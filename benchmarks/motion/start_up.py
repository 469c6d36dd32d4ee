"""How long the first use takes: kernels compiled for the first time, and read from numba's cache.

    python benchmarks/motion/start_up.py

Copies the package to an empty folder, so that nothing is compiled, and uses it from there in fresh
processes. Processor seconds, so that they can be read on a busy machine; by the clock it is less
where two processes compile side by side.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import up_samp

STEPS = {
    "import up_samp": "import up_samp",
    "compile for cars": "from up_samp.motion.compile import precompile as p; p()",
    "compile for omnidirectional bodies, too": (
        "from up_samp.motion.compile import precompile as p; "
        "from up_samp.model import MotionModel as m; p((m.REEDSSHEPP, m.SE2))"
    ),
    "first car query": (
        "import math; from up_samp.geometry import OccupancyGrid; import numpy as np; "
        "from up_samp.model import *; from up_samp.motion import MotionService; "
        "cells = np.zeros((200, 300), dtype=bool); cells[:120, 148:152] = True; "
        "box = ((-1., -.5), (1., -.5), (1., .5), (-1., .5)); "
        "body = Body(box, Kinematics(MotionModel.REEDSSHEPP)); "
        "query = PathQuery(body, ((4., 4., 0.), (25., 4., math.pi / 2))); "
        "report = MotionService(OccupancyGrid(cells, 0.1)).plan(query, Deadline.never()); "
        "assert report.trajectory is not None"
    ),
}


def seconds(code: str, folder: Path) -> float:
    """Return the processor time of a fresh process that uses the package in ``folder``."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    env = {**os.environ, "PYTHONPATH": str(folder)}
    subprocess.run([sys.executable, "-c", code], cwd=folder, env=env, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print a Markdown table."""
    package = Path(up_samp.__file__).parent
    print("| a fresh process that does | nothing compiled (s) | again (s) |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ignored = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
        shutil.copytree(package, folder / "up_samp", ignore=ignored)
        for step, code in STEPS.items():
            first = seconds(code, folder)
            again = min(seconds(code, folder) for _ in range(3))
            print(f"| {step} | {first:.1f} | {again:.2f} |", flush=True)


if __name__ == "__main__":
    main()
