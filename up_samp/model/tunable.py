"""Tunables: numbers that decide how hard something is tried, not what is true.

Each component has a frozen dataclass of them; every field tells its unit, what it is for and which
values make sense. None of them may change what a plan or a proof means: with other values a search
takes longer, or finds less. A number is one only as long as ``scripts/sweep.py`` shows that it
matters; else it is a constant beside its use.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from up_samp.model.errors import ProblemError, short

T = TypeVar("T", bound="Tunables")


def tunable(
    default: Any,
    unit: str,
    what: str,
    *,
    least: float | None = None,
    most: float | None = None,
) -> Any:
    """Return a dataclass field: its default, unit, meaning and the values that make sense.

    A whole default takes whole numbers only; a tuple takes as many numbers as one likes.
    """
    told = {"unit": unit, "what": what, "least": least, "most": most}
    return dataclasses.field(default=default, metadata=told)


def share_of(default: float, what: str) -> Any:
    """Return the field of a share, from 0 to 1."""
    return tunable(default, "share", what, least=0.0, most=1.0)


def effort_of(default: Any, what: str) -> Any:
    """Return the field of what CP-SAT may do at most: work that it counts, not seconds."""
    return tunable(default, "CP-SAT's deterministic time", what, least=0)


@dataclass(frozen=True)
class Tunables:
    """Base of all tunables, and of the groups of them (whose fields are tunables again)."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, Tunables):
                _check(field, value)

    @classmethod
    def read(cls: type[T], table: Mapping[str, Any], where: str = "") -> T:
        """Return tunables with the values of a (nested) table; what it does not name stays.

        Raises :class:`ProblemError` for unknown names and for values that make no sense.
        """
        fields = {f.name: f for f in dataclasses.fields(cls)}
        default = cls()
        values: dict[str, Any] = {}
        for name, value in table.items():
            full = f"{where}{name}"
            if name not in fields:
                raise ProblemError(f"unknown tunable '{full}'{_suggestion(name, fields)}")
            group = getattr(default, name)
            if isinstance(group, Tunables):
                if not isinstance(value, Mapping):
                    raise ProblemError(f"'{full}' is a table of tunables, not {short(value)}")
                values[name] = type(group).read(value, f"{full}.")
                continue
            value = tuple(value) if isinstance(value, list) else value
            try:
                _check(fields[name], value)
            except ProblemError as error:
                raise ProblemError(f"{full}: {error}") from error
            values[name] = value
        return cls(**values)

    def table(self) -> dict[str, Any]:
        """Return all values as a nested table."""
        found: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            found[field.name] = value.table() if isinstance(value, Tunables) else value
        return found

    def walk(self, where: str = "") -> Iterator[tuple[str, Tunables]]:
        """Yield (path, tunables) of each component, itself if it is one."""
        groups = [f.name for f in dataclasses.fields(self)]
        parts = [(n, getattr(self, n)) for n in groups]
        for name, part in parts:
            if isinstance(part, Tunables):
                yield from part.walk(f"{where}.{name}" if where else name)
        if not any(isinstance(part, Tunables) for _, part in parts):
            yield where, self


def _check(field: dataclasses.Field[Any], value: object) -> None:
    told: Mapping[str, Any] = field.metadata
    default: Any = field.default
    several = isinstance(default, tuple)
    if several and (not isinstance(value, tuple) or not value):
        raise ProblemError(f"'{field.name}' must be a list of numbers, not {short(value)}")
    first = default[0] if several else default
    for number in cast(tuple[object, ...], value) if several else (value,):
        whole = isinstance(first, int)
        good = isinstance(number, int if whole else int | float) and not isinstance(number, bool)
        if not good or not math.isfinite(cast(float, number)):
            kind = "a whole number" if whole else "a finite number"
            raise ProblemError(f"'{field.name}' must be {kind}, not {short(number)}")
        low, high = told.get("least"), told.get("most")
        if low is not None and cast(float, number) < low:
            raise ProblemError(f"'{field.name}' must be {low:g} or more, not {number}")
        if high is not None and cast(float, number) > high:
            raise ProblemError(f"'{field.name}' must be {high:g} or less, not {number}")


def _suggestion(name: str, known: Mapping[str, Any]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean '{near[0]}'?)" if near else f" (known: {', '.join(known)})"
