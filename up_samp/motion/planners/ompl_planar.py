"""Legs of cars (REEDSSHEPP) and omnidirectional bodies (SE2) by OMPL's planners.

OMPL searches; every edge is checked whole by one compiled call, by conservative advancement
(Mirtich 1996): nothing slips through between two checks. The path found is shortened with times in
view, and timed from rest to rest.
(Sucan, Moll & Kavraki, *The Open Motion Planning Library*, 2012.)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.kernels import clearance
from up_samp.geometry.records import WorldData, kernel, open_plane
from up_samp.geometry.sweeps import first_blocked
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Placed,
    Trajectory,
    UnsupportedError,
)
from up_samp.model.arrays import FloatArray
from up_samp.motion.budget import WorkBudget
from up_samp.motion.curves.blending import glide, pieces
from up_samp.motion.curves.reeds_shepp import (
    DriveLimits,
    Pose,
    connect,
    merged,
    path_time,
    shortest,
)
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.guides.search_space import TOUCHES, search_box, widest_shape
from up_samp.motion.planners.car_shortcuts import improve, settle
from up_samp.motion.planners.omni_astar import planar_limits, shortened, straight_free
from up_samp.motion.planners.ompl_solve import (
    EdgeValidity,
    Validity,
    box_bounds,
    canonical,
    ob,
    og,
    set_seed,
    solve,
    vertices,
)
from up_samp.motion.protocol import Leg, LegQuery

ROUNDS, PATIENCE = 1500, 300
"""Of the shortening."""
REACH, SHARE = 6.0, 0.05
"""Longest extension, in turning radii or body lengths, but not less than a share of the map's
diagonal.
"""


@kernel
def curve_free(world: WorldData, car: DriveLimits, a: Pose, b: Pose) -> bool:
    """Return whether the fastest Reeds-Shepp curve between two poses keeps the margin (with v = 1
    and a = inf it is the shortest).
    """
    arcs = np.empty((5, 2))
    _, n = connect(a, b, car, (0.0, 0.0), arcs)
    return first_blocked(world, a, arcs, n) < 0


class PlanarWorld:
    """One body among resting obstacles: the compiled checks, and OMPL's space around them."""

    def __init__(
        self,
        scene: Scene,
        body: Body,
        poses: Sequence[Configuration],
        obstacles: tuple[Placed, ...],
    ) -> None:
        if body.flies:
            raise UnsupportedError("a free flyer (SE3) does not move in the plane")
        self.scene, self.body, self.obstacles = scene, body, obstacles
        self.car = body.mobility.steers
        self.hits: set[str] | None = None
        """Obstacles that checks have run into, where that is noted."""
        self.radius = limits_of(body.kinematics).radius
        # its fastest curves are the shortest
        self._car = limits_of(body.kinematics)._replace(v=1.0, a=math.inf)
        self._poses = poses
        self.shape = scene.shape(body)
        self.data = scene.world(self.shape, obstacles)

    @property
    def _least(self) -> float:
        """The least clearance (m) beyond the margin that swept checks accept."""
        return 0.1 * float(self.shape.data.slack[2])

    def fit_margin(self) -> bool:
        """Take the largest margin that the query's poses can keep; False if they keep none."""
        shape = widest_shape(self.scene, self.body, self._poses, self.obstacles)
        self.shape = shape or self.scene.shape(self.body, 0.0)
        self.data = self.scene.world(self.shape, self.obstacles)
        free = [self.pose_free(*p[:3]) for p in self._poses]  # tells what is hit where it is not
        return shape is not None and all(free)

    def pose_free(self, x: float, y: float, th: float) -> bool:
        """Return whether the body keeps the margin at a pose."""
        return self._is_free(lambda world: bool(clearance(world, x, y, th) >= self._least))

    def edge_free(self, ax: float, ay: float, ath: float, bx: float, by: float, bth: float) -> bool:
        """Return whether the body keeps the margin all along the edge between two poses: a car's
        shortest curve, or straight, turning the shorter way round at a constant rate.
        """
        a, b = (ax, ay, ath), (bx, by, bth)
        if not self.pose_free(*b):
            return False
        if self.car:
            return self._is_free(lambda world: bool(curve_free(world, self._car, a, b)))
        turn = (bth - ath + math.pi) % (2.0 * math.pi) - math.pi
        move = bx - ax, by - ay, turn
        return self._is_free(lambda world: bool(straight_free(world, a, move)))

    def _is_free(self, test: Callable[[WorldData], bool]) -> bool:
        """Return whether a test holds among everything; if it does not, and that is asked for, note
        the obstacles among each of which alone it does not.
        """
        free = test(self.data)
        if not free and self.hits is not None:
            for placed in self.obstacles:
                alone = WorldData(open_plane(), self.scene.polys((placed,)), self.shape.data)
                if placed.name not in self.hits and not test(alone):
                    self.hits.add(placed.name)
        return free

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (m) of the box that is searched."""
        reach = 8 * self.radius + 2 * self.shape.circumscribed
        return search_box(self.scene, self._poses, self.obstacles, reach)

    def information(self, budget: WorkBudget) -> tuple[Any, float]:
        """Return OMPL's space information and the longest extension (m)."""
        low, high = self.box()
        space = ob.SE2StateSpace()
        if self.car:
            curves = ob.ReedsSheppStateSpace if self._car.sense == 0.0 else ob.DubinsStateSpace
            space = curves(self.radius)
        space.setBounds(box_bounds(low.tolist(), high.tolist()))
        si = ob.SpaceInformation(space)
        si.setStateValidityChecker(Validity(si, lambda s: self.pose_free(*_read(s))))
        si.setMotionValidator(
            EdgeValidity(si, lambda a, b: self.edge_free(*_read(a), *_read(b)), budget)
        )
        si.setup()
        size = self.radius if self.car else 2 * self.shape.circumscribed
        diagonal = float(np.linalg.norm(high - low))
        return si, max(REACH * size, SHARE * diagonal)


