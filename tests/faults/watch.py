"""How long something took, and how much of that the machine was busy with others."""

from __future__ import annotations

import time
from pathlib import Path

_STATES = Path("/proc/self/schedstat")


class Watch:
    """Started when it is made."""

    def __init__(self) -> None:
        self._began, self._before = time.monotonic(), _waited()

    @property
    def seconds(self) -> float:
        """Seconds of the clock since the start."""
        return time.monotonic() - self._began

    @property
    def waited(self) -> float:
        """Seconds in which the main thread could have run, but no processor was free (Linux)."""
        return _waited() - self._before

    @property
    def own(self) -> float:
        """Seconds that it would have taken had the main thread never waited for a processor."""
        return self.seconds - self.waited


def _waited() -> float:
    try:
        return int(_STATES.read_text().split()[1]) / 1e9
    except (OSError, IndexError):
        return 0.0
