"""Pictures of plans. Everything is drawn from the plan dictionary of :mod:`up_samp.io`."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from up_samp.plotting.animation import animation_html, write_html
    from up_samp.plotting.executed import plot_executed
    from up_samp.plotting.gantt import plot_gantt
    from up_samp.plotting.map_picture import places_of, plot_map
    from up_samp.plotting.outputs import write_outputs

_HOMES = {
    "animation_html": "animation",
    "places_of": "map_picture",
    "plot_executed": "executed",
    "plot_gantt": "gantt",
    "plot_map": "map_picture",
    "write_html": "animation",
    "write_outputs": "outputs",
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
