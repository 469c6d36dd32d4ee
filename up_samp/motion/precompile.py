"""Compile all kernels that cars need, before any time limit runs: two parts, side by side.

numba keeps what it compiled on disk, so this happens once per machine and version.
"""

from __future__ import annotations

import logging
import math
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from up_samp.geometry import OccupancyGrid, Scene
from up_samp.geometry.maps import BoolArray
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    FixedMotion,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.service import MotionService

log = logging.getLogger(__name__)

_BODY = Body(
    ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)), Kinematics(MotionModel.REEDSSHEPP)
)
_MOST_SECONDS = 600.0


class _Straight:
    """Plans straight drives, so that comparing and tuning paths needs no path kernels."""

    def plan(self, query: PathQuery, deadline: Deadline) -> PathReport:
        """Return a straight drive (for compiling only: it heeds nothing)."""
        drive = _drive(query.poses[0], query.poses[-1])
        return PathReport(Outcome.FOUND, drive, planner="straight")


def _drive(start: Configuration, goal: Configuration) -> Trajectory:
    times = np.linspace(0.0, 8.0, 161)
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, 161))
    poses = np.array(start) + shares[:, None] * (np.array(goal) - np.array(start))
    return Trajectory(times, poses)


def _hall() -> OccupancyGrid:
    """Return a hall of 12 x 8 m with a wall in it."""
    cells: BoolArray = np.zeros((40, 60), dtype=np.bool_)
    cells[:20, 28:32] = True
    return OccupancyGrid(cells, 0.2)


def compile_paths() -> None:
    """Run what bounds, refutes and plans single cars, once."""
    service = MotionService(_hall())
    start, goal = (3.0, 2.0, 0.0), (9.0, 2.0, math.pi / 2)
    parked = (Placed("parked", _BODY, (3.0, 6.5, 0.0)),)
    service.lower_bound(_BODY, start, goal)
    service.plan(PathQuery(_BODY, (start, goal), parked), Deadline.never())


def _motion(name: str, *poses: tuple[float, float, float]) -> TimedMotion:
    return TimedMotion(name, name, _BODY, poses, 0.0, 8.5)


def compile_groups() -> None:
    """Run what coordinates cars, once: two that cross where a third one rests."""
    from up_samp.motion.spacetime import coordinate

    east = _motion("east", (1.0, 4.0, 0.0), (7.0, 4.0, 0.0))
    north = _motion("north", (4.0, 1.0, math.pi / 2), (4.0, 7.0, math.pi / 2))
    third = Rest("third", _BODY, (1.0, 7.5, 0.0), -math.inf, math.inf)
    coordinate(_Straight(), GroupQuery((east, north), (third,)), Deadline.never())


def compile_search() -> None:
    """Run the search around movers, once (it is rarely needed, so not before the first plan)."""
    from up_samp.motion.spacetime.roundabout import Roundabout
    from up_samp.motion.spacetime.runs import fixed_run

    mover = fixed_run(FixedMotion("west", "west", _BODY, _drive((11.0, 6.0, math.pi), (7, 6, 3))))
    around = _motion("around", (2.0, 6.0, 0.0), (10.0, 6.0, 0.0))
    Roundabout(Scene(_hall(), 0.01)).paths(around, 0.0, (), [mover], 8.0, Deadline.never())


PARTS = {"paths": compile_paths, "groups": compile_groups, "search": compile_search}

FIRST = ("paths", "groups")
"""What any plan needs."""


def missing(parts: Iterable[str] = FIRST) -> list[str]:
    """Return which of the parts have not been compiled on this machine."""
    from up_samp.motion import hybrid
    from up_samp.motion.spacetime import search, sweep

    marks = {"paths": hybrid.expand, "groups": sweep.conflict_runs, "search": search.expand}
    return [part for part in parts if not _on_disk(marks[part])]


def _on_disk(kernel: Any) -> bool:
    stats = getattr(kernel, "stats", None)
    if stats is None:  # numba is switched off
        return True
    name = kernel.py_func.__qualname__
    module = kernel.py_func.__module__.rsplit(".", 1)[-1]
    return any(Path(stats.cache_path).glob(f"{module}.{name}-*.nbi"))


def precompile(parts: Iterable[str] = FIRST) -> float:
    """Compile what is missing, each part in a process of its own; return the seconds it took."""
    needed = missing(parts)
    if not needed:
        return 0.0
    began = time.monotonic()
    log.warning("compiling motion kernels (once on this machine, about a minute)")
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "up_samp.motion.precompile", part],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for part in needed
    ]
    try:
        for process in processes:
            process.wait(timeout=_MOST_SECONDS)
    finally:
        for process in processes:
            if process.poll() is None:
                process.kill()
                process.wait()
    return time.monotonic() - began


if __name__ == "__main__":
    PARTS[sys.argv[1]]()
