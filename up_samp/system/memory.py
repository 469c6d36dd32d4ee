"""How much memory this process holds, and may hold."""

from __future__ import annotations

import contextlib
import re
import sys

try:
    import resource
except ImportError:  # not a POSIX system
    resource = None  # type: ignore[assignment]


def peak_memory() -> float | None:
    """Return the most memory (MiB) that this process has held so far; None where it is unknown.

    Where the system tells it of this program alone, that counts: ``ru_maxrss`` is also what the
    process held before it became this program, which is what its parent held.
    """
    with contextlib.suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        told = re.search(r"VmHWM:\s*(\d+) kB", status.read())
        if told is not None:
            return int(told[1]) / 1024.0
    if resource is None:
        return None
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return held / (1024.0 * 1024.0 if sys.platform == "darwin" else 1024.0)


def limit_memory(size: int, what: str = "AS") -> None:
    """Limit this process's address space (or its ``DATA``; each by itself also its children's), in
    bytes, where the system can.
    """
    if resource is None:
        return
    kind = getattr(resource, f"RLIMIT_{what}")
    _, most = resource.getrlimit(kind)
    if most != resource.RLIM_INFINITY:
        size = min(size, most)
    resource.setrlimit(kind, (size, most if what == "DATA" else size))
