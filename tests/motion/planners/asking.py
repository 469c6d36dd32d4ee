"""Whole queries for OMPL's planners, leg by leg."""

import itertools
import time

from up_samp.model import MotionModel, Outcome, PathReport
from up_samp.motion.curves.trajectories import at_rest, joined
from up_samp.motion.planners.ompl import ompl_leg
from up_samp.motion.planners.ompl_solve import canonical
from up_samp.motion.protocol import LegQuery


def plan_with_ompl(scene, query, deadline, *, planner, seed=0):
    """Answer a query with one of OMPL's planners, resting at each pose; blockers are the obstacles
    that the search ran into.
    """
    began = time.monotonic()
    name = canonical(planner, query.body.kinematics.model is MotionModel.CONTROL)
    parts = [at_rest(query.poses[0])]
    met = frozenset()
    for start, goal in itertools.pairwise(query.poses):
        if tuple(start) == tuple(goal):
            continue
        part = LegQuery(query.body, start, goal, query.obstacles)
        leg = ompl_leg(scene, part, deadline, planner=name, seed=seed)
        if leg.trajectory is None:
            return PathReport(
                Outcome.NOT_FOUND if leg.complete else Outcome.OUT_OF_TIME,
                blockers=leg.blockers,
                reason=leg.reason,
                planner=name,
                seconds=time.monotonic() - began,
            )
        met |= leg.blockers
        parts.append(leg.trajectory)
    return PathReport(
        Outcome.FOUND,
        joined(parts),
        blockers=met,
        planner=name,
        seconds=time.monotonic() - began,
    )
