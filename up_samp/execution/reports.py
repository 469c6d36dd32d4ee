"""Commands to robots (drive on, wait, do something), and their reports: what cannot be is not
believed.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from up_samp.execution.state import MotionUnderWay
from up_samp.execution.tolerances import TOLERANCES


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


# ------------------ What robots tell


@dataclass(frozen=True)
class Report:
    """What a robot tells at ``time``: its ``progress`` (m) along a motion, or its ``pose``, or that
    an activity is over (``done``). ``error``: how far (m) it says that it may be from there.
    """

    robot: str
    time: float
    activity: str = ""
    progress: float | None = None
    pose: tuple[float, float, float] | None = None
    done: bool = False
    error: float | None = None


class Heard(enum.Enum):
    """What has become of a report."""

    TAKEN = "taken"
    """It is believed."""
    IGNORED = "ignored"
    """It says nothing that counts (any more): a robot or a motion that is none of the plan's, a
    motion that is over, something older than what is known, a second ``done``."""
    AGAIN = "ask again"
    """It cannot be, and changes nothing: tell it again, and right."""
    HELD = "held"
    """The robot is where it cannot have been led: it is told to hold, and so are others."""


@dataclass(frozen=True)
class Reply:
    """The answer to a report: what has become of it, and ``why`` it was not simply taken."""

    heard: Heard
    why: str = ""


TAKEN = Reply(Heard.TAKEN)


def is_number(value: Any) -> bool:
    """Return whether a value told is a finite number."""
    if isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except (TypeError, OverflowError):
        return False


def unreadable(progress: Any, pose: Any) -> str:
    """Return why neither a progress (m) nor a pose can be read (``""``: one can; a pose counts)."""
    if pose is None:
        return (
            "" if is_number(progress) else f"progress cannot be {progress!r}: a finite number (m)"
        )
    if isinstance(pose, Sequence) and len(pose) == 3 and all(map(is_number, pose)):
        return ""
    return f"a pose cannot be {pose!r}: three finite numbers"


def clock_doubt(now: float, known: float) -> str:
    """Return why a time (s) cannot be, where ``known`` is the latest one told (``""``: it can)."""
    ahead = now - known
    if abs(ahead) <= TOLERANCES.clock:
        return ""
    way = "ahead" if ahead > 0 else "behind"
    return f"its clock is {abs(ahead):.1f} s {way}"


def doubt(way: MotionUnderWay, progress: float, seconds: float, error: float) -> str:
    """Return why a robot cannot be at ``progress`` (m), ``seconds`` s after it told something that
    is believed (``""``: it can): no robot is so fast, or it would be so far beyond its path.
    ``error`` (m) is what every report may be wrong by.
    """
    slack = error + TOLERANCES.progress
    most = way.travel.fastest * seconds + 2 * slack
    far = progress - way.told
    if abs(far) > most and not -slack <= progress <= way.length + slack:
        return f"{progress:.3f} m are not on its path of {way.length:.3f} m: metres are meant"
    if far > most:
        return f"{far:.3f} m in {seconds:.2f} s are more than the {most:.3f} m that it can drive"
    return ""


def words_of(command: Command | None) -> tuple[str, str]:
    """Return what a robot is told, and why, in words."""
    match command:
        case Go(motion, until):
            return f"go to {until:.2f} m of {motion}", ""
        case Do(activity, may_end):
            return f"do {activity}", "" if may_end else "it may not end yet"
        case Hold(waiting_for):
            return "hold", "; ".join(waiting_for)
    return "", ""
