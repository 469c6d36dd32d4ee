"""A simulated robot on its path: bounded speed and acceleration, always able to stop in time.

What it tells of where it is may be wrong, and so may be what it drives by.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence

from up_samp.execution.delays import Senses
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import Travel


class Robot:
    """One motion after the other. ``trace`` holds (time, progress) of the motion under way."""

    def __init__(
        self,
        name: str,
        pace: float,
        stops: Sequence[tuple[float, float]],
        halt: tuple[float, float] | None,
        senses: Senses | None = None,
    ):
        self.name, self.pace = name, pace
        self.senses = senses or Senses()
        self._noise = random.Random(self.senses.seed)
        self.stops = deque(stops)
        self.halt = halt
        self.driven = 0.0
        """Seconds of driving so far, without stops."""
        self.held_until = -math.inf
        self.overruns = 0
        self.motion: str | None = None
        self.trace: list[tuple[float, float]] = []
        self.s = self.v = self.until = 0.0
        """True progress (m), speed (m/s), and how far it has been told that it may go (m)."""
        self.wrong = 0.0
        """Told minus true progress (m)."""
        self.hold = False
        """Whether it has been told to stay where it is."""
        self.known: deque[tuple[float, float]] = deque()
        """(time, progress) that is still to be told."""

    def begin(self, motion: str, travel: Travel, now: float) -> None:
        """Take up a motion, at rest."""
        self.motion, self.travel = motion, travel
        self.s = self.v = self.until = 0.0
        self.length = travel.length
        self.next_stop = 0
        self.trace = [(now, 0.0)]
        self.known.clear()
        self._look()

    def _look(self) -> None:
        spread = self.senses.noise
        self.wrong = self.senses.bias + (self._noise.uniform(-spread, spread) if spread else 0.0)

    @property
    def believed(self) -> float:
        """Progress (m) by which it drives."""
        return self.s if self.senses.tracked else self.s + self.wrong

    def told(self, now: float) -> float | None:
        """Return the progress (m) that it tells at ``now`` (``None``: nothing yet)."""
        self.known.append((now, self.s + self.wrong))
        found = None
        while self.known and self.known[0][0] <= now - self.senses.lag + 1e-9:
            found = self.known.popleft()[1]
        return found

    @property
    def arrived(self) -> bool:
        """Whether it takes itself to be at the end of its motion, or has come to it, and stands."""
        at_end = max(self.believed, self.s) >= self.length - TOLERANCES.step
        return self.v == 0.0 and self.until >= self.length - TOLERANCES.step and at_end

    def step(self, now: float, dt: float, ceiling: float = math.inf) -> None:
        """Drive for ``dt`` s from ``now`` on: not beyond ``until`` (m, as it believes), where it
        can stop, and not beyond ``ceiling`` (m) at the step's end, as far as its brakes allow.
        """
        a = self.travel.accel
        self._disturb(now)
        stops = self.travel.stops
        while self.next_stop < len(stops) - 1 and self.s >= stops[self.next_stop] - 1e-9:
            self.next_stop += 1
        until = self.until if self.senses.tracked else self.until - self.wrong
        goal = min(max(until, self.s), stops[self.next_stop], self.length)
        left = goal - self.s
        if now < self.held_until or self.hold:
            wish = 0.0
        elif left <= TOLERANCES.step and self.v <= 2 * TOLERANCES.step / dt:
            # the last bit in one go
            self.s, self.v = max(self.s, goal), 0.0
            self._note(now + dt)
            self._look()
            return
        else:
            wish = self.pace * self.travel.cap_at(self.s)
            wish = min(wish, 2 * (ceiling - self.s) / dt - self.v)
        # the largest speed at the step's end from which it stops before the goal:
        # (v + w) dt / 2 + w^2 / (2 a) = left
        room = left - 0.5 * self.v * dt
        brake = -0.5 * a * dt + math.sqrt(max(0.0, 0.25 * a * a * dt * dt + 2 * a * room))
        hard = self.v - a * dt
        if brake < hard - 1e-6 and self.v > 1e-9 and not self.hold and not self.senses.noise:
            self.overruns += 1
        w = max(0.0, hard, min(wish, brake, self.v + a * dt))
        went = 0.5 * (self.v + w) * dt
        if w == 0.0 and hard < 0.0:
            went = min(went, self.v * self.v / (2 * a) if wish <= 0.0 else went)
        self.driven += dt if now >= self.held_until else 0.0
        self.s = min(self.s + max(0.0, went), max(goal, self.s))
        self.v = w
        self._note(now + dt)
        self._look()

    def _disturb(self, now: float) -> None:
        while self.stops and self.driven >= self.stops[0][0]:
            self.held_until = max(self.held_until, now + self.stops.popleft()[1])
        if self.halt is not None and now >= self.halt[0]:
            self.held_until = max(self.held_until, now + self.halt[1])
            self.halt = None

    def _note(self, now: float) -> None:
        last = self.trace[-1]
        if len(self.trace) >= 2 and self.trace[-2][1] == last[1] == self.s:
            self.trace[-1] = (now, self.s)  # it still stands
        else:
            self.trace.append((now, self.s))
