"""How exactly plans are written for other tools."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ExportPrecision:
    """Enough for robots that follow what is written."""

    straight: float = 0.2
    """Largest angle (rad) between heading and direction of travel that counts as forwards."""
    still: float = 1e-6
    """Steps below this length (m) and turn (rad) are rests."""
    step: float = 0.1
    """Seconds between two poses on ``/tf`` while something moves."""
    spacing: float = 0.05
    """Distance (m) between poses of a path, about."""
    near: float = 1e-6
    """Points of a path (m) that are the same."""
    at_once: float = 2e-3
    """Lags (s) up to which a robot that does one thing after the other keeps them by itself."""
    nurbs: float = 0.01
    """How far (m) an edge's polyline may be from the motion."""


PRECISION = ExportPrecision()
