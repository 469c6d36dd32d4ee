"""How large things are in pictures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sizes:
    """Chosen by eye."""

    map_width: int = 1600
    """Widest picture of a map in an animation, pixels."""
    strip: int = 26
    """Height of the line of text below a frame, pixels."""
    wait: float = 0.5
    """Waits shorter than this (s) are not drawn."""
    name: int = 60
    """Characters of a name in a picture."""
    groups: int = 10
    """More groups of other activities than this are shown as one."""
    lane: float = 1.0
    """Height of one lane of a row."""
    headroom: float = 0.55
    """Room for the row's name above its lanes, in lanes."""
    bar: float = 0.72
    """Height of a bar, in lanes."""


SIZES = Sizes()
