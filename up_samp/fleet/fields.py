"""What fields of a fleet's records hold: names, numbers, times, poses and outlines, all checked;
how large files of problems, and what they say, may be.

Lengths in m, angles in rad, times in s; poses are ``(x, y, theta)`` in the map's world frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, MinLen
from pydantic import AfterValidator, BeforeValidator, ConfigDict, StringConstraints

from up_samp.upio.read_maps import FARTHEST, LARGEST, MOST_TURNED


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


STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Unknown keys are errors, and so are numbers that are none."""

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_.-]*$", max_length=80)]


def _number(value: Any) -> Any:
    """Let no yes or no through as 1 or 0."""
    if isinstance(value, bool):
        word = "yes, on or true" if value else "no, off or false"
        raise ValueError(f"should be a number, and is {word}")
    return value


NUMBER = BeforeValidator(_number)
Count = Annotated[int, Gt(0), Le(int(FILE_LIMITS.largest)), NUMBER]
Some = Annotated[int, Ge(0), Le(int(FILE_LIMITS.largest)), NUMBER]
Visits = Annotated[int, Gt(0), Le(FILE_LIMITS.visits), NUMBER]
Positive = Annotated[float, Ge(FILE_LIMITS.least), Le(FILE_LIMITS.largest), NUMBER]
Length = Annotated[float, Ge(FILE_LIMITS.least), Le(LARGEST), NUMBER]
Clearance = Annotated[float, Ge(0), Le(LARGEST), NUMBER]
Seconds = Positive
Share = Annotated[float, Ge(FILE_LIMITS.least), Le(1), NUMBER]
Moment = Annotated[float, Ge(0), Le(FILE_LIMITS.largest), NUMBER]
Rate = Annotated[float, Ge(0), Le(FILE_LIMITS.largest), NUMBER]
Coordinate = Annotated[float, Ge(-FARTHEST), Le(FARTHEST), NUMBER]
Heading = Annotated[float, Ge(-MOST_TURNED), Le(MOST_TURNED), NUMBER]
Pose = tuple[Coordinate, Coordinate, Heading]
Point = tuple[Coordinate, Coordinate]
Window = tuple[Moment, Moment]


def _windows(value: Any) -> Any:
    """Take one window for a list of one."""
    pair = isinstance(value, list | tuple) and len(value) == 2
    return [value] if pair and not any(isinstance(v, list | tuple) for v in value) else value


def _in_order(windows: tuple[Window, ...]) -> tuple[Window, ...]:
    return tuple(sorted(windows))


Windows = Annotated[
    tuple[Window, ...],
    BeforeValidator(_windows, json_schema_input_type=Window | list[Window]),
    AfterValidator(_in_order),
]
"""Times (s) of which one holds all that something lasts, in their order; none: any."""
Polygon = Annotated[tuple[Point, ...], MinLen(3)]


def _outline(value: Any) -> Any:
    """Let only one of the two forms through, so that errors are about that one."""
    if isinstance(value, list | tuple):
        numbers = all(
            isinstance(v, int | float) and not isinstance(v, bool) and v > 0 for v in value
        )
        corners = all(isinstance(v, list | tuple) and len(v) == 2 for v in value)
        if (numbers and len(value) == 2) or (corners and len(value) >= 3):
            return value
    raise ValueError("give [length, width] in m, or three or more corners [x, y]")


Outline = Annotated[
    tuple[Length, Length] | Polygon,
    BeforeValidator(_outline, json_schema_input_type=tuple[Length, Length] | Polygon),
]
"""``(length, width)`` of a rectangle around the reference point, or the corners of a polygon."""


def corners_of(outline: Outline) -> list[tuple[float, float]]:
    """Return the corners of a footprint, m."""
    if len(outline) == 2 and not isinstance(outline[0], tuple):
        length, width = outline
        x, y = float(length) / 2, float(width) / 2  # type: ignore[arg-type]
        return [(-x, -y), (x, -y), (x, y), (-x, y)]
    return [(float(x), float(y)) for x, y in outline]  # type: ignore[misc]


def _names(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


Names = Annotated[tuple[Name, ...], BeforeValidator(_names, json_schema_input_type=Any)]
