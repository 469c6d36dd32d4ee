"""How a day is operated: budgets, thresholds, and how much is planned at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from up_samp.fleet.records import Weights
from up_samp.model import ProblemError


@dataclass(frozen=True)
class Settings:
    """How a day is operated. ``budget``: seconds that a plan may be sought for, and ``grace`` more
    until it has to be there. ``every``: seconds after which what is not begun is planned anew in
    any case; ``late``: by how many seconds everything may end later than forecast until then.
    ``soon``: orders are given to robots that are free within so many seconds; ``most``: so many
    orders of a robot are planned anew at a time. ``tick``: seconds between two steps.
    ``localisation``: how far (m) from the truth robots tell to be, and ``latency``: by how many
    seconds longer than another one a message may take to come, where the site file says nothing
    else of them; ``ahead``: for how many seconds farther than
    they can stand robots are let drive: so much is told of a plan, and stays. ``low``: robots
    charge that have less than this share of what a full battery has above its reserve.
    ``stretch``: in simulated time, where the planner's budget is what it computes (CPU s), it has
    so many times as much.
    """

    budget: float = 2.0
    grace: float = 2.0
    stretch: float = 1.0
    every: float = 20.0
    late: float = 20.0
    soon: float = 20.0
    most: int = 3
    tick: float = 0.2
    localisation: float = 0.05
    latency: float = 0.5
    ahead: float = 1.2
    low: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("budget", "grace", "tick", "localisation", "latency", "ahead"):
            if not 0.0 <= (value := getattr(self, name)) < math.inf:
                raise ProblemError(f"'{name}' cannot be {value:g}: at least 0")


DAY = Weights(tardiness=10.0, completion=1.0, driving=0.1)
"""What is best where a site file says only "makespan": a day has no end that counts."""
