"""The interleaving of scheduling and motion planning."""

from up_samp.search.events import Observer, State
from up_samp.search.knowledge import History, ProgressEvent, Round
from up_samp.search.params import ABLATIONS, PRESETS, Parameters, split_parameters

__all__ = [
    "ABLATIONS",
    "PRESETS",
    "History",
    "Observer",
    "Parameters",
    "ProgressEvent",
    "Round",
    "State",
    "split_parameters",
]
