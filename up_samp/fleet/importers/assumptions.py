"""What importers assume where a file does not tell."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Assumptions:
    """Sizes of robots, walls and doors, and what chargers give."""

    leaf: float = 0.1
    """Thickness of a leaf, m."""
    before_door: float = 1.2
    """How far before a door robots open it, where no lane tells, m."""
    cell_share: float = 0.8
    """A robot's length as a share of a cell."""
    charging: float = 0.05
    """What a charger gives a second: a battery of 100 is full in half an hour."""
    rmf_wall: float = 0.1
    """Thickness of RMF's walls, m (its own default)."""
    cell: float = 0.05
    """Size of a cell of a map that is drawn from outlines, m."""
    drawn_wall: float = 0.05
    """Thickness of a wall that is drawn as a line, m."""


ASSUMED = Assumptions()
