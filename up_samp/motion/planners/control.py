"""Bodies with equations of motion of their own, ``qdot = f(q, u)``: rolling out, shooting, and
motions by OMPL's control planners with exact ends.

The state is (x, y, theta); controls are constant over *pieces* of time. A motion that ends exactly
where it must is found by single shooting: Gauss-Newton steps of least norm on the pieces' controls
and durations, within their bounds (Betts, *Practical Methods for Optimal Control*, 2010, ch. 3),
and made quicker by gradient projection with restoration (Rosen 1961).

A law must be a pure function. It is compiled with numba where numba can, and called as it is else:
the same formulas, only slower.
"""

from __future__ import annotations

import itertools
import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.core.errors import NumbaError

from up_samp.geometry import Scene
from up_samp.geometry.kernels import samples_free
from up_samp.model import (
    Configuration,
    ControlLaw,
    Deadline,
    ProblemError,
    Trajectory,
    UnsupportedError,
)
from up_samp.model.arrays import FloatArray, IntArray
from up_samp.motion.guides import OUT_OF_TIME, TOUCHES
from up_samp.motion.planners.ompl import (
    PlanarWorld,
    Validity,
    box_bounds,
    canonical,
    ob,
    oc,
    set_seed,
    solve,
    state_of,
)
from up_samp.motion.protocol import Leg, LegQuery, WorkBudget

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ControlPiece:
    """Controls held constant for ``seconds``."""

    controls: tuple[float, ...]
    seconds: float


def total(pieces: list[ControlPiece]) -> float:
    """Return the duration (s) of pieces one after the other."""
    return sum(p.seconds for p in pieces)


def steps_of(seconds: float) -> int:
    """Return into how many samples a piece is divided."""
    return max(1, math.ceil(seconds / Trajectory.MAX_STEP - 1e-9))


def miss(end: FloatArray, goal: Configuration) -> FloatArray:
    """Return how far (m, m, rad) states, shape (..., 3), are from a goal."""
    off = np.asarray(end) - np.array(goal[:3], dtype=np.float64)
    off[..., 2] = (off[..., 2] + math.pi) % (2 * math.pi) - math.pi
    return off


def _build(law: Any, wrap: Callable[[Any], Any]) -> tuple[Any, Any]:
    """Return the functions ``rows`` and ``ends`` for a law (classic Runge-Kutta, fourth order)."""

    # number by number: numba takes three times as long to compile sums of arrays
    def step(q: FloatArray, u: FloatArray, h: float, out: FloatArray) -> None:
        a, b, c, d, at = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
        law(q, u, a)
        for i in range(3):
            at[i] = q[i] + 0.5 * h * a[i]
        law(at, u, b)
        for i in range(3):
            at[i] = q[i] + 0.5 * h * b[i]
        law(at, u, c)
        at[0], at[1], at[2] = q[0] + h * c[0], q[1] + h * c[1], q[2] + h * c[2]
        law(at, u, d)
        for i in range(3):
            out[i] = q[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i])

    step = wrap(step)

    def rows(q: FloatArray, u: FloatArray, seconds: float, count: int) -> FloatArray:
        out = np.empty((count + 1, 3))
        out[0, 0], out[0, 1], out[0, 2] = q[0], q[1], q[2]
        for k in range(count):
            step(out[k], u, seconds / count, out[k + 1])
        return out

    def ends(
        q: FloatArray, controls: FloatArray, seconds: FloatArray, counts: IntArray
    ) -> FloatArray:
        out = np.empty((controls.shape[0], 3))
        for k in range(controls.shape[0]):
            out[k, 0], out[k, 1], out[k, 2] = q[0], q[1], q[2]
            for p in range(controls.shape[1]):
                h = seconds[k, p] / counts[p]
                for _ in range(counts[p]):
                    step(out[k], controls[k, p], h, out[k])
        return out

    return wrap(rows), wrap(ends)


@lru_cache(maxsize=32)
def _kernels(function: Callable[..., None], width: int) -> tuple[Any, Any]:
    """Return a law's kernels, compiled if numba can and the results agree."""
    plain = _build(function, lambda f: f)
    q, u = np.array([0.3, -0.2, 0.7]), np.full(width, 0.4)
    args = (q, np.tile(u, (1, 2, 1)), np.full((1, 2), 0.5), np.array([3, 2]))
    wanted = plain[1](*args)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            fast = _build(njit(function), njit)
            same = np.allclose(fast[1](*args), wanted, rtol=1e-9, atol=1e-12)
            fast[0](q, u, 0.5, 3)
    except (NumbaError, Warning, TypeError, NotImplementedError) as error:
        log.info("a control law is not compiled, only called: %s", str(error).split("\n")[0])
        return plain
    return fast if same else plain


@contextmanager
def calling(law: ControlLaw) -> Iterator[None]:
    """Name the object where its control model, which is a user's code, raises something."""
    try:
        yield
    except Exception as error:
        raise ProblemError(
            f"object '{law.owner}': its control_model raised {type(error).__name__}: {error}"
        ) from error


