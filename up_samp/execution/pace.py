"""How fast robots really are, as a share of what their limits allow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from up_samp.execution.state import Way
from up_samp.model.execution_tuning import RobotPaceTuning


class Pace(Mapping[str, float]):
    """Each robot's pace, from what it told while nothing held it up (1: as fast as allowed)."""

    def __init__(self, tuning: RobotPaceTuning | None = None) -> None:
        self._tuning = tuning or RobotPaceTuning()
        self._driven: dict[str, float] = {}
        self._needed: dict[str, float] = {}
        self._speed: dict[str, float] = {}
        self._last: dict[str, tuple[str, float, float]] = {}

    def told(self, way: Way, progress: float, now: float, until: float) -> None:
        """Take in where a robot is. What it drives on its way to a closed gate does not count."""
        name = way.object
        before = self._last.get(name)
        self._last[name] = (way.activity, progress, now)
        if before is None or before[0] != way.activity or now <= before[2]:
            return
        speed = (progress - before[1]) / (now - before[2])
        rising = speed > 1.02 * self._speed.get(name, 0.0)
        self._speed[name] = speed
        if rising or speed < 1e-3:
            return  # a stop, and getting going again, say nothing of how fast it drives
        brake = way.travel.speed_at(progress) ** 2 / (2 * way.travel.accel)
        if until < way.length and progress + 1.5 * brake + 0.5 >= until:
            return
        ideal = way.travel.time_at(progress) - way.travel.time_at(before[1])
        seconds = now - before[2]
        memory = self._tuning.memory
        fade = max(0.0, 1.0 - seconds / memory)
        self._driven[name] = fade * self._driven.get(name, memory / 4) + ideal
        self._needed[name] = fade * self._needed.get(name, memory / 4) + seconds

    def saved(self) -> dict[str, Any]:
        """Return all that it knows, as JSON would hold it."""
        last = {name: list(told) for name, told in self._last.items()}
        known = {"driven": self._driven, "needed": self._needed, "speed": self._speed}
        return {**{k: dict(v) for k, v in known.items()}, "last": last}

    def load(self, known: Mapping[str, Any]) -> None:
        """Take over what another one knew."""
        self._driven, self._needed = dict(known["driven"]), dict(known["needed"])
        self._speed = dict(known["speed"])
        self._last = {n: (str(a), float(p), float(t)) for n, (a, p, t) in known["last"].items()}

    def __getitem__(self, name: str) -> float:
        if name not in self._driven:
            raise KeyError(name)
        return min(1.0, max(self._tuning.least, self._driven[name] / self._needed[name]))

    def __iter__(self) -> Iterator[str]:
        return iter(self._driven)

    def __len__(self) -> int:
        return len(self._driven)
