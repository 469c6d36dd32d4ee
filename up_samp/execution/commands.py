"""What a robot is told: drive on, wait, do something. Plain values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Go:
    """Drive along the path of ``motion`` (an activity), not beyond ``until`` (m of its path).

    The robot must be able to stand at ``until``: it brakes before, unless told a larger one.
    """

    motion: str
    until: float


@dataclass(frozen=True)
class Hold:
    """Stay where you are; ``waiting_for`` says why (empty: there is nothing left to do)."""

    waiting_for: tuple[str, ...] = ()


@dataclass(frozen=True)
class Do:
    """Do ``activity`` now (it drives nobody). It may not be over before ``may_end``."""

    activity: str
    may_end: bool = True


Command = Go | Hold | Do
