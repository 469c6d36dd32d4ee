"""A plan as tables (CSV): the schedule, the trajectories, the changes."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from up_samp.io import PlanDict
from up_samp.io.floors import map_number, maps_of
from up_samp.io.rides import in_formation

Cell = str | float


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``schedule.csv`` (s), ``trajectories.csv`` (s, m, rad; also of robots that keep
    formation with others) and ``changes.csv``, which name the map of each pose where there are
    several.
    """
    unit = plan["seconds_per_unit"]
    motions, driven = [*plan["motions"], *in_formation(plan)], dict[str, list[str]]()
    for motion in motions:
        driven.setdefault(motion["activity"], []).append(motion["object"])
    schedule = [
        (a["name"], a["start"] * unit, a["end"] * unit, " ".join(driven.get(a["name"], ())))
        for a in plan["activities"]
    ]
    spatial = any(len(m["samples"][0]) == 8 for m in plan["motions"])
    pose = ("x", "y", "z", "qx", "qy", "qz", "qw") if spatial else ("x", "y", "theta")
    labels = [m.label for m in maps_of(plan)]
    several = len(labels) > 1

    def where(entry: Mapping[str, Any]) -> list[str]:
        """Return the map that poses are on, where there are several."""
        return labels[map_number(entry) :][:several]

    rows = [
        (m["object"], m["activity"], *where(m), *_spatial(row, spatial=spatial))
        for m in motions
        for row in m["samples"]
    ]
    changes = [
        (
            c["object"],
            c["activity"],
            *where(c),
            *_spatial([c["time"], *c["configuration"]], spatial=spatial),
        )
        for c in plan["changes"]
    ]
    head = ("object", "activity", *["map"][:several], "t", *pose)
    return [
        _write(folder / "schedule.csv", ("activity", "start", "end", "drives"), schedule),
        _write(folder / "trajectories.csv", head, rows),
        _write(folder / "changes.csv", head, changes),
    ]


def _spatial(row: Sequence[float], *, spatial: bool) -> list[float]:
    """Return a row ``[t, *pose]`` with the pose of a body in the plane told in space, if asked."""
    if not spatial or len(row) == 8:
        return list(row)
    from up_samp.export.legs import quaternion

    return [row[0], row[1], row[2], 0.0, *quaternion(row[3])]


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path
