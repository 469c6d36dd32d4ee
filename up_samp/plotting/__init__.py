"""Pictures of plans. Everything is drawn from the plan dictionary of :mod:`up_samp.io`."""

from up_samp.plotting.animation import animation_html, write_html
from up_samp.plotting.gantt import plot_gantt
from up_samp.plotting.gif import write_gif
from up_samp.plotting.map_picture import places_of, plot_map

__all__ = [
    "animation_html",
    "places_of",
    "plot_gantt",
    "plot_map",
    "write_gif",
    "write_html",
]
