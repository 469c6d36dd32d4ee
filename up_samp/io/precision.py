"""How exactly plan files say times and poses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FilePrecision:
    """Finer than any plan is driven, coarse enough for files to be read."""

    step: float = 0.1
    """Largest gap in s between two samples of a plan file while the object moves."""
    decimals: int = 6
    """Digits after the point of times, coordinates and angles in a plan file."""
    sample_decimals: int = 9
    """Digits of the samples of motions. Where two curves meet, samples may lie 0.1 ms apart:
    rounded to a micrometre, a motion at its limits would seem to be beyond them there.
    """
    margin: float = 0.01
    """Clearance in m of plans that do not tell theirs: what the engine keeps by default."""


PRECISION = FilePrecision()
