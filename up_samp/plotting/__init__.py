"""Pictures of plans. Everything is drawn from the plan dictionary of :mod:`up_samp.io`."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from up_samp.io import PlanDict, write_plan

if TYPE_CHECKING:
    from up_samp.plotting.animation import animation_html, write_html
    from up_samp.plotting.gantt import plot_executed, plot_gantt
    from up_samp.plotting.map_picture import places_of, plot_map

_HOMES = {
    "animation_html": "animation",
    "places_of": "map_picture",
    "plot_executed": "gantt",
    "plot_gantt": "gantt",
    "plot_map": "map_picture",
    "write_html": "animation",
}

__all__ = [
    "animation_html",
    "places_of",
    "plot_executed",
    "plot_gantt",
    "plot_map",
    "write_html",
    "write_outputs",
]


def __getattr__(name: str) -> object:
    # Matplotlib takes half a second to import, and not every command draws
    if name not in _HOMES:
        raise AttributeError(f"module 'up_samp.plotting' has no attribute '{name}'")
    return getattr(importlib.import_module(f"up_samp.plotting.{_HOMES[name]}"), name)


def write_outputs(
    plan: PlanDict,
    folder: Path,
    *,
    places: Mapping[str, tuple[float, ...]] | None = None,
    plan_file: bool = True,
) -> list[Path]:
    """Write ``plan.json`` and the pictures; return the files. Pictures of the map are left out
    where the plan has no objects to show on it.
    """
    from up_samp.plotting.animation import write_html
    from up_samp.plotting.gantt import plot_gantt
    from up_samp.plotting.map_picture import plot_map
    from up_samp.plotting.style import save_figure

    folder.mkdir(parents=True, exist_ok=True)
    written = []
    if plan_file:
        written.append(write_plan(folder / "plan.json", plan))
    written.append(save_figure(plot_gantt(plan), folder / "gantt.png"))
    if not plan["objects"]:
        return written
    written.append(save_figure(plot_map(plan, places=places), folder / "map.png"))
    written.append(write_html(plan, folder / "animation.html", places=places))
    return written
