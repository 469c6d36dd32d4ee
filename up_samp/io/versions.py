"""Versions of the plan format, by what they added."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Versions:
    """A file of another major version is refused; minor versions only add fields."""

    major: int = 1
    dependencies: int = 1
    """Adds ``dependencies`` (see :mod:`up_samp.execution`) and ``rides`` (loads that travel with
    robots)."""
    maps: int = 2
    """Adds maps with frames and heights, and several maps."""
    choices: int = 3
    """Adds ``choices`` to the dependencies: orders that could be the other way round, too."""
    margin: int = 4
    """Adds ``margin``: the clearance that motions were planned with."""
    localisation: int = 5
    """Adds ``localisation`` and ``narrow`` to the dependencies: how wrong robots may be about where
    they are, and where the plan leaves less room than that."""


VERSIONS = Versions()
