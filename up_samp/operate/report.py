"""The report of a day: figures in words, who drove when, what was late, and where robots stood."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from up_samp.operate.day import DayResult
from up_samp.operate.simulated import driven_until
from up_samp.plotting.background import ground_of
from up_samp.plotting.map_picture import map_panels
from up_samp.plotting.style import figure_axes, saved

CELL = 1.0
"""m: cells of the heat map of waiting."""


def draw_gantt(result: DayResult, file: Path) -> Path:
    """Draw for each robot when it drove, and above when plans were taken over."""
    names = [o["name"] for o in result.record["objects"]]
    ax = figure_axes(12, 1.2 + 0.32 * len(names))
    for k, name in enumerate(names):
        drives = [np.array(m["samples"]) for m in result.record["motions"] if m["object"] == name]
        spans = [(rows[0, 0] / 60.0, (driven_until(rows) - rows[0, 0]) / 60.0) for rows in drives]
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
    return saved(ax, file)


def draw_orders(result: DayResult, file: Path) -> Path:
    """Draw how many orders were open, and how late those were that were done."""
    ax = figure_axes(12, 3.6)
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
    late.set_ylim(-0.5, max(10.0, *(1.05 * j.tardiness for j in done)) if done else 10.0)
    ax.set_title("orders")
    return saved(ax, file)


def draw_waiting(result: DayResult, file: Path) -> Path:
    """Draw where robots stood though they had a motion to drive, on the map."""
    ground = ground_of(result.record)
    panels = map_panels(ground, None, "where robots waited")
    x, right, y, top = ground.extent
    where = np.array([(w[0], w[1]) for w in result.waits]).reshape(-1, 2)
    bins = (np.arange(x, right + CELL, CELL), np.arange(y, top + CELL, CELL))
    seconds, _, _ = np.histogram2d(
        where[:, 0], where[:, 1], bins=bins, weights=[w[2] for w in result.waits]
    )
    shown = np.ma.masked_less(seconds.T / 60.0, 1.0 / 60.0)
    for ax in panels:
        picture = ax.pcolormesh(*bins, shown, cmap="YlOrRd", alpha=0.8)
    panels[0].figure.colorbar(picture, ax=panels, label="min waited")
    return saved(panels[0], file)


# ------------------ The report


def write_report(result: DayResult, folder: Path) -> list[Path]:
    """Write ``day.json``, ``day.txt`` and pictures (``gantt.png``, ``orders.png``,
    ``waiting.png``) into a folder; return the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("day.json", "day.txt")]
    told = {"plan": asdict(result.plan), "figures": asdict(result.figures)}
    told["verdict"] = asdict(result.verdict)
    files[0].write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    files[1].write_text(report_text(result) + "\n", encoding="utf-8")
    for name, draw in (("gantt", draw_gantt), ("orders", draw_orders), ("waiting", draw_waiting)):
        files.append(draw(result, folder / f"{name}.png"))
    return files


def report_text(result: DayResult) -> str:
    """Return a day in words."""
    f, v = result.figures, result.verdict
    why: dict[str, int] = {}
    for *_, reason, taken in result.costs:
        if taken:
            kind = reason.replace("again: ", "")
            kind = "an order came" if kind.startswith("order") else kind.partition("'")[0].strip()
            why[kind] = why.get(kind, 0) + 1
    reasons = ", ".join(f"{n} {k}" for k, n in sorted(why.items(), key=lambda i: -i[1]))
    return "\n".join((
        f"{f.done} of {f.orders} orders done in {f.hours:g} h: {f.per_hour:g} an hour",
        f"mean tardiness {f.tardiness:g} s, {100 * f.in_time:.0f} % in time, "
        f"{f.flow:g} s from coming to done",
        f"{f.kilometres:g} km driven, {100 * f.waiting:.1f} % of the driving time waited",
        f"{f.plans} plans, {f.plans_taken} taken ({reasons})",
        "CPU of a plan: median {:.2f} s, 95 % {:.2f} s, most {:.2f} s".format(*f.planning),
        "CPU of a step: median {:.1f} ms, 95 % {:.1f} ms, most {:.1f} ms".format(
            *(1000 * s for s in f.steps)
        ),
        f"judged: {', '.join(f'{len(found)} {kind}' for kind, found in vars(v).items())}",
        f"simulated in {f.seconds:g} s",
    ))  # fmt: skip