class Roller:
    """Integrates a control law. Raises ``UnsupportedError`` if it is not one of (x, y, theta)."""

    def __init__(self, law: ControlLaw) -> None:
        self.law = law
        self.low = np.array([low for _, low, _ in law.bounds], dtype=np.float64)
        self.high = np.array([high for _, _, high in law.bounds], dtype=np.float64)
        try:
            with calling(law):
                law.function(np.zeros(3), 0.5 * (self.low + self.high), np.zeros(3))
        except ProblemError as error:
            if not isinstance(error.__cause__, (IndexError, TypeError, ValueError)):
                raise
            raise UnsupportedError(
                f"object '{law.owner}': a control model must be a function(q, u, qdot) that "
                "fills qdot, with the state "
                f"(x, y, theta) and the controls {[name for name, _, _ in law.bounds]}: "
                f"{error.__cause__}"
            ) from error

    @cached_property
    def _compiled(self) -> tuple[Any, Any]:
        return _kernels(self.law.function, len(self.low))

    def ends(
        self, start: FloatArray, controls: FloatArray, seconds: FloatArray, counts: IntArray
    ) -> FloatArray:
        """Return the last states (k, 3) under k sets of p pieces: ``controls`` (k, p, m),
        ``seconds`` (k, p), each piece integrated in ``counts`` (p,) steps.
        """
        with calling(self.law):
            return np.asarray(self._compiled[1](start, controls, seconds, counts))

    def rows(self, start: npt.ArrayLike, controls: npt.ArrayLike, seconds: float) -> FloatArray:
        """Return the states (n + 1, 3) under constant controls, the start first."""
        q, u = np.asarray(start, dtype=np.float64), np.asarray(controls, dtype=np.float64)
        with calling(self.law):
            return np.asarray(self._compiled[0](q[:3], u, seconds, steps_of(seconds)))

    def speed(self) -> float:
        """Return the fastest speed (m/s) among the corners of the controls' bounds."""
        corners = itertools.islice(itertools.product(*zip(self.low, self.high, strict=True)), 256)
        best = 0.0
        for u, heading in itertools.product(corners, (0.0, 1.6, 3.1, 4.7)):
            rate = np.zeros(3)
            with calling(self.law):
                self.law.function(np.array([0.0, 0.0, heading]), np.array(u), rate)
            if not np.isfinite(rate).all():
                raise ProblemError(
                    f"object '{self.law.owner}': its control_model gives rates that are not finite"
                    f" ({', '.join(f'{r:g}' for r in rate)}) for controls {list(map(float, u))}"
                )
            best = max(best, float(np.hypot(rate[0], rate[1])))
        return best

    def trajectory(self, start: Configuration, pieces: list[ControlPiece]) -> Trajectory:
        """Return the motion under successive pieces, from time 0."""
        times = [np.zeros(1)]
        rows = [np.array([start[:3]], dtype=np.float64)]
        now = 0.0
        for piece in pieces:
            part = self.rows(rows[-1][-1], piece.controls, piece.seconds)
            rows.append(part[1:])
            times.append(now + piece.seconds * np.arange(1, len(part)) / (len(part) - 1))
            now += piece.seconds
        return Trajectory(np.concatenate(times), np.concatenate(rows))


# ------------------ Shots: few pieces with constant controls that end exactly at a goal


_SHORTEST = 0.02
"""s of a piece, at least."""
_COARSE = 8
"""Integration steps of a piece while shooting."""
_EXACT = 1e-8
"""m or rad from its goal at which a shot counts as having hit it."""


