"""The interleaving of scheduling and motion planning."""

from up_samp.search.events import Observer, State
from up_samp.search.history import History, ProgressEvent, Round
from up_samp.search.params import ABLATIONS, PRESETS, Parameters, split_parameters
from up_samp.search.stopping import AnyOf, FirstPlan, Gap, MaxRounds, MaxRuntime, NoImprovement

__all__ = [
    "ABLATIONS",
    "PRESETS",
    "AnyOf",
    "FirstPlan",
    "Gap",
    "History",
    "MaxRounds",
    "MaxRuntime",
    "NoImprovement",
    "Observer",
    "Parameters",
    "ProgressEvent",
    "Round",
    "State",
    "split_parameters",
]
