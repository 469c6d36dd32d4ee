"""OMPL's planners by name: for cars (REEDSSHEPP) and omnidirectional bodies (SE2); what a search
has reached; and what all uses of OMPL share.

OMPL searches; every edge is checked whole by one compiled call, by conservative advancement
(Mirtich 1996): nothing slips through between two checks. The path found is shortened with times in
view, and timed from rest to rest. A search that ends without a path is never a proof.
(Sucan, Moll & Kavraki, *The Open Motion Planning Library*, 2012.)
"""

from __future__ import annotations

import importlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.kernels import clearance, first_blocked
from up_samp.geometry.records import WorldData, kernel, open_plane
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    PathQuery,
    Placed,
    ProblemError,
    Trajectory,
    UnsupportedError,
)
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.blending import glide, pieces
from up_samp.motion.curves.reeds_shepp import (
    DriveLimits,
    Pose,
    connect,
    fastest,
    merged,
    path_time,
    shortest,
)
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.guides import TOUCHES, search_box, widest_shape
from up_samp.motion.models import MODELS, made_by
from up_samp.motion.planners.car import improve, settle
from up_samp.motion.planners.omni import planar_limits, shortened, straight_free
from up_samp.motion.protocol import Leg, LegQuery, WorkBudget

# ------------------ What all uses of OMPL share
# Seeds, deadlines, names, and solving with honest answers.
# States are made by si.allocState() and never freed by hand, paths are copied into numpy at once:
# with the Python bindings of OMPL 2.0 anything else crashes or leaks.


def _load() -> tuple[Any, Any, Any, Any]:
    try:
        importlib.import_module("ompl")
    except ModuleNotFoundError as error:
        if error.name != "ompl":
            raise
        raise UnsupportedError(
            "OMPL is not installed (there are packages of it for Linux and macOS, not for "
            "Windows): motion models SE3 and CONTROL, OMPL's planners by name and preset 'paper' "
            "need it; cars and omnidirectional bodies do without it"
        ) from error
    return (
        importlib.import_module("ompl.base"),
        importlib.import_module("ompl.geometric"),
        importlib.import_module("ompl.control"),
        importlib.import_module("ompl.util"),
    )


ob, og, oc, ou = _load()
ou.setLogLevel(ou.LOG_NONE)

GEOMETRIC = (
    "RRT", "RRTConnect", "RRTstar", "InformedRRTstar", "BITstar",
    "KPIECE1", "BKPIECE1", "LBKPIECE1", "EST", "BiEST", "ProjEST", "LazyRRT", "TRRT", "BiTRRT",
    "LBTRRT", "RRTsharp", "RRTXstatic", "ABITstar", "AITstar", "EITstar", "SBL", "PDST", "STRIDE",
    "SST",
)  # fmt: skip
"""Geometric planners that are known to work here, where the installed OMPL has them."""

CONTROL = ("RRT", "KPIECE1", "EST")
"""Control planners that are known to work here."""

REFUSED = {
    "PRM": "its second thread makes it neither deterministic nor safe from Python",
    "PRMstar": "its second thread makes it neither deterministic nor safe from Python",
    "AORRTC": "it returns wrong paths (OMPL 2.0.1)",
    "SORRTstar": "after a good path it hardly gets on",
    **dict.fromkeys(("FMT", "BFMT"), "one batch of samples may not be enough"),
}


def known_planners(control: bool = False) -> tuple[str, ...]:
    """Return the names of the planners that the installed OMPL has and that can be used."""
    module, names = (oc, CONTROL) if control else (og, GEOMETRIC)
    return tuple(name for name in names if hasattr(module, name))


def canonical(name: str, control: bool = False) -> str:
    """Return a planner's name as OMPL writes it (case does not matter), or complain."""
    known = known_planners(control)
    for candidate in known:
        if candidate.lower() == name.lower():
            return candidate
    for refused, why in REFUSED.items():
        if refused.lower() == name.lower():
            raise UnsupportedError(f"OMPL's planner {refused} is not supported: {why}")
    kind = "control planner" if control else "planner"
    raise ProblemError(f"OMPL has no {kind} '{name}' here; known are {', '.join(known)}")


def set_seed(seed: int) -> None:
    """Make the next solve repeatable: all random generators made from now on follow ``seed``."""
    ou.RNG.setSeed(1 + seed % (2**31 - 1))  # 0 is refused


