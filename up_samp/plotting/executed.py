"""What was planned beside what happened: a Gantt chart of both."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from up_samp.plotting.gantt import timed_rows
from up_samp.plotting.rows import Row, rows_of
from up_samp.plotting.style import INK, OTHER, figure_axes, mixed, with_short_names
from up_samp.plotting.tracks import horizon

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
        _bars(ax, planned[name], top + 0.10, 0.26, 0.6)
        if name in real:
            real[name].color = planned[name].color
            _bars(ax, real[name], top + 0.44, 0.34, 0.0)
        _changes(ax, planned[name], top + 0.23, 0.6)
        if name in real:
            _changes(ax, real[name], top + 0.61, 0.0)
        _waits(ax, record, name, top + 0.80)
    _dress(ax, plan, record, list(planned.values()))
    return ax


def _bars(ax: Axes, row: Row, top: float, tall: float, pale: float) -> None:
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


def _changes(ax: Axes, row: Row, middle: float, pale: float) -> None:
    """Mark when an object is put elsewhere in one instant."""
    if row.changes:
        ax.plot(
            row.changes, [middle] * len(row.changes), "D", ms=6, mfc="white", mew=1.6, zorder=5,
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
