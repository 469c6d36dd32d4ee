"""Admissible lower bounds on the durations of motions."""

from __future__ import annotations

import math
from collections.abc import Sequence

from up_samp.geometry import Scene
from up_samp.model import Body, Configuration, MotionModel, Placed
from up_samp.motion.reeds_shepp import run_time, shortest


class Bounds:
    """Lower bounds (s) on motions in one scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def duration(
        self,
        body: Body,
        start: Configuration,
        goal: Configuration,
        obstacles: Sequence[Placed] = (),
    ) -> float:
        """Return seconds that no motion from rest at ``start`` to rest at ``goal`` can beat."""
        kin = body.kinematics
        length = math.dist(start[:2], goal[:2])
        if kin.model is MotionModel.REEDSSHEPP:
            length = max(length, shortest(start, goal, kin.turning_radius)[0])
        bound = run_time(length, kin.v_max, kin.a_max)
        return bound * (1 - 1e-9)
