"""Commands to robots (drive on, wait, do something), and their reports: what cannot be is not
believed.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from up_samp.execution.lives import DriveCells, Life, Stay
from up_samp.execution.meetings import Meeting
from up_samp.execution.state import FloorState, MotionUnderWay, TaskPhase
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


@dataclass(frozen=True)
class Overrun:
    """``robot`` is surely ``by`` m beyond a gate of ``motion`` that is closed; negative: it is that
    far behind where it had already come to, so that others may be where it is now.

    ``held`` are robots that are kept away from it, ``met`` those that may touch it already.
    """

    robot: str
    motion: str
    by: float
    held: tuple[str, ...] = ()
    met: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.by > 0:
            return f"'{self.robot}' is {self.by:.3f} m beyond a closed gate of '{self.motion}'"
        return f"'{self.robot}' is {-self.by:.3f} m behind where it was in '{self.motion}'"


def is_number(value: Any) -> bool:
    """Return whether a value told is a finite number."""
    if isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except (TypeError, OverflowError):
        return False


def clock_doubt(now: float, known: float) -> str:
    """Return why a time (s) cannot be, where ``known`` is the latest one told (``""``: it can)."""
    ahead = now - known
    if abs(ahead) <= TOLERANCES.clock:
        return ""
    way = "ahead" if ahead > 0 else "behind"
    return f"its clock is {abs(ahead):.1f} s {way}"


def doubt(way: MotionUnderWay, progress: float, seconds: float, error: float) -> str:
    """Return why a robot cannot be at ``progress`` (m), ``seconds`` s after it told something that
    is believed (``""``: it can): it is not on the path, or no robot is so fast. ``error`` (m) is
    what every report may be wrong by.
    """
    slack = error + TOLERANCES.progress
    if not -slack <= progress <= way.length + slack:
        return f"{progress:.3f} m are not on its path of {way.length:.3f} m: metres are meant"
    most = way.travel.fastest * seconds + 2 * slack
    if progress > way.told + most:
        far = progress - way.told
        return f"{far:.3f} m in {seconds:.2f} s are more than the {most:.3f} m that it can drive"
    return ""


def kept_away(
    state: FloorState, meetings: Iterable[Meeting], way: MotionUnderWay
) -> tuple[tuple[str, ...], tuple[str, ...], dict[tuple[str, str], float]]:
    """Return who has to be kept away from a robot that is astray, who may touch it already, and how
    far (m) their motions may go (by activity and object): as far as they keep clear of wherever the
    robot may be, and of its way back to where it should be.
    """
    error, gate = state.localisation, state.closed(way)
    wrong = [way.told - error, way.told + error]
    if gate is not None:
        wrong.append(state.graph.events[gate].progress)
    if state.astray(way) < 0:
        wrong.append(way.progress + error)
    held: dict[str, None] = {}
    met: dict[str, None] = {}
    bars: dict[tuple[str, str], float] = {}
    for life, m, low, high in _in_the_way(meetings, way, min(wrong), max(wrong)):
        piece = life.pieces[m]
        if isinstance(piece, Stay):
            if _stands(state, life, m):
                met[life.object] = None
            continue
        other = state.ways[piece.key]
        running = state.phase[other.activity] is TaskPhase.RUNNING
        if state.phase[other.activity] is TaskPhase.DONE or (running and other.told - error > high):
            continue
        inside = running and other.told + error >= low
        (met if inside else held)[life.object] = None
        bar = other.told if inside else max(0.0, low - error)
        bars[piece.key] = min(bar, bars.get(piece.key, bar))
    return tuple(n for n in held if n not in met), tuple(met), bars


def _in_the_way(
    meetings: Iterable[Meeting], way: MotionUnderWay, low: float, high: float
) -> Iterator[tuple[Life, int, float, float]]:
    """Yield (life, piece, from, to) where others would meet a motion between ``low`` and ``high``
    (m): they between ``from`` and ``to`` (m) of their piece.
    """
    for meeting in meetings:
        rows = meeting.rows
        for mine, path, life, m, theirs, first, last, begin, end in (
            (meeting.a, meeting.path_a, meeting.other, meeting.m, meeting.path_b,
             rows[:, 0], rows[:, 0], rows[:, 1], rows[:, 2]),
            (meeting.b, meeting.path_b, meeting.one, meeting.k, meeting.path_a,
             rows[:, 1], rows[:, 2], rows[:, 0], rows[:, 0]),
        ):  # fmt: skip
            if not isinstance(mine, DriveCells) or mine.key != (way.activity, way.object):
                continue
            hit = (path.edges[first] <= high) & (path.edges[last + 1] >= low)
            if not np.any(hit):
                continue
            if theirs.cells == 0:
                yield life, m, 0.0, 0.0
                continue
            for j, k in zip(begin[hit], end[hit], strict=True):
                yield life, m, float(theirs.edges[j]), float(theirs.edges[k + 1])


def _stands(state: FloorState, life: Life, m: int) -> bool:
    """Return whether an object rests where it does in its piece ``m``."""
    before, after = life.pieces[:m], life.pieces[m + 1 :]
    over = all(
        state.phase[p.activity] is TaskPhase.DONE for p in before if isinstance(p, DriveCells)
    )
    later = all(
        state.phase[p.activity] is TaskPhase.WAITING for p in after if isinstance(p, DriveCells)
    )
    return over and later
