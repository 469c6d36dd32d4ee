"""OMPL's planners by name, and what a search has reached.

A search that ends without a path is never a proof.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from up_samp.geometry import Scene
from up_samp.model import (
    Configuration,
    Deadline,
    PathQuery,
    ProblemError,
    UnsupportedError,
)
from up_samp.model.arrays import FloatArray
from up_samp.motion.budget import WorkBudget
from up_samp.motion.models import MODELS, made_by
from up_samp.motion.planners.ompl_planar import PlanarWorld, search
from up_samp.motion.planners.ompl_solve import ONE_TREE, canonical, known_planners
from up_samp.motion.protocol import Leg, LegQuery

PLANNERS = known_planners()
"""Names of the geometric planners that the installed OMPL offers."""


NEAREST = 40
"""Vertices of a tree from which a target is tried."""


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
        where = MODELS[query.body.kinematics.model].ompl
        if not where:
            raise UnsupportedError(
                f"the motion planner '{self.name}' is OMPL's, which has no paths for bodies that "
                "turn on the spot (turning_radius 0): leave 'path_planner' at 'default'"
            )
        leg: Leg = made_by(where)(self.scene, query, deadline, planner=self.name, seed=self.seed)
        return leg


def flyer_planner(scene: Scene, seed: int) -> OmplPlanner:
    """Return who plans free flyers: RRTConnect (see :mod:`up_samp.motion.planners.flyer`)."""
    return OmplPlanner("RRTConnect", scene, seed, reversible=True)


def control_planner(scene: Scene, seed: int) -> OmplPlanner:
    """Return who plans bodies with a law of their own: RRT, and exact ends (see
    :mod:`up_samp.motion.planners.control`).
    """
    return OmplPlanner("RRT", scene, seed)


def explore(
    scene: Scene,
    query: PathQuery,
    targets: Mapping[str, Configuration],
    deadline: Deadline,
    *,
    planner: str = "RRT",
    seed: int = 0,
) -> tuple[bool, frozenset[str], frozenset[str]]:
    """Search from the first to the last pose of a query; return whether the last one was reached,
    the names of the targets that were, and the obstacles that extensions ran into.

    The paper's reading of an RRT: a target counts as reached if the tree has a vertex from which it
    is one free edge away (the nearest ``NEAREST`` are tried); an obstacle is a blocker if
    an extension collided with it. A target that was not reached is *not* proven unreachable.
    """
    if canonical(planner) not in ONE_TREE:
        trees = ", ".join(sorted(ONE_TREE))
        raise UnsupportedError(
            f"what {planner} reached is not recorded; planners that can: {trees}"
        )
    start, goal = query.poses[0], query.poses[-1]
    world = PlanarWorld(scene, query.body, (start,), query.obstacles)
    world.hits = set()
    if not world.fit_margin():
        return False, frozenset(), frozenset(world.hits)
    budget = WorkBudget(deadline)
    nodes, _, tree = search(world, start, goal, budget, planner=planner, seed=seed, tree=True)
    blockers = frozenset(world.hits)  # not those of what is looked at now
    reached = frozenset(name for name, pose in targets.items() if _reaches(world, tree, pose))
    return nodes is not None, reached, blockers


def _reaches(world: PlanarWorld, tree: FloatArray, pose: Configuration) -> bool:
    """Return whether a free edge leads from a vertex of the tree to a pose."""
    x, y, th = (float(v) for v in pose[:3])
    if not world.pose_free(x, y, th):
        return False
    nearest = np.argsort(np.hypot(tree[:, 0] - x, tree[:, 1] - y))[:NEAREST]
    a = tree[nearest].tolist()
    return any(world.edge_free(v[0], v[1], v[2], x, y, th) for v in a)