class Shot:
    """The problem of getting from ``start`` exactly to ``goal`` in ``count`` pieces.

    Unknowns are scaled to [0, 1]: each piece's controls between their bounds, and its duration
    between the shortest that is allowed and ``longest`` s.
    """

    def __init__(
        self,
        roller: Roller,
        start: Configuration,
        goal: Configuration,
        longest: float,
        count: int,
    ) -> None:
        self._roller = roller
        self._start = np.array(start[:3], dtype=np.float64)
        self._goal = goal
        self._width = len(roller.low) + 1
        self._low = np.tile(np.append(roller.low, _SHORTEST), count)
        high = np.tile(np.append(roller.high, max(longest, 2 * _SHORTEST)), count)
        self._range = high - self._low
        self.counts = np.full(count, _COARSE, dtype=np.int64)
        self._gradient = np.where(
            np.arange(len(high)) % self._width == self._width - 1, self._range, 0.0
        )

    def pack(self, pieces: list[ControlPiece]) -> FloatArray:
        """Return the unknowns of given pieces (moved into the bounds)."""
        values = np.concatenate([np.append(p.controls, p.seconds) for p in pieces])
        share = (values - self._low) / np.where(self._range > 0, self._range, 1.0)
        return np.asarray(share.clip(0.0, 1.0))

    def unpack(self, z: FloatArray) -> list[ControlPiece]:
        """Return the pieces that unknowns stand for."""
        values = (self._low + self._range * z).reshape(-1, self._width)
        return [ControlPiece(tuple(v[:-1].tolist()), float(v[-1])) for v in values]

    def seconds(self, z: FloatArray) -> float:
        """Return the duration (s) that unknowns stand for."""
        return float(self._gradient @ z) + _SHORTEST * len(self.counts)

    def _misses(self, batch: FloatArray) -> FloatArray:
        values = (self._low + self._range * batch).reshape(len(batch), -1, self._width)
        controls = np.ascontiguousarray(values[:, :, :-1])
        seconds = np.ascontiguousarray(values[:, :, -1])
        return miss(self._roller.ends(self._start, controls, seconds, self.counts), self._goal)

    def _slope(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the miss (3,) and its derivative (3, n) by differences into the bounds."""
        side = np.where(z < 0.5, 1e-7, -1e-7)
        found = self._misses(np.vstack((z, z + np.diag(side))))
        return found[0], ((found[1:] - found[0]) / side[:, None]).T

    def restore(self, z: FloatArray, rounds: int = 25) -> FloatArray | None:
        """Return unknowns near ``z`` that hit the goal, or None."""
        for _ in range(rounds):
            off, slope = self._slope(z)
            if np.abs(off).max() <= _EXACT:
                return z
            steps = z + np.array([1.0, 0.5, 0.2, 0.05])[:, None] * self._step(z, off, slope)
            trials = steps.clip(0.0, 1.0)
            sizes = np.linalg.norm(self._misses(trials), axis=1)
            best = int(sizes.argmin())
            if not sizes[best] < 0.999 * np.linalg.norm(off):
                return None
            z = trials[best]
        return z if np.abs(self._misses(z[None])[0]).max() <= _EXACT else None

    def _step(
        self, z: FloatArray, off: FloatArray, slope: FloatArray, down: float = 0.0
    ) -> FloatArray:
        """Return the step nearest to so many times minus the duration's gradient (``down``) that
        cancels the miss to first order, without the unknowns that it would push out of their
        bounds.
        """
        free = np.ones(len(z), dtype=np.bool_)
        step = np.zeros(len(z))
        for _ in range(4):
            part, wish = np.where(free, slope, 0.0), np.where(free, -down * self._gradient, 0.0)
            normal = part @ part.T
            normal += (1e-12 * float(np.trace(normal)) + 1e-15) * np.eye(3)
            step = wish - part.T @ np.linalg.solve(normal, part @ wish + off)
            stuck = free & (((z <= 0.0) & (step < 0.0)) | ((z >= 1.0) & (step > 0.0)))
            if not stuck.any():
                break
            free &= ~stuck
        return np.asarray(step)

    def quicken(self, z: FloatArray, accept: Callable[[FloatArray], bool]) -> FloatArray:
        """Return unknowns that hit the goal, not slower than ``z``; ``accept`` judges each step."""
        size = 0.3
        for _ in range(80):
            if size < 0.01:
                break
            _, slope = self._slope(z)
            down = self._step(z, np.zeros(3), slope, 1.0)
            length = float(np.linalg.norm(down))
            if length < 1e-9:
                break
            new = self.restore((z + size / length * down).clip(0.0, 1.0), 6)
            gain = self.seconds(z) - self.seconds(new) if new is not None else 0.0
            if new is not None and gain > 1e-4 and accept(new):
                z, size = new, 1.5 * size
            else:
                size *= 0.4
        return z

    def final(self, z: FloatArray) -> list[ControlPiece] | None:
        """Return the pieces, exact for the steps that their trajectory will have."""
        self.counts = np.array([steps_of(p.seconds) for p in self.unpack(z)], dtype=np.int64)
        exact = self.restore(z)
        self.counts = np.full(len(self.counts), _COARSE, dtype=np.int64)
        return None if exact is None else self.unpack(exact)


def shots(
    shot: Shot,
    guesses: list[list[ControlPiece]],
    free: Callable[[list[ControlPiece]], bool],
    stop: Callable[[], bool],
) -> list[ControlPiece] | None:
    """Return the quickest free way that grows out of the guesses (the three quickest hits are
    improved), or None.
    """
    hits = sorted(_hits(shot, guesses, free, stop), key=shot.seconds)
    found: list[ControlPiece] | None = None
    for z in hits[:3]:
        better = shot.quicken(z, lambda x: not stop() and free(shot.unpack(x)))
        for candidate in (better, z):
            pieces = shot.final(candidate)
            if pieces is not None and free(pieces):
                if found is None or total(pieces) < total(found):
                    found = pieces
                break
    return found


def _hits(
    shot: Shot,
    guesses: list[list[ControlPiece]],
    free: Callable[[list[ControlPiece]], bool],
    stop: Callable[[], bool],
) -> Iterator[FloatArray]:
    for guess in guesses:
        if stop():
            return
        z = shot.restore(shot.pack(guess))
        if z is not None and free(shot.unpack(z)):
            yield z


# ------------------ Motions by OMPL's control planners
# A sampling planner only comes near its goal. Here it need not come nearer than a body length: the
# last piece of the way is then solved for exactly, and the whole way is shortened by shooting
# between its nodes. Where that fails the answer is "out of time".


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
        return bool(samples_free(self.data, poses, least) < 0)

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
    return Leg(trajectory, reason, budget.used, not budget.cut, drawn=True)
