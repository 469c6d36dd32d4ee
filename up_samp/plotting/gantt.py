"""A plan's schedule as a Gantt chart: which activity is shown in which row, under which short name;
and what was planned beside what happened.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import Bbox

from up_samp.io.plan_dict import word
from up_samp.plotting.style import (
    FIXTURE,
    INK,
    OTHER,
    color_of,
    drawn,
    figure_axes,
    ink_on,
    mixed,
    with_short_names,
)
from up_samp.plotting.tracks import ObjectTrack, horizon, tracks_of


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


# ------------------ The chart


HEADROOM, BAR = 0.55, 0.72
"""Room for a row's name above its lanes, and height of a bar, in lanes."""


def plot_gantt(plan: dict[str, Any], ax: Axes | None = None) -> Axes:
    """Draw a row for each moving object, each object that is changed, and each group of others.

    ``plan`` is a plan dictionary (:func:`up_samp.io.plan_to_dict`). In a motion's bar the solid
    part is driving, the hatched part waiting. The time axis is in seconds. Returns the axes;
    without ``ax``, those of a new figure (``ax.figure.savefig(...)``).
    """
    plan = with_short_names(plan)
    rows = rows_of(plan)
    heights = [row.lanes + HEADROOM for row in rows]
    if ax is None:
        ax = figure_axes(13.0, min(1.9 + 0.42 * sum(heights), 40.0))
    end = horizon(plan)
    ax.set_xlim(-0.004 * end, 1.012 * end)
    ax.set_ylim(max(sum(heights), 1.0), 0.0)
    _frame(ax, plan, rows, heights)
    drawn(ax)
    top = 0.0
    for row, height in zip(rows, heights, strict=True):
        _draw_row(ax, row, top, end)
        top += height
    _mark_ends(ax, plan)
    return ax


def _frame(ax: Axes, plan: dict[str, Any], rows: list[Row], heights: list[float]) -> None:
    top = 0.0
    ticks = []
    for i, height in enumerate(heights):
        ticks.append(top + (height + HEADROOM - (1.0 - BAR)) / 2)
        ax.axhspan(top, top + height, color="#F4F6F8" if i % 2 else "#FFFFFF", zorder=0, lw=0)
        top += height
    keys = [
        Patch(fc=OTHER, ec=OTHER, label="driving"),
        Patch(fc=mixed(OTHER, 0.75), ec=OTHER, hatch="////", label="motion, waiting"),
        Patch(fc=mixed(OTHER, 0.75), ec=OTHER, label="other activity"),
    ]
    timed_rows(ax, ticks, rows, title_of(plan), keys)


