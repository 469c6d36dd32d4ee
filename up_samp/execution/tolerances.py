"""What counts as nothing in execution, and what plans and the floor keep in hand."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.io.precision import PRECISION


@dataclass(frozen=True)
class ExecutionTolerances:
    """Times in seconds, distances in metres, angles in radians."""

    same_time: float = 1e-6
    """Times closer than this are the same."""
    strict: float = 1e-3
    """What "strictly after" means in real time: the problem's time is whole units, the floor's is
    dense.
    """
    late: float = 2e-3
    """A plan's own rounding: how much later than an entry the other's exit may be."""
    still: float = 1e-6
    """A motion whose poses differ by less (m, rad) goes nowhere."""
    arrived: float = 1e-6
    """Progress that counts as nothing."""
    place: float = 1e-3
    """Poses closer than this (m, rad) are the same place."""
    step: float = 1e-3
    """Distance to a stopping point that is gone over in one step."""
    progress: float = 1e-3
    """Progress by which a robot may be short of a point and still count as having come to it."""
    localisation: float = 0.05
    """How far (m) from the truth a told progress may be, where nothing else is said."""
    settled: float = 1.5
    """Seconds after which a robot that tells no more progress stands."""
    clock: float = 60.0
    """Seconds by which a robot's clock may be ahead of, or behind, the latest time told."""
    grip: float = 0.01
    """Way of a ride in which its load also counts as standing where it was, or will be."""
    rounded: float = 2e-6
    """Seconds by which lags may differ that were rounded for a file."""
    margin: float = PRECISION.margin
    """Clearance that the dependencies keep, where the plan does and says no other one; less where
    it does not."""


TOLERANCES = ExecutionTolerances()
