"""How exactly plan files, and what is written for other tools, say times and poses; and what is too
large to be meant.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FilePrecision:
    """Finer than any plan is driven, coarse enough for files to be read."""

    step: float = 0.1
    """Largest gap in s between two samples of a plan file, and between two poses on ``/tf``, while
    the object moves.
    """
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
    straight: float = 0.2
    """Largest angle (rad) between heading and direction of travel that counts as forwards."""
    still: float = 1e-6
    """Steps below this length (m) and turn (rad) are rests for other tools."""
    spacing: float = 0.05
    """Distance (m) between poses of a path for other tools, about."""
    near: float = 1e-6
    """Points of a path (m) that are the same."""
    at_once: float = 2e-3
    """Lags (s) up to which a robot that does one thing after the other keeps them by itself."""
    nurbs: float = 0.01
    """How far (m) the polyline of an order's edge may be from the motion."""


PRECISION = FilePrecision()
