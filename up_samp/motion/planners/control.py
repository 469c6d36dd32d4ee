"""Free-form control models by OMPL's control planners, and exact ends by shooting.

A sampling planner only comes near its goal. Here it need not come nearer than a body length: the
last piece of the way is then solved for exactly (:mod:`.control_law`), and the whole way is
shortened by shooting between its nodes. Where that fails the answer is "out of time".
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from up_samp.geometry import Scene, sweeps
from up_samp.model import Configuration, Deadline, ProblemError, Trajectory
from up_samp.model.arrays import FloatArray
from up_samp.motion.budget import WorkBudget
from up_samp.motion.guides.search_space import OUT_OF_TIME, TOUCHES
from up_samp.motion.planners.control_law import ControlPiece, Roller, miss, total
from up_samp.motion.planners.ompl_planar import PlanarWorld, state_of
from up_samp.motion.planners.ompl_solve import (
    Validity,
    box_bounds,
    canonical,
    ob,
    oc,
    set_seed,
    solve,
)
from up_samp.motion.planners.shooting import Shot, shots
from up_samp.motion.protocol import Leg, LegQuery

_PIECES = 5
"""Of a shot, each with constant controls."""


class ControlWorld(PlanarWorld):
    """A body with its own law of motion among resting obstacles, and what it is asked."""

    def __init__(self, scene: Scene, query: LegQuery, budget: WorkBudget, seed: int) -> None:
        self.start, self.goal, self.budget = query.start, query.goal, budget
        super().__init__(scene, query.body, (query.start, query.goal), query.obstacles)
        law = query.body.kinematics.control
        if law is None:
            raise ProblemError("the motion model CONTROL needs a control model")
        self.roller = Roller(law)
        self.speed = self.roller.speed()
        if not (self.speed > 0 and math.isfinite(self.speed)):
            raise ProblemError("a control model that never moves cannot drive anywhere")
        self.rng = np.random.default_rng(seed)
        size = self.shape.circumscribed
        self.step = float(np.clip(0.25 * size / self.speed, 0.05, 0.5))
        self.near = max(0.5, size)

    def clear(self, poses: FloatArray) -> bool:
        """Return whether the swept motion through ``poses`` (n, 3) keeps the margin."""
        least = 0.1 * float(self.data.shape.slack[2])
        return bool(sweeps.samples_free(self.data, poses, least) < 0)

    def guesses(self, a: Configuration, b: Configuration, count: int) -> list[list[ControlPiece]]:
        """Return random pieces of about the right total duration."""
        low, high = self.roller.low, self.roller.high
        way = math.dist(a[:2], b[:2]) + self.near
        found, many = [], _PIECES
        for _ in range(count):
            seconds = way / self.speed * float(self.rng.uniform(0.8, 2.5)) / many
            draws = low + (high - low) * self.rng.random((many, len(low)))
            found.append([ControlPiece(tuple(u.tolist()), seconds) for u in draws])
        return found

    def steer(self, a: Configuration, b: Configuration, count: int) -> list[ControlPiece] | None:
        """Return the quickest free shot from ``a`` to ``b`` out of ``count`` random guesses."""

        def free(pieces: list[ControlPiece]) -> bool:
            return self.clear(self.roller.trajectory(a, pieces).poses)

        guesses = self.guesses(a, b, count)
        longest = 1.5 * max(p.seconds for guess in guesses for p in guess)
        shot = Shot(self.roller, a, b, longest, _PIECES)
        return shots(shot, guesses, free, self.budget.spent)

    def search(self, name: str, seed: int) -> tuple[list[ControlPiece] | None, str]:
        """Return pieces that lead from the start to somewhere near the goal, by one of OMPL's
        control planners, or None and why.
        """
        low, high = self.box()
        roller, width = self.roller, len(self.roller.low)
        space = ob.SE2StateSpace()
        space.setBounds(box_bounds(low.tolist(), high.tolist()))
        controls = oc.RealVectorControlSpace(space, width)
        controls.setBounds(box_bounds(roller.low.tolist(), roller.high.tolist()))
        si = oc.SpaceInformation(space, controls)

        def propagate(state: Any, control: Any, seconds: float, result: Any) -> None:
            self.budget.used += 1
            origin = (state.getX(), state.getY(), state.getYaw())
            rows = roller.rows(origin, [control[i] for i in range(width)], seconds)
            x, y, th = rows[-1].tolist()
            if not self.clear(rows):
                x = float(high[0]) + 1e3  # out of the box: invalid
            result.setX(x)
            result.setY(y)
            result.setYaw((th + math.pi) % (2 * math.pi) - math.pi)

        (left, lower), (right, upper) = low.tolist()[:2], high.tolist()[:2]

        def inside(state: Any) -> bool:  # steps that collide are thrown out of the box
            return bool(left <= state.getX() <= right and lower <= state.getY() <= upper)

        si.setStateValidityChecker(Validity(si, inside))
        si.setStatePropagator(propagate)
        si.setPropagationStepSize(self.step)
        si.setMinMaxControlDuration(1, 12)
        si.setup()
        pdef = ob.ProblemDefinition(si)
        pdef.setStartAndGoalStates(state_of(si, self.start), state_of(si, self.goal), self.near)
        set_seed(seed)
        states, status = solve(getattr(oc, name)(si), pdef, self.budget, polish=1)
        if states is None:
            return None, f"OMPL's control planner {name} found no path ({status.lower()})"
        path = pdef.getSolutionPath()
        count = range(path.getControlCount())
        driven = [(path.getControl(i), float(path.getControlDuration(i))) for i in count]
        return [ControlPiece(tuple(c[k] for k in range(width)), t) for c, t in driven], ""

    def nodes(self, pieces: list[ControlPiece]) -> list[Configuration]:
        """Return the states between pieces, from the start to the end."""
        nodes = [self.start]
        for piece in pieces:
            end = self.roller.rows(nodes[-1], piece.controls, piece.seconds)[-1]
            nodes.append(tuple(end.tolist()))
        return nodes

    def arrive(self, pieces: list[ControlPiece]) -> list[ControlPiece] | None:
        """Return the pieces with an end that leads exactly to the goal, from one of the last
        nodes.
        """
        nodes = self.nodes(pieces)
        for back in (2, 1, 4, 0, 7, 11):
            i = len(pieces) - back
            if i < 0 or self.budget.spent():
                continue
            end = self.steer(nodes[i], self.goal, 12)
            if end is not None:
                return pieces[:i] + end
        return None

    def shortened(self, pieces: list[ControlPiece]) -> list[ControlPiece]:
        """Return a way that is not slower, by shots between random nodes of it."""
        for attempt in range(40):
            nodes = [*self.nodes(pieces)[:-1], self.goal]
            if len(nodes) < 3 or self.budget.spent():
                break
            i, j = sorted(self.rng.choice(len(nodes), 2, replace=False).tolist())
            if attempt % 4 == 0:
                i, j = (0, j) if attempt % 8 == 0 else (i, len(nodes) - 1)
            old = total(pieces[i:j])
            if j - i < 2 or old < math.dist(nodes[i][:2], nodes[j][:2]) / self.speed * 1.02:
                continue
            new = self.steer(nodes[i], nodes[j], 6)
            if new is None or total(new) >= old - 1e-3:
                continue
            candidate = [*pieces[:i], *new, *pieces[j:]]
            if self.exact(candidate) is not None:
                pieces = candidate
        return pieces

    def exact(self, pieces: list[ControlPiece]) -> Trajectory | None:
        """Return the timed motion with the goal as its last sample; None if it misses or
        collides.
        """
        found = self.roller.trajectory(self.start, pieces)
        off = miss(found.poses[-1], self.goal)
        if np.abs(off).max() > 1e-5:
            return None
        poses = found.poses.copy()
        poses[-1] = (self.goal[0], self.goal[1], poses[-1, 2] - off[2])
        return Trajectory(found.times.copy(), poses) if self.clear(poses) else None


def control_leg(
    scene: Scene, query: LegQuery, deadline: Deadline, *, planner: str, seed: int
) -> Leg:
    """Return a motion under the body's control law from the start exactly to the goal.

    Deterministic for ``seed`` unless the deadline cuts in.
    """
    body, start, goal = query.body, query.start, query.goal
    if not body.mobility.own_law:
        raise ProblemError(f"no control model: {body.kinematics.model.value}")
    name, budget = canonical(planner, control=True), WorkBudget(deadline)
    world = ControlWorld(scene, query, budget, seed)
    if not world.fit_margin():
        return Leg(None, TOUCHES, complete=True)
    direct = world.steer(start, goal, 24)  # before anything is searched
    pieces: list[ControlPiece] | None = direct
    reason, attempt = OUT_OF_TIME, 0
    while pieces is None and not budget.spent():
        rough, reason = world.search(name, seed + attempt)
        attempt += 1
        if rough is not None:
            reason = "the last stretch to the goal could not be driven exactly"
            pieces = world.arrive(rough)
    if pieces is None:
        return Leg(None, reason, budget.used)
    if direct is None:
        pieces = world.shortened(pieces)
    trajectory = world.exact(pieces)
    reason = "" if trajectory is not None else "the motion found does not end at the goal"
    return Leg(trajectory, reason, budget.used, not budget.cut)
