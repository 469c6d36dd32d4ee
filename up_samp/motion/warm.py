"""First use: numba compiles the kernels once per machine and keeps them on disk."""

from __future__ import annotations

import logging
import math
import time
from pathlib import Path

import numpy as np

from up_samp.geometry import OccupancyGrid, Scene
from up_samp.geometry.maps import BoolArray
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Placed

log = logging.getLogger(__name__)

_done: set[str] = set()


def is_cold() -> bool:
    """Return whether the car planner's kernels have not been compiled on this machine yet."""
    from up_samp.motion.planners import hybrid_astar as hybrid

    stats = getattr(hybrid.expand, "stats", None)
    if stats is None:  # numba is switched off
        return False
    folder = Path(stats.cache_path)
    return not any(folder.glob("hybrid_astar.expand-*.nbi"))


def warm_up(model: MotionModel) -> float:
    """Compile what motions of this kind need, if nothing is compiled yet; return the seconds.

    So that a first query does not spend its time limit on compiling. Says so once in the log.
    """
    if model is not MotionModel.REEDSSHEPP or "car" in _done:
        return 0.0
    _done.add("car")
    if not is_cold():
        return 0.0
    began = time.monotonic()
    log.warning("compiling motion kernels (once)")
    from up_samp.motion.planners.car import CarPlanner
    from up_samp.motion.proofs.certificates import Certifier
    from up_samp.motion.protocol import LegQuery

    cells: BoolArray = np.zeros((40, 60), dtype=np.bool_)
    cells[:25, 28:32] = True
    scene = Scene(OccupancyGrid(cells, 0.2))
    body = Body(
        ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)), Kinematics(MotionModel.REEDSSHEPP)
    )
    start, goal = (3.0, 2.0, 0.0), (9.0, 2.0, math.pi / 2)
    parked = (Placed("parked", body, (3.0, 6.5, 0.0)),)
    Certifier(scene).prove(body, (start, goal), parked)
    CarPlanner(scene).leg(LegQuery(body, start, goal, parked), Deadline.never())
    seconds = time.monotonic() - began
    log.info("compiled motion kernels in %.1f s", seconds)
    return seconds
