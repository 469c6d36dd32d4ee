"""Show what a search is doing: one line that changes on a terminal, plain lines elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TextIO

from up_samp.model.errors import in_words
from up_samp.plotting.tracks import tracks_of

if TYPE_CHECKING:
    from up_samp.search.knowledge import ProgressEvent


def table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> str:
    """Return aligned columns; the columns in ``right`` are aligned to the right."""
    widths = [max(len(str(r[i])) for r in (header, *rows)) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        parts = (
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        return "  ".join(parts).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([line(header), rule, *(line(r) for r in rows)])


def schedule_table(plan: dict[str, Any]) -> str:
    """Return the present activities of a plan: when, what, who moves, and for how long it drives.

    Times are in schedule units, driving in s.
    """
    driving = {
        (leg.activity, track.name): sum(b - a for a, b in leg.driving())
        for track in tracks_of(plan)
        for leg in track.legs
    }
    loads = {(ride["activity"], ride["object"]) for ride in plan.get("rides", ())}
    rows = []
    for entry in plan["activities"]:
        name = entry["name"]
        moved = [(o, s) for (a, o), s in driving.items() if a == name]
        driven = {o for o, _ in moved}
        changes = (c["object"] for c in plan["changes"] if c["activity"] == name)
        changed = [o for o in changes if o not in driven]
        parameters = ", ".join(f"{k}={v}" for k, v in entry.get("parameters", {}).items())
        rows.append(
            [
                str(entry["start"]),
                str(entry["end"]),
                str(entry["end"] - entry["start"]),
                in_words(name) + (f"({parameters})" if parameters else ""),
                in_words(", ".join([o for o, _ in moved] + changed)),
                ", ".join(f"{s:.1f} s" for o, s in moved if (name, o) not in loads),
            ]
        )
    header = ("start", "end", "length", "activity", "moves", "driving")
    return table(header, rows, right=(0, 1, 2, 5))


class Progress:
    """A progress display; call it with each event, and use it as a context to end the line. On a
    terminal, a line for each better plan stays.

    Elsewhere than on a terminal, a line is printed for the first event of each phase, when a bound
    moves, and otherwise at most every two seconds.
    """

    def __init__(self, stream: TextIO | None = None):
        self.stream = stream if stream is not None else sys.stderr
        self.live = self.stream.isatty()
        self._phases: set[str] = set()
        self._bounds = ""
        self._last_time = float("-inf")
        self._open = False

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._open:
            # the line has told what there was to tell: make room for the result
            self.stream.write("\r\x1b[2K")
            self.stream.flush()
            self._open = False

    def __call__(self, event: ProgressEvent) -> None:
        """Show an event."""
        line = describe(event)
        now = time.monotonic()
        if self.live:
            width = shutil.get_terminal_size().columns - 1
            kept = event.phase == "plan"  # a line for each better plan stays
            self.stream.write("\r\x1b[2K" + line[:width] + ("\n" if kept else ""))
            self.stream.flush()
            self._open = not kept
            return
        known = event.phase in self._phases and event.bounds == self._bounds
        if known and now - self._last_time < 2.0:
            return
        self._phases.add(event.phase)
        self._bounds, self._last_time = event.bounds, now
        print(line, file=self.stream, flush=True)


def describe(event: ProgressEvent) -> str:
    """Return an event as a line."""
    parts = [f"[{event.elapsed:6.1f} s]"]
    if event.round:
        parts.append(f"round {event.round}:")
    parts.append(event.phase)
    if event.message:
        parts.append(f"- {event.message}")
    if event.bounds:
        parts.append(f"({event.bounds})")
    return " ".join(parts)
