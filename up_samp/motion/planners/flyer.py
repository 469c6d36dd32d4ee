"""Free flyers (SE3): bodies with meshes that move and turn in any direction in space.

OMPL searches; edges (straight with a slerp of the orientation) are checked by conservative
advancement (Mirtich 1996) with coal's distances, so nothing slips through between two checks. The
world: other bodies with meshes; bodies that move in the plane, up to their height where they have
one; a map's blocked cells and everything outside the map, which reach from the floor to the sky.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence
from typing import Any

import numpy as np

from up_samp.geometry import Scene
from up_samp.geometry.meshes import (
    Mesh,
    mesh_of,
    nested,
    prism,
    surface_distance,
    transform,
    wall_rectangles,
)
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Placed,
    ProblemError,
    interpolate,
)
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.trapezoid import leg_profile, timed_chain, turn_between
from up_samp.motion.guides import MARGIN_SHARES, TOUCHES
from up_samp.motion.planners.ompl import (
    EdgeValidity,
    Validity,
    box_bounds,
    canonical,
    ob,
    og,
    set_seed,
    solve,
)
from up_samp.motion.protocol import Leg, LegQuery, WorkBudget

TOUCH = 1e-4
"""Clearance (m) that counts as none (and the shortest step of the edge checks)."""


class FlyerWorld:
    """One flyer among resting bodies and the walls of a map."""

    def __init__(
        self,
        scene: Scene,
        body: Body,
        poses: Sequence[Configuration],
        obstacles: tuple[Placed, ...],
    ) -> None:
        if not body.flies:
            raise ProblemError(f"not a free flyer: {body.kinematics.model.value}")
        self.body, self.obstacles = body, obstacles
        self.margin = scene.margin
        self._ends = tuple(poses)
        self.mesh, _ = mesh_of(body, poses[0], 0.0, 0.0)
        self._scene = scene
        self.low, self.high = self._box(poses)
        floor, sky = self.low[2] - 2 * self.mesh.radius, self.high[2] + 2 * self.mesh.radius
        self.things: list[tuple[Mesh, Any, Configuration]] = []
        self._walls = -1
        for placed in obstacles:
            mesh, pose = mesh_of(placed.body, placed.pose, floor, sky)
            self.things.append((mesh, transform(pose), pose))
        if scene.grid is not None:
            rest = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
            self._walls = len(self.things)
            walls = prism(wall_rectangles(scene.grid), floor, sky)
            self.things.append((walls, transform(rest), rest))
        self._centres = np.array([rest[:3] for *_, rest in self.things]).reshape(-1, 3)
        self._reaches = np.array([m.radius + self.mesh.radius for m, _, _ in self.things])

    def _box(self, poses: Sequence[Configuration]) -> tuple[FloatArray, FloatArray]:
        """Return the corners (m) of the box that is searched: the map's, and as high as it takes
        to fly over and under everything.
        """
        points = [np.array(p[:3]) for p in poses]
        for placed in self.obstacles:
            if placed.body.flies:
                mesh, pose = mesh_of(placed.body, placed.pose, 0.0, 0.0)
                centre = np.array(pose[:3])
                points += [centre - mesh.radius, centre + mesh.radius]
            else:
                top = placed.body.height
                heights = [top] if math.isfinite(top) else [p[2] for p in poses]
                points += [np.array([*placed.pose[:2], z]) for z in heights]
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        reach = 3 * self.mesh.radius
        low, high = low - reach, high + reach
        if self._scene.grid is not None:
            low[:2], high[:2] = self._scene.grid.box
        return low, high

    def clearance(self, pose: Sequence[float]) -> float:
        """Return a lower bound on the distance (m) of the surfaces to the nearest thing beyond the
        margin: exact where that is near, by spheres where it is far; -1 where it is none.
        """
        place, point = transform(pose), np.array(pose[:3])
        far = np.linalg.norm(self._centres - point, axis=1) - self._reaches
        if self._walls >= 0:
            far[self._walls] = self._scene.room(point[0], point[1]) - self.mesh.radius
        near = far < 0.5 * self.mesh.radius + self.margin
        best = float(np.min(far[~near], initial=math.inf)) - self.margin
        for i in np.flatnonzero(near):
            if far[i] - self.margin >= best:
                continue
            mesh, where, _ = self.things[i]
            d = surface_distance(self.mesh, place, mesh, where) - self.margin
            if d <= TOUCH:
                return -1.0
            best = min(best, d)
        return best

    def pose_free(self, pose: Sequence[float]) -> bool:
        """Return whether the surfaces keep the margin at a pose."""
        return self.clearance(pose) > 0.0

    def swallowed(self, pose: Configuration) -> bool:
        """Return whether the body lies inside a thing, or a thing inside it, without contact."""
        return any(nested(self.mesh, pose, mesh, rest) for mesh, _, rest in self.things)

    def edge_free(self, a: FloatArray, b: FloatArray) -> bool:
        """Return whether the margin is kept all along the edge between two poses."""
        if not self.pose_free(b.tolist()):
            return False
        turn = turn_between(a, b)
        travel = float(np.linalg.norm(b[:3] - a[:3])) + turn * self.mesh.radius
        share = 0.0
        while share < 1.0:
            c = self.clearance(interpolate(a, b, share))
            if c < 0.0:
                return False
            if c >= travel:
                return True
            share += c / travel
        return True

    def fit_margin(self) -> bool:
        """Take the largest margin that both ends can keep; False if they keep none."""
        for share in MARGIN_SHARES:
            self.margin = self._scene.margin * share
            if all(self.pose_free(p) for p in self._ends):
                return True
        return False


def _read(state: Any) -> tuple[float, ...]:
    r = state.rotation()
    return state.getX(), state.getY(), state.getZ(), r.x, r.y, r.z, r.w


def _state(si: Any, pose: Configuration) -> Any:
    state = si.allocState()
    state.setXYZ(float(pose[0]), float(pose[1]), float(pose[2]))
    r = state.rotation()
    size = math.sqrt(sum(v * v for v in pose[3:]))
    r.x, r.y, r.z, r.w = (float(v) / size for v in pose[3:])
    return state


def flyer_leg(scene: Scene, query: LegQuery, deadline: Deadline, *, planner: str, seed: int) -> Leg:
    """Return a free flyer's motion from rest at the start to rest at the goal.

    Straight pieces with rest at each corner; ``v_max``, ``a_max`` and ``omega_max`` hold.
    Deterministic for ``seed`` unless the deadline cuts in.
    """
    body, start, goal = query.body, query.start, query.goal
    world = FlyerWorld(scene, body, (start, goal), query.obstacles)
    if not world.fit_margin() or any(world.swallowed(p) for p in (start, goal)):
        return Leg(None, TOUCHES, complete=True)
    name, budget = canonical(planner), WorkBudget(deadline)
    space = ob.SE3StateSpace()
    space.setBounds(box_bounds(world.low.tolist(), world.high.tolist()))
    si = ob.SpaceInformation(space)
    si.setStateValidityChecker(Validity(si, lambda s: world.pose_free(_read(s))))
    si.setMotionValidator(
        EdgeValidity(
            si, lambda a, b: world.edge_free(np.array(_read(a)), np.array(_read(b))), budget
        )
    )
    si.setup()
    pdef = ob.ProblemDefinition(si)
    pdef.setStartAndGoalStates(_state(si, start), _state(si, goal), 1e-9)
    set_seed(seed)
    states, status = solve(getattr(og, name)(si), pdef, budget, polish=200, read=_read)
    if states is None:
        reason = f"OMPL's {name} found no path ({status.lower()})"
        return Leg(None, reason, budget.used, not budget.cut)
    nodes = np.array([start, *states[1:-1], goal], dtype=np.float64)
    nodes = shorten(world, nodes, budget, seed)
    motion = timed_chain(nodes, body.kinematics)
    return Leg(motion, "", budget.used, not budget.cut, drawn=len(nodes) > 2)


def shorten(world: FlyerWorld, nodes: FloatArray, budget: WorkBudget, seed: int) -> FloatArray:
    """Return a chain that is not slower, by random shortcuts (Geraerts & Overmars 2007): 300, or 80
    in a row that gain nothing.
    """
    rng = random.Random(seed)
    idle = 0
    for _ in range(300):
        if len(nodes) < 3 or idle > 80 or budget.spent():
            break
        idle += 1
        p, q = sorted((rng.uniform(0, len(nodes) - 1), rng.uniform(0, len(nodes) - 1)))
        if rng.random() < 0.5:
            p, q = float(round(p)), float(round(q))
        i, j = math.ceil(p), math.floor(q)
        if i > j:
            continue
        one, two = _point(nodes, p), _point(nodes, q)
        new = np.concatenate([nodes[:i], [one], [two], nodes[j + 1 :]])
        keep = [0, *(k for k in range(1, len(new)) if _apart(new[k - 1], new[k]))]
        new = new[keep]
        faster = _seconds(new, world) < _seconds(nodes, world) - 1e-4
        if faster and world.edge_free(one, two):
            nodes, idle = new, 0
    return nodes


def _point(nodes: FloatArray, position: float) -> FloatArray:
    i = min(int(position), len(nodes) - 2)
    if position == i:
        return np.asarray(nodes[i])
    if position == i + 1:
        return np.asarray(nodes[i + 1])
    return np.array(interpolate(nodes[i], nodes[i + 1], position - i))


def _apart(a: FloatArray, b: FloatArray) -> bool:
    return float(np.abs(a[:3] - b[:3]).max()) > 1e-9 or turn_between(a, b) > 1e-9


def _seconds(nodes: FloatArray, world: FlyerWorld) -> float:
    limits = world.body.kinematics
    return sum(leg_profile(a, b, limits)[0] for a, b in itertools.pairwise(nodes))
