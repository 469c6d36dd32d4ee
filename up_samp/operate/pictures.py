"""Pictures of a day: who drove when, what waited and was late, and where robots stood."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from up_samp.geometry.maps import load_map
from up_samp.operate.simulated import driven_until
from up_samp.plotting.style import saved

if TYPE_CHECKING:
    from up_samp.operate.day import DayResult

CELL = 1.0
"""m: cells of the heat map of waiting."""


def _axes(width: float, height: float) -> Any:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure.add_subplot()


def draw_gantt(result: DayResult, file: Path) -> Path:
    """Draw for each robot when it drove, and above when plans were taken over."""
    names = [o["name"] for o in result.record["objects"]]
    ax = _axes(12, 1.2 + 0.32 * len(names))
    for k, name in enumerate(names):
        drives = [m["samples"] for m in result.record["motions"] if m["object"] == name]
        spans = [(rows[0][0] / 60.0, (driven_until(rows) - rows[0][0]) / 60.0) for rows in drives]
        ax.broken_barh(spans, (k - 0.3, 0.6), color="#4878a8", linewidth=0)
        mine = [h for h in result.handled if h.robot == name]
        spans = [(h.start / 60.0, (h.end - h.start) / 60.0) for h in mine]
        ax.broken_barh(spans, (k - 0.4, 0.8), color="#dd8452", linewidth=0)
    taken = [c[0] / 60.0 for c in result.costs if c[4]]
    ax.plot(taken, [-0.9] * len(taken), "|", color="#c44e52", label="a plan is taken over")
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.set_xlabel("min since the day's start")
    ax.set_title("who drove (blue) and handled orders (orange) when")
    ax.legend(loc="upper right", frameon=False, fontsize=8)
    return _kept(ax, file)


def draw_orders(result: DayResult, file: Path) -> Path:
    """Draw how many orders were open, and how late those were that were done."""
    ax = _axes(12, 3.6)
    events = [(j.came, 1) for j in result.jobs]
    events += [(j.done, -1) for j in result.jobs if j.done is not None]
    times, steps = zip(*sorted(events), strict=True) if events else ((0.0,), (0,))
    ax.step(np.array(times) / 60.0, np.cumsum(steps), where="post", color="#4878a8")
    ax.set_ylabel("orders that are open")
    ax.set_xlabel("min since the day's start")
    late = ax.twinx()
    done = [j for j in result.jobs if j.done is not None]
    when = [(j.done or 0.0) / 60.0 for j in done]
    late.plot(when, [j.tardiness for j in done], ".", color="#c44e52")
    late.set_ylabel("s late", color="#c44e52")
    late.set_ylim(bottom=-1.0)
    ax.set_title("orders")
    return _kept(ax, file)


def draw_waiting(result: DayResult, file: Path) -> Path:
    """Draw where robots stood though they had a motion to drive, on the map."""
    grid = load_map(result.record["map"]["yaml"])
    rows, cols = grid.occupied.shape
    x, y = grid.origin[0], grid.origin[1]
    width, height = cols * grid.resolution, rows * grid.resolution
    ax = _axes(10, max(2.5, 9.0 * height / width))
    extent = (x, x + width, y, y + height)
    ax.imshow(grid.occupied, origin="lower", extent=extent, cmap="Greys", vmax=2.0)
    where = np.array([(w[0], w[1]) for w in result.waits]).reshape(-1, 2)
    bins = (np.arange(x, x + width + CELL, CELL), np.arange(y, y + height + CELL, CELL))
    seconds, _, _ = np.histogram2d(
        where[:, 0], where[:, 1], bins=bins, weights=[w[2] for w in result.waits]
    )
    shown = np.ma.masked_less(seconds.T / 60.0, 1.0 / 60.0)
    picture = ax.pcolormesh(*bins, shown, cmap="YlOrRd", alpha=0.8)
    ax.figure.colorbar(picture, ax=ax, label="min waited")
    ax.set_aspect("equal")
    ax.set_xlim(x, x + width)
    ax.set_ylim(y, y + height)
    ax.set_title("where robots waited")
    return _kept(ax, file)


def _kept(ax: Any, file: Path) -> Path:
    saved(ax, file)
    return file
