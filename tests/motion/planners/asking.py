"""Whole queries for OMPL's planners, leg by leg."""

import itertools

from up_samp.model import MotionModel, Outcome, PathReport
from up_samp.motion.curves.trajectories import at_rest, joined
from up_samp.motion.planners.ompl import OmplPlanner, canonical
from up_samp.motion.protocol import LegQuery


def plan_with_ompl(scene, query, deadline, *, planner, seed=0):
    """Answer a query with one of OMPL's planners, resting at each pose."""
    name = canonical(planner, query.body.kinematics.model is MotionModel.CONTROL)
    parts = [at_rest(query.poses[0])]
    for start, goal in itertools.pairwise(query.poses):
        if tuple(start) == tuple(goal):
            continue
        part = LegQuery(query.body, start, goal, query.obstacles)
        leg = OmplPlanner(name, scene, seed).leg(part, deadline)
        if leg.trajectory is None:
            return PathReport(
                Outcome.NOT_FOUND if leg.complete else Outcome.OUT_OF_TIME,
                reason=leg.reason,
                planner=name,
            )
        parts.append(leg.trajectory)
    return PathReport(Outcome.FOUND, joined(parts), planner=name)
