"""What happened in a search: rounds, refinements, times, bounds (exported as CSV and JSON), and
what each of its stages took.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from up_samp.model.refinement import Layer, Refinement
from up_samp.search.budget import Budget
from up_samp.system.files import write_whole
from up_samp.system.memory import peak_memory
from up_samp.upio.objective import shown

READING, STATING, SCHEDULING = "reading", "stating", "scheduling"
BUILDING = "building"
CHECKING, REPAIRING, LEARNING, VALIDATING = "checking", "repairing", "learning", "validating"
STAGES = (READING, STATING, SCHEDULING, BUILDING, CHECKING, REPAIRING, LEARNING, VALIDATING)
"""What every search does."""
TOLD = {
    READING: "reading the problem",
    STATING: "what holds before the first schedule",
    BUILDING: "sharing out the work",
    CHECKING: "motions",
    REPAIRING: "motions of schedules that were mended",
}
"""What a user calls the stages; the others are called what they are."""


@dataclass
class Stages:
    """By stage, in all its turns together: ``seconds`` of wall clock, ``cpu`` seconds of this
    process (all its threads), and ``peak``: the most memory (MiB) that the process had held by the
    end of its last turn (empty where the system does not tell).
    """

    seconds: dict[str, float] = field(default_factory=dict)
    cpu: dict[str, float] = field(default_factory=dict)
    peak: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Count what is done meanwhile for a stage."""
        began, worked = time.monotonic(), time.process_time()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.monotonic() - began
            self.cpu[stage] = self.cpu.get(stage, 0.0) + time.process_time() - worked
            held = peak_memory()
            if held is not None:
                self.peak[stage] = held

    def metrics(self) -> dict[str, str]:
        """Return everything as a result's metrics: ``seconds_validating``, ``mib_checking``, ..."""
        found = {f"seconds_{s}": f"{v:.3f}" for s, v in self.seconds.items()}
        found |= {f"cpu_{s}": f"{v:.3f}" for s, v in self.cpu.items()}
        return found | {f"mib_{s}": f"{v:.0f}" for s, v in self.peak.items()}


@dataclass(frozen=True)
class ProgressEvent:
    """One step of the search, for progress displays. Bounds are costs by the objective that is
    ``named``: makespans in units; of what is maximised, with the other sign.
    """

    round: int
    phase: str
    message: str
    lower_bound: int | Fraction | None
    upper_bound: int | Fraction | None
    elapsed: float
    named: str = "makespan"
    sign: int = 1

    @property
    def bounds(self) -> str:
        """What is known of the objective, in the user's values ("": nothing)."""
        least, most = (">=", self.lower_bound), ("<=", self.upper_bound)
        if self.sign < 0:
            least, most = (">=", self.upper_bound), ("<=", self.lower_bound)
        other = self.named != "makespan"
        known = [(op, v) for op, v in (least, most) if v or (other and v is not None)]
        told = [f"{op} {shown(self.sign * v)}" for op, v in known if v is not None]
        return f"{self.named} {', '.join(told)}" if told else ""


@dataclass
class Round:
    """One candidate schedule and what came of it (times in s, bounds in units)."""

    number: int
    makespan: int | None
    lower_bound: int | Fraction | None
    upper_bound: int | Fraction | None
    refinements: int
    seconds_scheduler: float
    seconds_motion: float
    elapsed: float
    outcome: str


@dataclass
class History:
    """All rounds and refinements of a search."""

    rounds: list[Round] = field(default_factory=list)
    refinements: list[Refinement] = field(default_factory=list)
    seconds_scheduler: float = 0.0
    seconds_motion: float = 0.0
    stages: Stages = field(default_factory=Stages)
    """What each stage took."""
    restarts: int = 0
    recognised: tuple[str, ...] = ()
    """Structures that the scheduler found in the problem ..."""
    left_over: tuple[str, ...] = ()
    """... and what it took as it is written."""
    handed_over: list[str] = field(default_factory=list)
    """What of the problem another engine was asked for, and what it answered."""
    refused: list[str] = field(default_factory=list)
    """What the validator had against plans that the search took for valid; it learned from it."""
    missed: list[str] = field(default_factory=list)
    """Each time that motions were not found, or not in time: which, and among what that rests."""
    refuted: list[str] = field(default_factory=list)
    """Claims of ours that were refuted: errors of the package."""

    may_be_shorter: dict[str, float] = field(default_factory=dict)
    """Motions of the best plan that may be shorter than the planner's own, which a relative bound
    rests on: by what share of its time each is longer than is proven to be needed, worst first.
    """

    without_traffic: int | None = None
    """The least makespan (units) found of a large problem in which robots heed each other at shared
    places only, each taken by one at a time with the least change-over that a plan has shown.
    """

    last_plan_round: int | None = None
    """In which round the best plan was found ..."""
    last_plan_at: float | None = None
    """... and when (s since the start)."""

    def planned(self, number: int, at: float) -> None:
        """Note that a better plan was found."""
        self.last_plan_round, self.last_plan_at = number, at

    def take_times(self, budget: Budget) -> None:
        """Note what was spent so far."""
        self.seconds_scheduler = budget.seconds_scheduler
        self.seconds_motion = budget.seconds_motion

    def count(self, layer: Layer) -> int:
        """Return how many refinements a layer gave."""
        return sum(1 for r in self.refinements if r.layer is layer)

    def by_kind(self) -> dict[str, int]:
        """Return how many refinements there were of each layer and strength."""
        kinds = Counter(f"{r.layer.value}/{r.strength.value}" for r in self.refinements)
        return dict(sorted(kinds.items()))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "rounds": [asdict(r) for r in self.rounds],
            "refinements": [
                {
                    "layer": r.layer.value,
                    "strength": r.strength.value,
                    "statement": str(r.statement),
                    "why": r.why,
                }
                for r in self.refinements
            ],
            "refinements_by_kind": self.by_kind(),
            "seconds_scheduler": self.seconds_scheduler,
            "seconds_motion": self.seconds_motion,
            "stages": asdict(self.stages),
            "restarts": self.restarts,
            "refused": self.refused,
            "refuted": self.refuted,
        }

    def write_json(self, path: str | Path) -> None:
        """Write the history as JSON."""
        write_whole(Path(path), json.dumps(self.to_dict(), indent=1, default=float) + "\n")
