"""How large a problem file may be, and what is drawn from it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileLimits:
    """Larger files and maps are refused before anything is built from them."""

    file_bytes: int = 16_000_000
    """Bytes of a file of problems."""
    aliases: int = 1_000
    """YAML aliases in one file: a few of them may stand for millions of nodes."""
    depth: int = 40
    """Tables in tables."""
    cells: int = 40_000_000
    """Cells of a map that is drawn from outlines."""


LIMITS = FileLimits()
