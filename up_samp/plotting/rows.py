"""Which activity is shown in which row of a Gantt chart, and under which short name."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any

from up_samp.io.plan_dict import word
from up_samp.plotting.style import FIXTURE, OTHER, color_of
from up_samp.plotting.tracks import ObjectTrack, tracks_of


@dataclass(frozen=True)
class Bar:
    """An activity in a row: ``start`` and ``end`` in s, ``lane`` counts from 0 within the row.

    ``driving`` are the intervals (s) in which the row's object really moves.
    """

    activity: str
    start: float
    end: float
    labels: tuple[str, ...]
    lane: int = 0
    motion: bool = False
    driving: tuple[tuple[float, float], ...] = ()


@dataclass
class Row:
    """A row: an object that moves, an object that is changed, or a group of other activities."""

    name: str
    color: str
    track: ObjectTrack | None = None
    bars: list[Bar] = field(default_factory=list)

    @property
    def changes(self) -> list[float]:
        """When its object is put elsewhere in one instant (s)."""
        return [] if self.track is None else [t for t, _ in self.track.changes]

    @property
    def lanes(self) -> int:
        """How many bars lie above each other at most."""
        return max((b.lane for b in self.bars), default=0) + 1


def rows_of(plan: dict[str, Any]) -> list[Row]:
    """Return the rows of a plan: moving objects, changed objects, then other activities.

    An activity that moves no object belongs to the moving object that its name or its parameters
    mention (``pick_r0_item`` to ``r0``), else to the object that it changes, else to a group of
    activities whose names start alike.
    """
    tracks = tracks_of(plan)
    movers = [t for t in tracks if t.moves]
    changed = [t for t in tracks if not t.moves and t.changes]
    rows = {t.name: Row(t.name, color_of(i), t) for i, t in enumerate(movers)}
    rows |= {t.name: Row(t.name, FIXTURE, t) for t in changed}
    motions: dict[str, list[str]] = {}
    for motion in plan["motions"]:
        motions.setdefault(motion["activity"], []).append(motion["object"])
    groups: dict[str, Row] = {}
    unit = plan["seconds_per_unit"]
    for activity in plan["activities"]:
        name = activity["name"]
        span = (activity["start"] * unit, activity["end"] * unit)
        homes = motions.get(name) or _homes(activity, movers, plan["changes"])
        for row in [rows[home] for home in homes] or [_group(groups, name)]:
            row.bars.append(_bar(row, name, span, motion=name in motions))
    if len(groups) > 10:  # more are shown as one
        bars = sorted((b for g in groups.values() for b in g.bars), key=lambda b: b.start)
        groups = {"other": Row("other", OTHER, None, bars)}
    everything = [*rows.values(), *groups.values()]
    for row in everything:
        row.bars = _laned(row.bars)
    return everything


def _homes(
    activity: dict[str, Any], movers: list[ObjectTrack], changes: list[dict[str, Any]]
) -> list[str]:
    given = {str(v) for v in activity.get("parameters", {}).values()}
    named = [t.name for t in movers if t.name in given or word(t.name).search(activity["name"])]
    if named:
        return named
    return list(dict.fromkeys(c["object"] for c in changes if c["activity"] == activity["name"]))


def _group(groups: dict[str, Row], activity: str) -> Row:
    stem = re.split(r"[^A-Za-z]+", activity, maxsplit=1)[0] or "other"
    return groups.setdefault(stem, Row(stem, OTHER))


def _bar(row: Row, activity: str, span: tuple[float, float], *, motion: bool) -> Bar:
    driving: tuple[tuple[float, float], ...] = ()
    if motion and row.track is not None:
        legs = [leg for leg in row.track.legs if leg.activity == activity]
        driving = tuple(s for leg in legs for s in leg.driving())
    labels = short_names(activity, row.name if row.track is not None else "", motion=motion)
    return Bar(activity, span[0], span[1], labels, motion=motion, driving=driving)


def short_names(activity: str, row: str, *, motion: bool) -> tuple[str, ...]:
    """Return names for an activity in the row of the object ``row`` (or ""), the longest first."""
    words = activity
    if row:
        words = word(row).sub(" ", activity)
    text = " ".join(w for w in re.split(r"[\s_]+", words) if w) or activity
    names = [text]
    origin, _, goal = text.partition(" to ")
    origin = origin.partition(" of ")[0]  # a place, where it is that of a load
    if motion and goal:
        names += [" ".join([*origin.split()[-1:], f"→ {goal}"]), f"→ {goal}", goal]
    return tuple(dict.fromkeys(names))


def _laned(bars: list[Bar]) -> list[Bar]:
    """Put bars that overlap into lanes of their own (touching ends share a lane)."""
    free: list[float] = []
    placed = []
    for bar in sorted(bars, key=lambda b: (b.start, b.end)):
        lane = next((i for i, end in enumerate(free) if end <= bar.start), len(free))
        free[lane : lane + 1] = [bar.end]
        placed.append(replace(bar, lane=lane))
    return placed
