"""The interleaving of scheduling and motion planning."""

from up_samp.search.history import History, ProgressEvent, Round
from up_samp.search.params import PRESETS, Parameters, split_parameters

__all__ = ["PRESETS", "History", "Parameters", "ProgressEvent", "Round", "split_parameters"]
