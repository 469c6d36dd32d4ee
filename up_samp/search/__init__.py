"""The interleaving of scheduling and motion planning."""

from up_samp.search.history import History, ProgressEvent, Round
from up_samp.search.params import ABLATIONS, PRESETS, Parameters, split_parameters

__all__ = [
    "ABLATIONS",
    "PRESETS",
    "History",
    "Parameters",
    "ProgressEvent",
    "Round",
    "split_parameters",
]
