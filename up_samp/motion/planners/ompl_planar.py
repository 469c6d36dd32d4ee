"""Legs of cars (REEDSSHEPP) and omnidirectional bodies (SE2) by OMPL's planners.

OMPL searches; every edge is checked whole by one compiled, swept-safe call, which also records what
stood in the way. The path found is shortened with times in view, and timed from rest to rest.
(Sucan, Moll & Kavraki, *The Open Motion Planning Library*, 2012.)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from up_samp.geometry import Scene
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Placed,
    Trajectory,
    UnsupportedError,
)
from up_samp.motion.curves.arcs import merged, path_time
from up_samp.motion.curves.blending import pieces
from up_samp.motion.curves.reeds_shepp import CarLimits, shortest
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.guides.search_space import MARGIN_SHARES, search_box
from up_samp.motion.planners import ompl_edges as edges
from up_samp.motion.planners.car_shortcuts import Effort, improve, settle
from up_samp.motion.planners.gliding import Glider
from up_samp.motion.planners.omni_astar import planar_limits, shortened
from up_samp.motion.planners.ompl_solve import (
    Counter,
    EdgeValidity,
    OmplLeg,
    Solved,
    Validity,
    box_bounds,
    canonical,
    ob,
    og,
    set_seed,
    solve,
)
from up_samp.motion.protocol import LegQuery

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class OmplSettings:
    """Effort. ``polish``: edge checks that improving planners spend after a first path.
    ``rounds``, ``patience``: of the shortening. ``reach``: longest extension, in turning radii or
    body lengths, but not less than ``share`` of the map's diagonal.
    """

    polish: int = 400
    rounds: int = 1500
    patience: int = 300
    reach: float = 6.0
    share: float = 0.05
    nearest: int = 40

    def __post_init__(self) -> None:
        for name in ("polish", "rounds", "patience", "reach", "share", "nearest"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")


@dataclass(frozen=True)
class TreeSearch:
    """What one search came to: the ``nodes`` (n, 3) of a path or None; the ``blockers`` that its
    extensions ran into; its ``tree`` of reached poses (m, 3); the number of edge ``checks``;
    whether it ended by itself (``complete``) and not by a deadline.
    """

    nodes: FloatArray | None
    reason: str
    blockers: frozenset[str] = frozenset()
    tree: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    checks: int = 0
    complete: bool = False


class PlanarWorld:
    """One body among resting obstacles: the compiled checks, and OMPL's space around them."""

    def __init__(
        self,
        scene: Scene,
        body: Body,
        poses: Sequence[Configuration],
        obstacles: tuple[Placed, ...],
        settings: OmplSettings,
    ) -> None:
        if body.flies:
            raise UnsupportedError("a free flyer (SE3) does not move in the plane")
        self.scene, self.body, self.obstacles = scene, body, obstacles
        self.car = body.mobility.steers
        self.settings = settings
        self.hits = np.zeros(len(obstacles) + 1, dtype=np.int64)
        self.radius = limits_of(body.kinematics).radius
        self._car = CarLimits(self.radius, 1.0, math.inf)  # its fastest curves are the shortest
        self._poses = poses
        self.margin = scene.margin
        self.shape = scene.shape(body)
        self.data = scene.world(self.shape, obstacles)

    def fit_margin(self) -> bool:
        """Take the largest margin that the query's poses can keep; False if they keep none."""
        for share in MARGIN_SHARES:
            self.margin = self.scene.margin * share
            self.shape = self.scene.shape(self.body, self.margin)
            self.data = self.scene.world(self.shape, self.obstacles)
            if all(self.pose_free(p[0], p[1], p[2]) for p in self._poses):
                self.hits[:] = 0
                return True
        return False

    def pose_free(self, x: float, y: float, th: float) -> bool:
        """Return whether the body keeps the margin at a pose."""
        return bool(edges.look(self.data, x, y, th, self.hits) >= 0.0)

    def edge_free(self, ax: float, ay: float, ath: float, bx: float, by: float, bth: float) -> bool:
        """Return whether the body keeps the margin all along the edge between two poses."""
        a, b = (ax, ay, ath), (bx, by, bth)
        if self.car:
            return bool(edges.car_edge(self.data, self._car, a, b, self.hits))
        return bool(edges.line_edge(self.data, a, b, self.hits))

    def blockers(self) -> frozenset[str]:
        """Return the obstacles that checks have hit so far."""
        return frozenset(p.name for p, n in zip(self.obstacles, self.hits, strict=False) if n)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (m) of the box that is searched."""
        reach = 8 * self.radius + 2 * self.shape.circumscribed
        return search_box(self.scene, self._poses, self.obstacles, reach)

    def information(self, counter: Counter) -> tuple[Any, float]:
        """Return OMPL's space information and the longest extension (m)."""
        low, high = self.box()
        space = ob.ReedsSheppStateSpace(self.radius) if self.car else ob.SE2StateSpace()
        space.setBounds(box_bounds(low.tolist(), high.tolist()))
        si = ob.SpaceInformation(space)
        si.setStateValidityChecker(Validity(si, lambda s: self.pose_free(*_read(s))))
        si.setMotionValidator(
            EdgeValidity(si, lambda a, b: self.edge_free(*_read(a), *_read(b)), counter)
        )
        si.setup()
        size = self.radius if self.car else 2 * self.shape.circumscribed
        diagonal = float(np.linalg.norm(high - low))
        return si, max(self.settings.reach * size, self.settings.share * diagonal)


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
    deadline: Deadline,
    *,
    planner: str,
    seed: int,
    tree: bool = False,
) -> TreeSearch:
    """Look for a path with one of OMPL's planners; ``tree``: also tell what was reached."""
    name = canonical(planner)
    counter = Counter()
    si, reach = world.information(counter)
    pdef = ob.ProblemDefinition(si)
    # the goal is the pose itself: OMPL must only be told that it may hit it exactly
    pdef.setStartAndGoalStates(state_of(si, start), state_of(si, goal), 1e-9)
    samples = 1000
    set_seed(seed)
    while True:
        method = getattr(og, name)(si)
        if hasattr(method, "setRange"):
            method.setRange(reach)
        if hasattr(method, "setNumSamples"):
            method.setNumSamples(samples)
        # SORRT* samples ever smaller sets by rejection: after a good path it hardly gets on
        polish = 1 if name == "SORRTstar" else world.settings.polish
        solved: Solved = solve(
            method, pdef, deadline, counter, polish=polish, read=_read, tree=tree
        )
        one_shot = hasattr(method, "setNumSamples")
        if solved.states is not None or not one_shot or deadline.expired():
            break
        samples *= 2  # a planner of one batch of samples may need more of them
    reached = np.array(solved.tree, dtype=np.float64).reshape(-1, 3)
    nodes = None
    if solved.states is not None:
        nodes = _joined_nodes(start, goal, np.array(solved.states, dtype=np.float64))
    reason = "" if nodes is not None else f"OMPL's {name} found no path ({solved.status.lower()})"
    return TreeSearch(nodes, reason, world.blockers(), reached, counter.edges, not counter.cut)


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
    curves = [shortest(tuple(a), tuple(b), limits.radius)[1] for a, b in itertools.pairwise(nodes)]
    raw = merged(np.concatenate(curves))
    origin, target = nodes[0], np.array(goal[:3], dtype=np.float64)
    effort = Effort(world.settings.rounds, world.settings.patience, seed)
    best = None
    for arcs in (raw, improve(world.data, origin, raw, limits, effort)):
        faster = best is None or path_time(arcs, *limits[1:]) < path_time(best, *limits[1:])
        if settle(origin, target, arcs) < 1e-7 and faster:
            best = arcs
    if best is None:
        return None
    return trajectory_of((start, goal), (best,), world.body.kinematics)


