"""Tunables: numbers that decide how hard something is tried, not what is true.

None of them may change what a plan or a proof means: with other values a search takes longer, or
finds less. A number is one only as long as ``scripts/sweep.py`` shows that it matters; else it is a
constant beside its use. ``docs/tuning.md`` lists them.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from up_samp.model.errors import ProblemError, short

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def tunable(
    default: Any,
    unit: str,
    what: str,
    room: str,
    *,
    least: float,
    most: float = math.inf,
) -> Any:
    """Return a dataclass field: its default, unit, meaning, the room whose code reads it, and the
    values that make sense.

    A whole default takes whole numbers only; a tuple takes as many numbers as one likes.
    """
    told = {"unit": unit, "what": what, "room": room, "least": least, "most": most}
    return dataclasses.field(default=default, metadata=told)


_FLEET, _GROUP = "search/fleet", "motion/fleet"
_CPSAT = "scheduling/cpsat"


@dataclass(frozen=True)
class Tuning:
    """All tunables. Raises :class:`ProblemError` for values that make no sense."""

    large: int = tunable(
        100,
        "optional activities",
        "from which on jobs are assigned to robots first",
        _FLEET,
        least=1,
    )
    exchanges: int = tunable(
        2000, "changes a job", "of annealing over who does what", _FLEET, least=0
    )
    cold: float = tunable(
        0.001,
        "share",
        "of all cost, by which a change may be worse in the end",
        _FLEET,
        least=0,
        most=1,
    )
    stale: int = tunable(
        1_000, "changes", "of tours in a row that may bring nothing", _FLEET, least=1
    )
    knots: tuple[int, ...] = tunable(
        (40_000, 150_000),
        "moves",
        "looked at in one search for joint moves, on all roadmaps in turn",
        _GROUP,
        least=1,
    )
    tiny: int = tunable(
        2_000,
        "constraints",
        "up to so many, a search without presolve is tried first",
        _CPSAT,
        least=0,
    )
    tour_rounds: int = tunable(
        60, "rounds a task", "of annealing over tours before CP-SAT is asked", _CPSAT, least=0
    )
    doubted: int = tunable(
        150,
        "constraints",
        "of the problem as it is written, up to which claims that rest on what was recognised are "
        "doubted: the plain model is asked for a schedule that cannot be",
        _CPSAT,
        least=0,
    )
    labels: int = tunable(
        4_000_000,
        "labels",
        "beginnings of sequences of tasks that proofs may look at, where the optimum is asked for "
        "(some 10 microseconds each)",
        _CPSAT,
        least=0,
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            _check(field, getattr(self, field.name))

    def changes(self) -> dict[str, Any]:
        """Return what is not the default, by name."""
        default = dataclasses.asdict(Tuning())
        return {name: x for name, x in dataclasses.asdict(self).items() if x != default[name]}


def _check(field: dataclasses.Field[Any], value: object) -> None:
    told: Mapping[str, Any] = field.metadata
    default: Any = field.default
    several = isinstance(default, tuple)
    if several and (not isinstance(value, tuple) or not value):
        raise ProblemError(f"'{field.name}' must be a list of numbers, not {short(value)}")
    first, *_ = default if several else (default,)
    whole, low, high = isinstance(first, int), told["least"], told["most"]
    kind = "a whole number" if whole else "a finite number"
    given: Any = value if several else (value,)
    for number in given:
        good = isinstance(number, int if whole else int | float) and not isinstance(number, bool)
        if not good or not math.isfinite(number):
            raise ProblemError(f"'{field.name}' must be {kind}, not {short(number)}")
        if number < low:
            raise ProblemError(f"'{field.name}' must be {low:g} or more, not {number}")
        if number > high:
            raise ProblemError(f"'{field.name}' must be {high:g} or less, not {number}")


def tuning_of(given: object) -> Tuning:
    """Return tunables from themselves, a table by name, the path of a TOML file, or None (the
    defaults); what is not named has its default.

    Raises :class:`ProblemError` for anything else, for names that are unknown and for values that
    make no sense; the error names the file and the tunable.
    """
    if given is None:
        return Tuning()
    if isinstance(given, Tuning):
        return given
    if isinstance(given, Mapping):
        return _named(given)
    if isinstance(given, str | os.PathLike):
        return read_tuning(Path(given))
    raise ProblemError(f"'tuning' must be a table or the path of a TOML file, not {short(given)}")


def _named(table: Mapping[str, Any]) -> Tuning:
    known = [f.name for f in dataclasses.fields(Tuning)]
    for name in table:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
            raise ProblemError(f"unknown tunable '{name}' ({hint})")
    values: Any = {n: tuple(x) if isinstance(x, list) else x for n, x in table.items()}
    return Tuning(**values)


def read_tuning(path: Path) -> Tuning:
    """Return the tunables of a TOML file; what it does not name has its default."""
    try:
        return _named(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ProblemError(f"tuning file '{path}': {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, ProblemError) as error:
        raise ProblemError(f"tuning file '{path}': {error}") from error
