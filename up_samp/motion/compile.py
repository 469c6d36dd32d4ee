"""Compile all kernels that planar bodies need, before any time limit runs, side by side.

numba keeps what it compiled on disk, so this happens once per machine and version.
"""

from __future__ import annotations

import hashlib
import logging
import math
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import llvmlite.binding
import numba
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
    from up_samp.motion.fleet import coordinate, offset_profile

    east = _motion("east", (1.0, 4.0, 0.0), (7.0, 4.0, 0.0))
    north = _motion("north", (4.0, 1.0, math.pi / 2), (4.0, 7.0, math.pi / 2))
    third = Rest("third", _BODY, (1.0, 7.5, 0.0), -math.inf, math.inf)
    straight = _Straight()
    coordinate(straight, GroupQuery((east, north), (third,)), Deadline.never())
    offset_profile(straight, east, north)


def compile_search() -> None:
    """Run the searches for one car around movers, once: safe intervals, and samples."""
    from up_samp.motion.fleet.sipp import Roundabout
    from up_samp.motion.fleet.timed_path import fixed_run

    mover = fixed_run(FixedMotion("west", "west", _BODY, _drive((11.0, 6.0, math.pi), (7, 6, 3))))
    around = _motion("around", (2.0, 6.0, 0.0), (10.0, 6.0, 0.0))
    roundabout = Roundabout(Scene(_hall(), 0.01))
    roundabout.paths(around, 0.0, (), [mover], 8.0, Deadline.never())
    roundabout.sampled(around, 0.0, (), [mover], 8.0, Deadline.never())


def compile_planar() -> None:
    """Run what plans single omnidirectional bodies, once."""
    service = MotionService(_hall())
    body = Body(_BODY.footprint, Kinematics(MotionModel.SE2))
    start, goal = (3.0, 2.0, 0.0), (9.0, 2.0, math.pi / 2)
    service.lower_bound(body, start, goal)
    service.plan(PathQuery(body, (start, goal)), Deadline.never())


PARTS = {
    "paths": compile_paths,
    "groups": compile_groups,
    "search": compile_search,
    "planar": compile_planar,
}

CHAINS: dict[MotionModel, tuple[tuple[str, ...], ...]] = {
    MotionModel.REEDSSHEPP: (("paths",), ("groups", "search")),
    MotionModel.SE2: (("groups", "planar"),),
}
"""Parts that bodies of each motion model need: every chain is compiled in a process of its own, in
this order, so that a later part finds what another process has compiled meanwhile.
"""


def chains_for(models: Iterable[MotionModel]) -> list[tuple[str, ...]]:
    """Return the chains that these motion models need, each part once."""
    seen: set[str] = set()
    found = []
    for model in sorted(set(models), key=list(MotionModel).index):
        for chain in CHAINS.get(model, ()):
            parts = tuple(part for part in chain if part not in seen)
            seen.update(parts)
            if parts:
                found.append(parts)
    return found


def missing(parts: Iterable[str]) -> tuple[str, ...]:
    """Return which of the parts have not been compiled, as the code is now."""
    folder = _cache_folder()
    if folder is None:  # numba is switched off
        return ()
    state = _state_of_code()
    return tuple(part for part in parts if not _has_mark(folder / f"{part}.compiled", state))


def _has_mark(mark: Path, state: str) -> bool:
    try:
        return mark.read_text(encoding="utf-8") == state
    except OSError:
        return False


def _cache_folder() -> Path | None:
    """Return where numba keeps the kernels on disk."""
    from up_samp.motion.planners import hybrid_astar as hybrid

    stats = getattr(hybrid.expand, "stats", None)
    return None if stats is None else Path(stats.cache_path)


def _sources() -> list[Path]:
    package = Path(__file__).parents[1]
    return sorted([*(package / "geometry").rglob("*.py"), *(package / "motion").rglob("*.py")])


def _state_of_code() -> str:
    """Return what decides whether numba can use the kernels on disk: their sources (it compares
    times and sizes), the processor, and the versions.
    """
    sources = [(f, f.stat()) for f in _sources() if b"njit" in f.read_bytes()]
    lines = [
        *(f"{f.name} {s.st_mtime_ns} {s.st_size}" for f, s in sources),
        f"numba {numba.__version__}, python {sys.version}, {llvmlite.binding.get_host_cpu_name()}",
    ]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def compile_part(part: str) -> None:
    """Compile a part and leave a mark that says so."""
    state = _state_of_code()
    PARTS[part]()
    folder = _cache_folder()
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{part}.compiled").write_text(state, encoding="utf-8")


def precompile(models: Iterable[MotionModel] = (MotionModel.REEDSSHEPP,)) -> float:
    """Compile what bodies of these motion models need and is missing; return the seconds it took.

    At most two processes work side by side.
    """
    chains = [needed for chain in chains_for(models) if (needed := missing(chain))]
    if not chains:
        return 0.0
    began = time.monotonic()
    log.warning("compiling motion kernels (once on this machine, about a minute)")
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "up_samp.motion.compile", *chain],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for chain in chains
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
    for part in sys.argv[1:]:
        compile_part(part)
