"""Legs strung together to one motion, without needless stops at the poses between them."""

from __future__ import annotations

from collections.abc import Sequence

from up_samp.geometry import Scene
from up_samp.model import MotionModel, PathQuery, Trajectory
from up_samp.motion.curves.blending import TINY
from up_samp.motion.curves.passing import driven_through, flown_through, pivoted_through
from up_samp.motion.curves.trajectories import at_rest, joined
from up_samp.motion.protocol import Leg


def strung(scene: Scene, query: PathQuery, legs: Sequence[Leg]) -> tuple[Trajectory, bool]:
    """Return the motion along all ``legs`` of a query, from time 0, and whether it stops between
    them only where it has to.

    A car stops where its direction changes, and what turns on the spot where it turns; bodies that
    can turn their velocity should stop only to turn back, and with their own law of motion nobody
    knows.
    """
    kinematics = query.body.kinematics
    parts = [leg.trajectory for leg in legs if leg.trajectory is not None]
    if len(parts) < 2:
        return (parts[0] if parts else at_rest(query.poses[0])), True
    if kinematics.model is MotionModel.REEDSSHEPP:
        return driven_through(parts, kinematics), True
    if kinematics.model is MotionModel.PIVOT:
        return pivoted_through(parts, kinematics), True
    if kinematics.model is MotionModel.SE3:
        return flown_through(parts, kinematics)
    whole = joined(parts)
    if kinematics.model is MotionModel.SE2:
        from up_samp.motion.planners.gliding import glide_through

        ways = [leg.corners for leg in legs if leg.corners is not None]
        if len(ways) == len(legs):
            gliding = glide_through(scene, query.body, query.poses, ways, query.obstacles)
            if gliding is not None and gliding[0].duration <= whole.duration + TINY:
                return gliding
    return whole, False
