"""Plain text tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from up_samp.plotting.tracks import tracks_of


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
                name + (f"({parameters})" if parameters else ""),
                ", ".join([o for o, _ in moved] + changed),
                ", ".join(f"{s:.1f} s" for o, s in moved if (name, o) not in loads),
            ]
        )
    header = ("start", "end", "length", "activity", "moves", "driving")
    return table(header, rows, right=(0, 1, 2, 5))
