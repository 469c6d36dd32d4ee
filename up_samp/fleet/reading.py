"""From plain data (keywords, YAML, JSON) to records: one code path, with errors that say where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from up_samp.fleet import records
from up_samp.fleet.faults import Fault, FleetError, Path
from up_samp.fleet.records import FleetRecords

_UNIONS = ("tuple[", "constrained", "function-", "Stop", "Place", "Attached", "str")
"""How pydantic names the members of a union in an error's place: of no use to readers."""


NOT_YET = {
    "charge": "chargers are part of a place: charger: {per_second: 1.0}",
    "chargers": "chargers are part of a place: charger: {per_second: 1.0}",
    "speed": "give v_max, in m/s",
    "radius": "give the footprint as corners, or turning_radius",
}
"""Keys that one may expect, and what to say of them."""


RECORDS = tuple(kind for kind in vars(records).values() if is_dataclass(kind))


def read_record(kind: type, data: Any, path: Path = ()) -> Any:
    """Return ``data`` as a record of ``kind``.

    :raises FleetError: with a fault for each value that is wrong, below ``path``.
    """
    try:
        return _adapter(kind).validate_python(data)
    except ValidationError as error:
        raise FleetError(_faults(error, data, path)) from error


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of problem files, made from the records."""
    schema = TypeAdapter(FleetRecords).json_schema(mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "up-samp-problem",
        **{k: v for k, v in schema.items() if k != "title"},
    }


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _faults(error: ValidationError, data: Any, path: Path) -> list[Fault]:
    found: dict[Path, Fault] = {}
    for item in error.errors(include_url=False):
        inner = _inside(data, item["loc"])
        where = (*path, *inner)
        text = item["msg"].replace("Input should be", "should be")
        if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            text = NOT_YET.get(str(item["loc"][-1]), no_such_key(str(item["loc"][-1])))
        elif item["type"] == "value_error":
            text = str(item["ctx"]["error"])
        elif item["type"] == "missing":
            text = "is missing"
        elif item["type"] == "string_pattern_mismatch":
            text = "a name has letters, digits, '_', '-' and '.', and begins with a letter"
        found.setdefault(where, Fault(where, text))
    return list(found.values())


def no_such_key(name: str) -> str:
    """Say that there is no such key, and which one may have been meant."""
    known = {field.name for kind in RECORDS for field in fields(kind)}
    near = get_close_matches(name, sorted(known), 1, 0.7)
    return f"there is no such key; did you mean '{near[0]}'?" if near else "there is no such key"


def _inside(data: Any, loc: tuple[str | int, ...]) -> Path:
    """Return the part of pydantic's place that leads through ``data``."""
    path: list[str | int] = []
    for i, part in enumerate(loc):
        last = i == len(loc) - 1
        if isinstance(data, Mapping) and isinstance(part, str):
            if part in data:
                data = data[part]
            elif not last or part.startswith(_UNIONS) or "[" in part:
                continue  # a member of a union, or a shorthand that stands for its first key
        elif isinstance(data, list | tuple) and isinstance(part, int) and part < len(data):
            data = data[part]
        else:
            continue
        path.append(part)
    return tuple(path)
