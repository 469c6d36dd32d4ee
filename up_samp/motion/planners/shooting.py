"""Shots under a law of motion: few pieces with constant controls that end exactly at a goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from up_samp.model import Configuration
from up_samp.model.arrays import FloatArray
from up_samp.motion.planners.control_law import ControlPiece, Roller, miss, steps_of, total

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

    def _step(self, z: FloatArray, off: FloatArray, slope: FloatArray) -> FloatArray:
        """Return the step of least norm that cancels the miss to first order, without the unknowns
        that it would push out of their bounds.
        """
        free = np.ones(len(z), dtype=np.bool_)
        step = np.zeros(len(z))
        for _ in range(4):
            part = np.where(free, slope, 0.0)
            normal = part @ part.T
            normal += (1e-12 * float(np.trace(normal)) + 1e-15) * np.eye(3)
            step = -part.T @ np.linalg.solve(normal, off)
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
            down = self._downhill(z, slope)
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

    def _downhill(self, z: FloatArray, slope: FloatArray) -> FloatArray:
        """Return minus the duration's gradient, projected on what keeps the end where it is."""
        free = np.ones(len(z), dtype=np.bool_)
        down = np.zeros(len(z))
        for _ in range(4):
            part, wish = np.where(free, slope, 0.0), np.where(free, -self._gradient, 0.0)
            normal = part @ part.T
            normal += (1e-9 * float(np.trace(normal)) + 1e-15) * np.eye(3)
            down = wish - part.T @ np.linalg.solve(normal, part @ wish)
            stuck = free & (((z <= 0.0) & (down < 0.0)) | ((z >= 1.0) & (down > 0.0)))
            if not stuck.any():
                break
            free &= ~stuck
        return np.asarray(down)

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
