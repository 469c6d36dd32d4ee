"""How the floor departs from the plan: slow robots, stops, longer tasks, wrong reports."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from up_samp.model import ProblemError


@dataclass(frozen=True)
class Delays:
    """Delays as the field's benchmarks draw them.

    ``slow``: each robot drives at a share of its speed drawn from [1 - slow, 1].
    ``stops``: random stops, on average so many for a minute of driving, each of a length drawn
    from an exponential distribution with mean ``stop_seconds``.
    ``long_stop``: one robot stops once for so many seconds, at a random time.
    ``late``: tasks that drive nothing take up to this share longer.

    What robots tell is wrong, too: by a constant of up to ``bias`` m (each robot's own, either
    sign), by up to ``noise`` m more that is drawn anew for each report, and it is told ``lag`` s
    late. Some drive by what they tell, some better than that (others tell where they are).
    """

    slow: float = 0.0
    stops: float = 0.0
    stop_seconds: float = 5.0
    long_stop: float = 0.0
    late: float = 0.0
    bias: float = 0.0
    noise: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.slow < 1.0:
            raise ProblemError(f"delays: 'slow' must be at least 0 and below 1, not {self.slow}")
        for name in ("stops", "stop_seconds", "long_stop", "late", "bias", "noise", "lag"):
            if getattr(self, name) < 0.0:
                raise ProblemError(f"delays: '{name}' must not be negative")

    @staticmethod
    def of_share(share: float) -> Delays:
        """Return delays of all kinds that grow with ``share`` (0.3: delays of 30 %)."""
        return Delays(slow=share, stops=2.0 * share, stop_seconds=5.0, late=share)

    @staticmethod
    def parse(text: str) -> Delays:
        """Read ``30%`` or ``slow=0.3,stops=1,stop_seconds=5,long_stop=20,late=0.5``."""
        delays = Delays()
        for part in filter(None, (p.strip() for p in text.split(","))):
            key, equals, value = part.partition("=")
            try:
                if not equals and key.endswith("%"):
                    delays = Delays.of_share(float(key[:-1]) / 100)
                elif equals and key in Delays.__dataclass_fields__:
                    delays = replace(delays, **{key: float(value)})
                else:
                    raise ValueError(part)
            except ValueError as error:
                known = ", ".join(Delays.__dataclass_fields__)
                raise ProblemError(
                    f"delays '{part}': write a share such as 30%, or NAME=NUMBER of {known}"
                ) from error
        return delays


@dataclass(frozen=True)
class Senses:
    """How wrong reports are: ``bias`` (m, told minus true progress), ``noise`` (m, drawn from
    [-noise, noise] by a generator of ``seed``) and ``lag`` (s). A ``tracked`` robot drives by the
    truth, and others tell where it is; a ``silent`` one does not say that it has come to its end.
    """

    bias: float = 0.0
    noise: float = 0.0
    lag: float = 0.0
    tracked: bool = False
    silent: bool = False
    seed: str = ""


@dataclass(frozen=True)
class Luck:
    """One draw: what will go wrong, by robot and by task, the same for every way of execution.

    ``pace`` (share of the speed), ``stops`` (lists of (after so many seconds of driving, length)),
    ``halt`` (robot, time, length), ``longer`` (factor on a task's duration) and ``senses``.
    """

    pace: Mapping[str, float] = field(default_factory=dict)
    stops: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    halt: tuple[str, float, float] | None = None
    longer: Mapping[str, float] = field(default_factory=dict)
    senses: Mapping[str, Senses] = field(default_factory=dict)


def draw(
    delays: Delays, robots: Iterable[str], tasks: Iterable[str], makespan: float, seed: int
) -> Luck:
    """Draw one run's delays. Every robot and task has a generator of its own."""
    names = sorted(robots)
    pace, stops = {}, {}
    for name in names:
        rng = random.Random(f"robot {name} {seed}")
        pace[name] = 1.0 - delays.slow * rng.random()
        stops[name] = tuple(_stops(delays, rng, 4 * makespan))
    longer = {
        name: 1.0 + delays.late * random.Random(f"task {name} {seed}").random() for name in tasks
    }
    halt = None
    if delays.long_stop > 0.0 and names:
        rng = random.Random(f"halt {seed}")
        halt = (rng.choice(names), rng.uniform(0.05, 0.6) * makespan, delays.long_stop)
    senses = {name: _senses(delays, name, seed) for name in names}
    return Luck(pace, stops, halt, longer, senses)


def _senses(delays: Delays, name: str, seed: int) -> Senses:
    rng = random.Random(f"senses {name} {seed}")
    bias = rng.choice((-1.0, 1.0)) * delays.bias * rng.choice((1.0, 1.0, rng.random()))
    tracked, silent = rng.random() < 0.5, rng.random() < 0.5
    return Senses(bias, delays.noise, delays.lag, tracked, silent, f"noise {name} {seed}")


def _stops(delays: Delays, rng: random.Random, horizon: float) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    if delays.stops <= 0.0 or delays.stop_seconds <= 0.0:
        return found
    at = rng.expovariate(delays.stops / 60.0)
    while at < horizon:
        found.append((at, rng.expovariate(1.0 / delays.stop_seconds)))
        at += rng.expovariate(delays.stops / 60.0)
    return found
