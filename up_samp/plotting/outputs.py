"""All pictures of a plan, beside its file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from up_samp.io import PlanDict, write_plan
from up_samp.plotting.animation import write_html
from up_samp.plotting.gantt import plot_gantt
from up_samp.plotting.map_picture import plot_map
from up_samp.plotting.style import saved


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
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    if plan_file:
        written.append(write_plan(folder / "plan.json", plan))
    written.append(saved(plot_gantt(plan), folder / "gantt.png"))
    if not plan["objects"]:
        return written
    written.append(saved(plot_map(plan, places=places), folder / "map.png"))
    written.append(write_html(plan, folder / "animation.html", places=places))
    return written