def box_bounds(low: Sequence[float], high: Sequence[float]) -> Any:
    """Return OMPL's bounds of a box (m)."""
    bounds = ob.RealVectorBounds(len(low))
    for i, (least, most) in enumerate(zip(low, high, strict=True)):
        bounds.setLow(i, float(least))
        bounds.setHigh(i, float(most))
    return bounds


class Validity(ob.StateValidityChecker):  # type: ignore[misc, name-defined]
    """Asks a check of ours about one state."""

    def __init__(self, si: Any, free: Callable[[Any], bool]) -> None:
        super().__init__(si)
        self._free = free

    def isValid(self, state: Any) -> bool:  # noqa: N802
        """Return whether a state is valid."""
        return self._free(state)


class EdgeValidity(ob.MotionValidator):  # type: ignore[misc, name-defined]
    """Asks a check of ours about a whole edge at a time, and counts them."""

    def __init__(self, si: Any, free: Callable[[Any, Any], bool], budget: WorkBudget) -> None:
        super().__init__(si)
        self._free, self._budget = free, budget

    def checkMotion(self, a: Any, b: Any, *_partly: Any) -> bool:  # noqa: N802
        """Return whether an edge is valid."""
        self._budget.used += 1
        return self._free(a, b)


def solve(
    planner: Any,
    pdef: Any,
    budget: WorkBudget,
    *,
    polish: int,
    read: Callable[[Any], Any] = type,
) -> tuple[list[Any] | None, str]:
    """Set a planner up, and run it until it has a path or the deadline ends; return the states of
    the path if an exact one was found, and OMPL's own word for how it ended.

    Planners that go on improving are stopped ``polish`` edge checks or iterations after their first
    exact path (counted, not timed: the same on every machine). ``read`` copies a state into a value
    of ours (default: nothing of it).
    """
    end: list[int] = []
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        if budget.spent():
            return True
        work = max(asked, budget.used)
        if not end and (pdef.hasExactSolution() or _has_path(planner)):
            end.append(work + polish)
        return bool(end) and work >= end[0]

    planner.setProblemDefinition(pdef)
    planner.setup()
    status = planner.solve(ob.PlannerTerminationCondition(stop))
    words = status.asString()
    if not pdef.hasExactSolution():
        return None, words
    path = pdef.getSolutionPath()
    return [read(path.getState(i)) for i in range(path.getStateCount())], words


def _has_path(planner: Any) -> bool:
    """Return whether an improving planner has a path already (it hands it over at its end)."""
    return hasattr(planner, "bestCost") and math.isfinite(planner.bestCost().value())


def vertices(planner: Any, read: Callable[[Any], Any]) -> list[Any]:
    """Return the states of all vertices that a planner has made."""
    data = ob.PlannerData(planner.getSpaceInformation())
    planner.getPlannerData(data)
    return [read(data.getVertex(i).getState()) for i in range(data.numVertices())]


# ------------------ Legs in the plane


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
        least, _ = fastest(start[:3], goal[:3], limits_of(query.body.kinematics))
        drawn = trajectory is not None and trajectory.duration > least + 1e-6
    else:
        trajectory, corners = _glide(world, goal, nodes, seed)
        drawn = len(corners) > 2
    unsafe = f"OMPL's {planner} found a path, but none that is safe the way it has to be driven"
    reason = "" if trajectory is not None else unsafe
    return Leg(trajectory, reason, budget.used, not budget.cut, corners, drawn)


# ------------------ Planners by name, and what a search has reached


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
    seed: int = 0,
) -> tuple[bool, frozenset[str], frozenset[str]]:
    """Search from the first to the last pose of a query by an RRT; return whether the last one was
    reached, the names of the targets that were, and the obstacles that extensions ran into.

    The paper's reading of an RRT: a target counts as reached if the tree has a vertex from which it
    is one free edge away (the nearest ``NEAREST`` are tried); an obstacle is a blocker if
    an extension collided with it. A target that was not reached is *not* proven unreachable.
    """
    start, goal = query.poses[0], query.poses[-1]
    world = PlanarWorld(scene, query.body, (start,), query.obstacles)
    world.hits = set()
    if not world.fit_margin():
        return False, frozenset(), frozenset(world.hits)
    budget = WorkBudget(deadline)
    nodes, _, tree = search(world, start, goal, budget, planner="RRT", seed=seed, tree=True)
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