def timed_rows(
    ax: Axes, ticks: list[float], rows: list[Row], title: str, keys: list[Patch]
) -> None:
    """Dress axes whose rows, named at ``ticks``, run over the time: names, title and legend."""
    ax.set_yticks(ticks, [row.name for row in rows])
    for text, row in zip(ax.get_yticklabels(), rows, strict=True):
        text.set_color(row.color if row.track is not None else INK)
        text.set_fontweight("bold" if row.track is not None else "normal")
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("time [s]")
    ax.xaxis.grid(True, color="#D5DAE0", lw=0.6, zorder=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.set_title(title, loc="left", fontsize=11, color=INK, pad=26)
    ax.legend(
        handles=keys, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(keys), frameon=False,
        fontsize=8, borderaxespad=0.2,
    )  # fmt: skip


def title_of(plan: dict[str, Any]) -> str:
    """Return a line that says which plan this is."""
    parts = [plan["problem"], f"makespan {plan['makespan']}"]
    if plan["lower_bound"]:
        parts.append(f"proven lower bound {plan['lower_bound']}")
    if "bound_kind" in plan:
        parts.append(plan["bound_kind"].partition(" ")[0])
    parts += [plan["engine"], plan["status"].replace("_", " ").lower()]
    return "  ·  ".join(p for p in parts if p)


def _draw_row(ax: Axes, row: Row, top: float, end: float) -> None:
    taken: list[Bbox] = []
    for bar in row.bars:
        bottom = top + HEADROOM + bar.lane
        _draw_bar(ax, row, bar, bottom)
    if row.track is not None and not row.track.moves:
        _draw_changes(ax, row, top, end)
        return
    for bar in row.bars:
        _write_label(ax, row, bar, top + HEADROOM + bar.lane, taken)


def _draw_bar(ax: Axes, row: Row, bar: Bar, bottom: float) -> None:
    width = max(bar.end - bar.start, 1e-9)
    ax.add_patch(
        Rectangle(
            (bar.start, bottom), width, BAR, fc=mixed(row.color, 0.75), ec=row.color, lw=0.9,
            hatch="////" if bar.motion else None, zorder=2,
        )
    )  # fmt: skip
    for start, end in bar.driving:
        ax.add_patch(
            Rectangle((start, bottom), end - start, BAR, fc=row.color, ec="none", zorder=3)
        )


def _draw_changes(ax: Axes, row: Row, top: float, end: float) -> None:
    """Draw an object that is changed as one strip a configuration, with a mark at each change."""
    assert row.track is not None
    times, middle = row.changes, top + HEADROOM + BAR / 2
    for i, (start, stop) in enumerate(zip([0.0, *times], [*times, end], strict=True)):
        ax.plot(
            [start, stop], [middle, middle], color=mixed(row.color, 0.0 if i % 2 == 0 else 0.6),
            lw=5, solid_capstyle="butt", zorder=1.5,
        )  # fmt: skip
    ax.plot(times, [middle] * len(times), "D", ms=7, mfc="white", mec=row.color, mew=1.6, zorder=5)
    for t, pose in row.track.changes:
        ax.annotate(
            f"to ({pose[0]:g}, {pose[1]:g}) at {t:g} s", (t, middle), xytext=(9, 0),
            textcoords="offset points", fontsize=8, va="center", color=INK, zorder=6,
            bbox={"boxstyle": "round,pad=0.15", "fc": "#FFFFFFE0", "ec": "none"},
        )  # fmt: skip


def _write_label(ax: Axes, row: Row, bar: Bar, bottom: float, taken: list[Bbox]) -> None:
    """Write the longest of the bar's names that fits into it, else the first above it."""
    longest = max(bar.driving, key=lambda span: span[1] - span[0], default=(0.0, 0.0))
    solid = longest[1] - longest[0] > 0.5 * (bar.end - bar.start)
    color = ink_on(row.color) if solid else INK
    middle = bottom + BAR / 2
    start, end = longest if solid else (bar.start, bar.end)
    room = _width(ax, start, end) - 4
    for name in bar.labels:
        text = ax.text(
            (start + end) / 2, middle, name, ha="center", va="center", fontsize=8,
            color=color, zorder=6, clip_on=True,
        )  # fmt: skip
        if text.get_window_extent().width <= room:
            if bar.motion and not solid:
                text.set_bbox({"boxstyle": "round,pad=0.1", "fc": "#FFFFFFD0", "ec": "none"})
            taken.append(text.get_window_extent())
            return
        text.remove()
    _write_above(ax, bar, bottom, taken)


def _write_above(ax: Axes, bar: Bar, bottom: float, taken: list[Bbox]) -> None:
    """Name a narrow bar in the free strip above it, unless that would cover another name."""
    right_edge = ax.get_window_extent().x1
    for name in reversed(bar.labels):
        text = ax.text(
            bar.start, bottom - 0.06, name, ha="left", va="bottom", fontsize=7, color=INK, zorder=6
        )
        text.set_in_layout(False)
        box = text.get_window_extent()
        if box.x1 > right_edge:
            text.set(ha="right", x=bar.end)
            box = text.get_window_extent()
        if not any(box.overlaps(other) for other in taken):
            taken.append(box)
            return
        text.remove()


def _width(ax: Axes, start: float, end: float) -> float:
    left, right = ax.transData.transform([(start, 0.0), (end, 0.0)])
    return float(right[0] - left[0])


def _mark_ends(ax: Axes, plan: dict[str, Any]) -> None:
    unit = plan["seconds_per_unit"]
    span = plan["makespan"] * unit
    ax.axvline(span, color=INK, lw=1.2, ls="--", zorder=4)
    bound = plan["lower_bound"]
    if bound and bound < plan["makespan"]:
        ax.axvline(bound * unit, color=INK, lw=1.2, ls=":", zorder=4)


# ------------------ What was planned beside what happened


WAIT = "#C1121F"
"""Colour of waiting for somebody."""


def plot_executed(plan: dict[str, Any], record: dict[str, Any]) -> Axes:
    """Draw each object's planned activities above what was really done, with who waited for whom.

    ``plan`` is a plan dictionary, ``record`` that of a run (``Simulation.record``). The
    time axis is in seconds. Returns the axes of a new figure.
    """
    plan, record = with_short_names(plan), with_short_names(record)
    planned = {row.name: row for row in rows_of(plan)}
    real = {row.name: row for row in rows_of(record)}
    names = list(planned)
    ax = figure_axes(13.0, min(1.6 + 0.8 * len(names), 40.0))
    end = max(horizon(plan), horizon(record))
    ax.set_xlim(-0.004 * end, 1.012 * end)
    ax.set_ylim(len(names), 0.0)
    for top, name in enumerate(names):
        ax.axhspan(top, top + 1, color="#F4F6F8" if top % 2 else "#FFFFFF", zorder=0, lw=0)
        _draw_thin(ax, planned[name], top + 0.10, 0.26, 0.6)
        if name in real:
            real[name].color = planned[name].color
            _draw_thin(ax, real[name], top + 0.44, 0.34, 0.0)
        _waits(ax, record, name, top + 0.80)
    _dress(ax, plan, record, list(planned.values()))
    return ax


def _draw_thin(ax: Axes, row: Row, top: float, tall: float, pale: float) -> None:
    """Draw a row's bars, and mark when its object is put elsewhere in one instant."""
    for bar in row.bars:
        spans = bar.driving if bar.motion else ((bar.start, bar.end),)
        whole = Rectangle(
            (bar.start, top), bar.end - bar.start, tall, fc=mixed(row.color, 0.85),
            ec=mixed(row.color, pale), lw=0.6, zorder=2,
        )  # fmt: skip
        ax.add_patch(whole)
        for start, stop in spans:
            color = mixed(row.color, pale)
            ax.add_patch(Rectangle((start, top), stop - start, tall, fc=color, ec="none", zorder=3))
    ax.plot(
        row.changes, [top + tall / 2] * len(row.changes), "D", ms=6, mfc="white", mew=1.6, zorder=5,
        mec=mixed(row.color, pale),
    )  # fmt: skip


def _waits(ax: Axes, record: dict[str, Any], name: str, top: float) -> None:
    """Draw a row's waits, and for whom, as far as there is room for words."""
    mine = [w for w in record.get("waits", ()) if w["object"] == name]
    free = -np.inf
    width = ax.get_xlim()[1]
    for wait in mine:
        length = wait["until"] - wait["since"]
        if length < 0.5:  # s: hardly to be seen
            continue
        ax.add_patch(Rectangle((wait["since"], top), length, 0.12, fc=WAIT, ec="none", zorder=4))
        if wait["since"] >= free:
            text = f"for {wait['for']}"
            ax.text(
                wait["since"], top - 0.005, text, fontsize=6.5, color=WAIT, va="bottom", zorder=6,
                bbox={"boxstyle": "round,pad=0.08", "fc": "#FFFFFFD8", "ec": "none"},
            )  # fmt: skip
            free = wait["since"] + 0.0062 * width * len(text)


def _dress(ax: Axes, plan: dict[str, Any], record: dict[str, Any], rows: list[Row]) -> None:
    unit = plan["seconds_per_unit"]
    ax.axvline(plan["makespan"] * unit, color=INK, lw=1.0, ls=":", zorder=4)
    ax.axvline(record["makespan"] * unit, color=INK, lw=1.2, ls="--", zorder=4)
    title = (
        f"{plan['problem']}: planned {plan['makespan'] * unit:g} s (dotted), "
        f"executed {record['makespan'] * unit:.1f} s (dashed)"
    )
    keys = [
        Patch(fc=mixed(OTHER, 0.6), label="planned (above)"),
        Patch(fc=OTHER, label="executed (below)"),
        Patch(fc=mixed(OTHER, 0.85), ec=OTHER, label="not moving"),
        Patch(fc=WAIT, label="waiting, and for whom"),
    ]
    timed_rows(ax, [i + 0.45 for i in range(len(rows))], rows, title, keys)
