"""OMPL's planners by name: whole queries, second opinions, and what a search has reached.

A search that ends without a path is never a proof: the answer is then ``OUT_OF_TIME``.
"""

from __future__ import annotations

import importlib
import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Scene
from up_samp.model import (
    Configuration,
    Deadline,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    ProblemError,
    UnsupportedError,
)
from up_samp.motion.curves.trajectories import at_rest, joined
from up_samp.motion.planners.ompl_planar import OmplSettings, PlanarWorld, search
from up_samp.motion.planners.ompl_solve import ONE_TREE, OmplLeg, canonical, known_planners
from up_samp.motion.protocol import Leg, LegQuery

PLANNERS = known_planners()
"""Names of the geometric planners that the installed OMPL offers."""


_LEGS = {
    MotionModel.REEDSSHEPP: ("ompl_planar", "planar_leg"),
    MotionModel.SE2: ("ompl_planar", "planar_leg"),
    MotionModel.SE3: ("flyer", "flyer_leg"),
    MotionModel.CONTROL: ("control", "control_leg"),
}


def ompl_leg(
    scene: Scene, query: LegQuery, deadline: Deadline, *, planner: str, seed: int
) -> OmplLeg:
    """Return a motion from rest to rest by OMPL's ``planner``."""
    module, function = _LEGS[query.body.kinematics.model]
    leg = getattr(importlib.import_module(f"up_samp.motion.planners.{module}"), function)
    found: OmplLeg = leg(scene, query, deadline, planner=planner, seed=seed)
    return found


class OmplPlanner:
    """One of OMPL's planners behind the protocol of all motion planners.

    Unless the caller knows better, its legs are not ``reversible``: a control law may not run
    backwards.
    """

    def __init__(self, name: str, scene: Scene, seed: int = 0, *, reversible: bool = False) -> None:
        try:
            self.name = canonical(name)
        except ProblemError:
            self.name = canonical(name, control=True)
        self.scene = scene
        self.seed = seed
        self.reversible = reversible

    def leg(self, query: LegQuery, deadline: Deadline) -> Leg:
        """Return a motion from rest to rest, exactly from the start to the goal."""
        found = ompl_leg(self.scene, query, deadline, planner=self.name, seed=self.seed)
        return Leg(found.trajectory, found.reason, found.checks, found.complete, found.corners)


def flyer_planner(scene: Scene, seed: int = 0) -> OmplPlanner:
    """Return the planner of free flyers: RRTConnect (see :mod:`up_samp.motion.planners.flyer`)."""
    return OmplPlanner("RRTConnect", scene, seed, reversible=True)


def control_planner(scene: Scene, seed: int = 0) -> OmplPlanner:
    """Return the planner of bodies with a law of their own: RRT, and exact ends (see
    :mod:`up_samp.motion.planners.control`).
    """
    return OmplPlanner("RRT", scene, seed)


def plan_with_ompl(
    scene: Scene, query: PathQuery, deadline: Deadline, *, planner: str, seed: int = 0
) -> PathReport:
    """Answer a query with one of OMPL's planners (its name; case does not matter).

    ``FOUND`` with a trajectory from time 0 that keeps the scene's margin all the way, or
    ``OUT_OF_TIME`` with the obstacles that the search ran into as ``blockers``. Deterministic for
    ``seed`` unless the deadline cuts in. Raises ``ProblemError`` for an unknown planner.
    """
    began = time.monotonic()
    name = canonical(planner, query.body.kinematics.model is MotionModel.CONTROL)
    parts = [at_rest(query.poses[0])]
    met: frozenset[str] = frozenset()
    for start, goal in itertools.pairwise(query.poses):
        if tuple(start) == tuple(goal):
            continue
        part = LegQuery(query.body, start, goal, query.obstacles)
        leg = ompl_leg(scene, part, deadline, planner=name, seed=seed)
        if leg.trajectory is None:
            return PathReport(
                Outcome.OUT_OF_TIME,
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


def second_opinion(
    scene: Scene, query: PathQuery, deadline: Deadline, *, seed: int = 0
) -> PathReport:
    """Ask RRTConnect (Kuffner & LaValle 2000), before anybody says "no path" without a proof."""
    planner = "RRT" if query.body.kinematics.model is MotionModel.CONTROL else "RRTConnect"
    return plan_with_ompl(scene, query, deadline, planner=planner, seed=seed)


@dataclass(frozen=True)
class Exploration:
    """What a search reached: names of the ``reached`` targets, the ``blockers`` that its
    extensions ran into, whether the ``goal`` was reached, and how many poses the tree has.
    """

    goal: bool
    reached: frozenset[str]
    blockers: frozenset[str]
    size: int


def explore(
    scene: Scene,
    query: PathQuery,
    targets: Mapping[str, Configuration],
    deadline: Deadline,
    *,
    planner: str = "RRT",
    seed: int = 0,
    settings: OmplSettings | None = None,
) -> Exploration:
    """Search from the first to the last pose of a query and tell what was reached.

    The paper's reading of an RRT: a target counts as reached if the tree has a vertex from which it
    is one free edge away (the nearest ``settings.nearest`` are tried); an obstacle is a blocker if
    an extension collided with it. A target that was not reached is *not* proven unreachable.
    """
    if canonical(planner) not in ONE_TREE:
        trees = ", ".join(sorted(ONE_TREE))
        raise UnsupportedError(
            f"what {planner} reached is not recorded; planners that can: {trees}"
        )
    settings = settings or OmplSettings()
    start, goal = query.poses[0], query.poses[-1]
    world = PlanarWorld(scene, query.body, (start,), query.obstacles, settings)
    if not world.fit_margin():
        return Exploration(False, frozenset(), world.blockers(), 0)
    found = search(world, start, goal, deadline, planner=planner, seed=seed, tree=True)
    reached = frozenset(
        name for name, pose in targets.items() if _reaches(world, found.tree, pose, settings)
    )
    return Exploration(found.nodes is not None, reached, found.blockers, len(found.tree))


def _reaches(
    world: PlanarWorld, tree: npt.NDArray[np.float64], pose: Configuration, settings: OmplSettings
) -> bool:
    """Return whether a free edge leads from a vertex of the tree to a pose."""
    x, y, th = (float(v) for v in pose[:3])
    if not world.pose_free(x, y, th):
        return False
    nearest = np.argsort(np.hypot(tree[:, 0] - x, tree[:, 1] - y))[: settings.nearest]
    a = tree[nearest].tolist()
    return any(world.edge_free(v[0], v[1], v[2], x, y, th) for v in a)