def state_of(si: Any, pose: Configuration) -> Any:
    """Return a pose as a state of OMPL's."""
    state = si.allocState()
    state.setX(float(pose[0]))
    state.setY(float(pose[1]))
    # in [-pi, pi): pi itself is out of bounds for OMPL
    state.setYaw((float(pose[2]) + math.pi) % (2 * math.pi) - math.pi)
    return state


def _read(state: Any) -> tuple[float, float, float]:
    return state.getX(), state.getY(), state.getYaw()


def search(
    world: PlanarWorld,
    start: Configuration,
    goal: Configuration,
    budget: WorkBudget,
    *,
    planner: str,
    seed: int,
    tree: bool = False,
) -> tuple[FloatArray | None, str, FloatArray]:
    """Look for a path with one of OMPL's planners; return its nodes (n, 3), or None and why, and
    (if a ``tree`` is asked for) the poses (m, 3) that were reached.
    """
    name = canonical(planner)
    si, reach = world.information(budget)
    pdef = ob.ProblemDefinition(si)
    # the goal is the pose itself: OMPL must only be told that it may hit it exactly
    pdef.setStartAndGoalStates(state_of(si, start), state_of(si, goal), 1e-9)
    set_seed(seed)
    method = getattr(og, name)(si)
    if hasattr(method, "setRange"):
        method.setRange(reach)
    states, status = solve(method, pdef, budget, polish=400, read=_read)
    poses = vertices(method, _read) if tree else []
    reached = np.array(poses, dtype=np.float64).reshape(-1, 3)
    if states is None:
        return None, f"OMPL's {name} found no path ({status.lower()})", reached
    return _joined_nodes(start, goal, np.array(states, dtype=np.float64)), "", reached


def _joined_nodes(start: Configuration, goal: Configuration, nodes: FloatArray) -> FloatArray:
    """Return a path's nodes with theta continuous and the query's own poses at the ends."""
    nodes = np.concatenate([[start[:3]], nodes[1:-1], [goal[:3]]])
    nodes[:, 2] = np.unwrap(nodes[:, 2])
    keep = np.ones(len(nodes), dtype=np.bool_)
    keep[1:-1] = np.abs(np.diff(nodes, axis=0)[:-1]).max(axis=1) > 1e-9
    return np.asarray(nodes[keep])


def _drive(
    world: PlanarWorld, start: Configuration, goal: Configuration, nodes: FloatArray, seed: int
) -> Trajectory | None:
    """Return a car's timed motion along the curves between ``nodes``, shortened."""
    limits = limits_of(world.body.kinematics)
    pairs = list(itertools.pairwise(nodes))
    if limits.sense != 0.0 and not all(world.edge_free(*a, *b) for a, b in pairs):
        return None  # some of OMPL's planners check an edge one way and take it the other way
    curves = [shortest(tuple(a), tuple(b), limits.radius, limits.sense)[1] for a, b in pairs]
    raw = merged(np.concatenate(curves))
    origin, target = nodes[0], np.array(goal[:3], dtype=np.float64)
    best = None
    for arcs in (raw, improve(world.data, origin, raw, limits, (ROUNDS, PATIENCE), seed)):
        faster = best is None or path_time(arcs, limits) < path_time(best, limits)
        if settle(origin, target, arcs) < 1e-7 and faster:
            best = arcs
    if best is None:
        return None
    return trajectory_of((start, goal), best, world.body.kinematics)


def _glide(
    world: PlanarWorld, goal: Configuration, nodes: FloatArray, seed: int
) -> tuple[Trajectory | None, FloatArray]:
    """Return an omnidirectional body's timed motion along ``nodes``, shortened, corners blended,
    and its corners.
    """
    kin = world.body.kinematics
    corners = pieces(shortened(world.data, nodes, planar_limits(kin), ROUNDS, seed))
    found = glide(world.data, kin, corners, goal)
    return (None if found is None else found[0]), corners


def planar_leg(
    scene: Scene, query: LegQuery, deadline: Deadline, *, planner: str, seed: int
) -> Leg:
    """Return a motion from rest to rest by one of OMPL's planners."""
    start, goal = query.start, query.goal
    world = PlanarWorld(scene, query.body, (start, goal), query.obstacles)
    if not world.fit_margin():
        return Leg(None, TOUCHES, complete=True)
    budget = WorkBudget(deadline)
    nodes, reason, _ = search(world, start, goal, budget, planner=planner, seed=seed)
    if nodes is None:
        return Leg(None, reason, budget.used, not budget.cut)
    corners = None
    if world.car:
        trajectory = _drive(world, start, goal, nodes, seed)
    else:
        trajectory, corners = _glide(world, goal, nodes, seed)
    unsafe = f"OMPL's {planner} found a path, but none that is safe the way it has to be driven"
    reason = "" if trajectory is not None else unsafe
    return Leg(trajectory, reason, budget.used, not budget.cut, corners)
