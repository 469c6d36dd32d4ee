"""Between UP problems and our plain values: reading, relaxing, refining, writing plans."""

from up_samp.upio.plan import (
    SampSchedule,
    build_plan,
    build_schedule,
    trajectories,
    trajectory_key,
)
from up_samp.upio.read import read_problem
from up_samp.upio.relaxation import ConfigurationChoice, Itinerary, Relaxation, read_itinerary
from up_samp.upio.write_refinements import write_refinement
from up_samp.upio.write_relaxation import relax

__all__ = [
    "ConfigurationChoice",
    "Itinerary",
    "Relaxation",
    "SampSchedule",
    "build_plan",
    "build_schedule",
    "read_itinerary",
    "read_problem",
    "relax",
    "trajectories",
    "trajectory_key",
    "write_refinement",
]
