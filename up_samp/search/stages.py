"""What each stage of a search took: seconds, and the process's memory by then."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

try:
    import resource
except ImportError:  # not on Windows: memory is not told there
    resource = None  # type: ignore[assignment]

READING, STATING, SCHEDULING = "reading", "stating", "scheduling"
BUILDING = "building"
CHECKING, REPAIRING, LEARNING, VALIDATING = "checking", "repairing", "learning", "validating"
STAGES = (READING, STATING, SCHEDULING, BUILDING, CHECKING, REPAIRING, LEARNING, VALIDATING)
"""What every search does."""
IMPROVING = "improving"


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


def peak_memory() -> float | None:
    """Return the most memory (MiB) that this process has held so far; None where it is unknown."""
    if resource is None:
        return None
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return held / (1024.0 * 1024.0 if sys.platform == "darwin" else 1024.0)