def _glide(
    world: PlanarWorld, goal: Configuration, nodes: FloatArray, seed: int
) -> tuple[Trajectory | None, FloatArray]:
    """Return an omnidirectional body's timed motion along ``nodes``, shortened, corners blended,
    and its corners.
    """
    limits = planar_limits(world.body.kinematics)
    nodes = shortened(world.data, nodes, limits, world.settings.rounds, seed)
    corners = pieces(nodes)
    found = Glider(world.scene, world.body, world.shape, world.obstacles).glide(corners, goal)
    return (None if found is None else found[0]), corners


def planar_leg(
    scene: Scene,
    query: LegQuery,
    deadline: Deadline,
    *,
    planner: str,
    seed: int,
    settings: OmplSettings | None = None,
) -> OmplLeg:
    """Return a motion from rest to rest by one of OMPL's planners."""
    start, goal = query.start, query.goal
    settings = settings or OmplSettings()
    world = PlanarWorld(scene, query.body, (start, goal), query.obstacles, settings)
    if not world.fit_margin():
        reason = "the start or the goal touches the map or an obstacle"
        return OmplLeg(None, reason, world.blockers(), complete=True)
    found = search(world, start, goal, deadline, planner=planner, seed=seed)
    if found.nodes is None:
        return OmplLeg(None, found.reason, found.blockers, found.checks, found.complete)
    corners = None
    if world.car:
        trajectory = _drive(world, start, goal, found.nodes, seed)
    else:
        trajectory, corners = _glide(world, goal, found.nodes, seed)
    reason = "" if trajectory is not None else "a path was found but not timed safely"
    return OmplLeg(trajectory, reason, found.blockers, found.checks, found.complete, corners)
