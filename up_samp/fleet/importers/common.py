"""What importers have in common."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from up_samp.fleet.faults import FleetError, find_faults
from up_samp.fleet.files import read_record, text_of, write_problem_file
from up_samp.fleet.records import FleetRecords
from up_samp.model import ProblemError
from up_samp.model.errors import short
from up_samp.upio.read_maps import FARTHEST


@dataclass(frozen=True)
class Options:
    """What files do not say. ``cell``: length of a grid's cell, m. ``map``: a ROS map to use
    instead of a drawn one. ``robots``, ``jobs``: how many to take at most.
    """

    cell: float = 1.0
    map: Path | None = None
    robots: int = 2
    jobs: int = 4

    def __post_init__(self) -> None:
        if not 0 < self.cell <= FARTHEST:
            raise ProblemError(f"a cell must have a length in m, not {self.cell!r}")
        for name in ("robots", "jobs"):
            if getattr(self, name) < 0:
                raise ProblemError(f"{name} to take: {getattr(self, name)} is less than none")


@dataclass(frozen=True)
class Imported:
    """The problem file that was written, and what had to be assumed."""

    problem: Path
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Importer:
    """How files of one kind are imported: ``read`` a file into a folder; what such files are called
    in messages; the endings of names that tell them (in lower case).
    """

    read: Callable[[Path, Path, Options], Imported]
    title: str
    endings: tuple[str, ...] = ()


def finish(folder: Path, data: dict[str, Any], notes: Collection[str]) -> Imported:
    """Check the data of a problem file and write it.

    :raises FleetError: where the source leads to a problem that is wrong.
    """
    records: FleetRecords = read_record(FleetRecords, data)
    faults = find_faults(records)
    if faults:
        raise FleetError(faults)
    file = write_problem_file(folder / "problem.yaml", records)
    head = "".join(f"# {note}\n" for note in notes)
    file.write_text(head + file.read_text(encoding="utf-8"), encoding="utf-8")
    return Imported(file, tuple(notes))


def listed(notes: Mapping[str, Iterable[str]]) -> list[str]:
    """Return notes as lines: what is said, and of which names; without those of none."""
    lines = {text: ", ".join(names) for text, names in notes.items()}
    return [f"{text}: {names}" for text, names in lines.items() if names]


def name_of(text: object, taken: Collection[str] = (), prefix: str = "p") -> str:
    """Return ``text`` as a name that problem files take, other than those ``taken``."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", str(text)).strip("_") or prefix
    if not re.match(r"[A-Za-z_]", name):
        name = f"{prefix}{name}"
    unique, number = name, 2
    while unique in taken:
        unique, number = f"{name}_{number}", number + 1
    return unique


def json_of(source: Path) -> Any:
    """Return what a file of JSON holds.

    :raises ProblemError: where it is none, or nested more deeply than any that is meant.
    """
    try:
        return json.loads(text_of(source), parse_constant=number_of)
    except json.JSONDecodeError as error:
        raise wrong(source, error.lineno, f"not readable as JSON: {error.msg}") from error
    except RecursionError as error:
        raise wrong(source, None, "nested too deeply") from error


def number_of(value: object) -> float:
    """Return a coordinate (m), an angle (rad) or a duration of a file as a number.

    :raises ValueError: where it is none, or one that nothing real has.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except OverflowError:
        number = math.inf
    if not abs(number) <= FARTHEST:  # NaN, too
        raise ValueError(f"{short(value)} is no number up to {FARTHEST:g}")
    return number


def wrong(source: Path, line: int | None, what: str) -> ProblemError:
    """Return an error about a line of a source."""
    where = f":{line}" if line is not None else ""
    return ProblemError(f"{source}{where}: {what}")
