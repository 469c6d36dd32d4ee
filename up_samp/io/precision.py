"""How exactly plan files say times and poses, and what is too large to be meant."""

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
    largest: float = 1e7
    """Largest time (s or schedule units) and coordinate (m) in a plan file: more is a slip of the
    pen, and nothing could be drawn or checked in bounded time.
    """
    name: int = 1000
    """Characters of a name, at most."""
    turned: float = 1e4
    """Largest heading, rad, that a motion may come to by turning."""


PRECISION = FilePrecision()
