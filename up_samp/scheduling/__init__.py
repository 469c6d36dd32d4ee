"""Schedulers: any UP scheduling engine through compilers, and our own on CP-SAT."""

from up_samp.scheduling.adapters import Scheduler, open_scheduler
from up_samp.scheduling.quirks import is_compatible, known_engines

__all__ = [
    "Scheduler",
    "is_compatible",
    "known_engines",
    "open_scheduler",
]
