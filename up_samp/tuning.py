"""All tunables in one place: read from TOML, handed to engines, commands and child processes.

``docs/tuning.md`` lists them. :class:`up_samp.model.tunable.Tunables` says what a tunable is.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from up_samp.model.errors import ProblemError, short
from up_samp.model.execution_tuning import ExecutionTuning
from up_samp.model.tunable import Tunables
from up_samp.motion.tuning import MotionTuning
from up_samp.scheduling.cpsat.tuning import CpsatTuning
from up_samp.search.tuning import SearchTuning

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Tuning(Tunables):
    """The tunables of all components."""

    search: SearchTuning = field(default_factory=SearchTuning)
    motion: MotionTuning = field(default_factory=MotionTuning)
    cpsat: CpsatTuning = field(default_factory=CpsatTuning)
    execution: ExecutionTuning = field(default_factory=ExecutionTuning)


def changes(tuning: Tuning) -> dict[str, Any]:
    """Return what is not the default, as a nested table."""

    def differing(given: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, value in given.items():
            if isinstance(value, Mapping):
                inner = differing(value, default[name])
                found |= {name: inner} if inner else {}
            elif value != default[name]:
                found[name] = value
        return found

    return differing(tuning.table(), Tuning().table())


def tuning_of(given: object) -> Tuning:
    """Return tunables from themselves, a nested table, the path of a TOML file, or None (the
    defaults).

    Raises :class:`ProblemError` for anything else, for names that are unknown and for values that
    make no sense; the error names the file and the tunable.
    """
    if given is None:
        return Tuning()
    if isinstance(given, Tuning):
        return given
    if isinstance(given, Mapping):
        return Tuning.read(given)
    if isinstance(given, str | os.PathLike):
        return read_tuning(Path(given))
    raise ProblemError(f"'tuning' must be a table or the path of a TOML file, not {short(given)}")


def read_tuning(path: Path) -> Tuning:
    """Return the tunables of a TOML file; what it does not name has its default."""
    try:
        table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
        return Tuning.read(table)
    except OSError as error:
        raise ProblemError(f"tuning file '{path}': {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, ProblemError) as error:
        raise ProblemError(f"tuning file '{path}': {error}") from error
