"""How large files of problems, and what they say, may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileLimits:
    """Larger files, maps and figures are refused by name before anything is built from them."""

    file_bytes: int = 16_000_000
    """Bytes of a file of problems."""
    aliases: int = 1_000
    """YAML aliases in one file: a few of them may stand for millions of nodes."""
    depth: int = 40
    """Tables in tables."""
    number: int = 300
    """Letters of a number."""
    cells: int = 40_000_000
    """Cells of a map that is drawn from outlines."""
    pieces: int = 200_000
    """Elements and points of a drawing, each copy counted: a few lines may stand for millions."""
    largest: float = 1e9
    """Of all figures without a limit of their own: nothing real has more, and nobody could count
    with it.
    """
    least: float = 1e-6
    """Of what has to be more than nothing."""
    visits: int = 200
    """How often a robot may come to a charger, a door, or a place to park: each visit is an
    activity of its own."""
    repeats: int = 1_000
    """How often a job recurs."""
    corners: int = 1_000
    """Of a footprint, a door's leaf, or a zone: every pose that is looked at takes them all."""
    shown: int = 20
    """So many faults are told at a time."""


FILE_LIMITS = FileLimits()
