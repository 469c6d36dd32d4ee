"""Bodies with equations of motion of their own, ``qdot = f(q, u)``: rolling out and shooting.

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

from up_samp.model import (
    Configuration,
    ControlLaw,
    ProblemError,
    Trajectory,
    UnsupportedError,
)
from up_samp.model.arrays import FloatArray, IntArray

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

    def step(q: FloatArray, u: FloatArray, h: float) -> FloatArray:
        a, b, c, d = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
        law(q, u, a)
        law(q + 0.5 * h * a, u, b)
        law(q + 0.5 * h * b, u, c)
        law(q + h * c, u, d)
        return q + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)

    step = wrap(step)

    def rows(q: FloatArray, u: FloatArray, seconds: float, count: int) -> FloatArray:
        out = np.empty((count + 1, 3))
        out[0] = q
        for i in range(count):
            out[i + 1] = step(out[i], u, seconds / count)
        return out

    def ends(
        q: FloatArray, controls: FloatArray, seconds: FloatArray, counts: IntArray
    ) -> FloatArray:
        out = np.empty((controls.shape[0], 3))
        for k in range(controls.shape[0]):
            state = q.copy()
            for p in range(controls.shape[1]):
                h = seconds[k, p] / counts[p]
                for _ in range(counts[p]):
                    state = step(state, controls[k, p], h)
            out[k] = state
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
