"""From plain data (keywords, YAML, JSON) to records: one code path, with errors that say where."""

from __future__ import annotations

import re
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
        text = _in_words(item)
        found.setdefault(where, Fault(where, text))
    return list(found.values())


def _in_words(item: Any) -> str:
    """Return what is wrong in the words of problem files, not in those of Python."""
    kind, given, limits = item["type"], item["input"], item.get("ctx", {})
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        key = str(item["loc"][-1])
        return NOT_YET.get(key, no_such_key(key))
    if kind == "value_error":
        return str(limits["error"])
    if isinstance(given, bool) and kind in _WANTED:
        word = "yes, on or true" if given else "no, off or false"
        hint = "; quote a name that reads so" if kind == "string_type" else ""
        return f"should be {_WANTED[kind]}, and is {word}{hint}"
    if kind in _WANTED:
        return f"should be {_WANTED[kind]}, not {_shown(given)}"
    if kind in ("too_short", "too_long"):
        most = limits.get("min_length", limits.get("max_length"))
        return f"needs {most} {'or more' if kind == 'too_short' else 'at most'}, not {len(given)}"
    if kind in _LIMITS:
        sign, bound = _LIMITS[kind]
        return f"should be {sign.format(limits[bound])}, not {_shown(given)}"
    if kind == "string_pattern_mismatch":
        what = "a name has letters, digits, '_', '-' and '.', and begins with a letter"
        near = re.sub(r"[^A-Za-z0-9_.-]", "_", str(given))
        return f"{what}: '{near}'?" if re.match("[A-Za-z_]", near) else what
    if kind == "missing":
        return "is missing"
    return str(item["msg"]).replace("Input should be", "should be")


_WANTED = {
    **dict.fromkeys(("tuple_type", "list_type", "iterable_type"), "a list"),
    **dict.fromkeys(
        ("mapping_type", "dict_type", "dataclass_type", "dataclass_exact_type", "model_type"),
        "a table of keys and values",
    ),
    **dict.fromkeys(("float_type", "float_parsing", "finite_number"), "a number"),
    **dict.fromkeys(
        ("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "a whole number"
    ),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "a name, or text",
}
"""What a value should be, by the kind of pydantic's error."""

_LIMITS = {
    "greater_than": ("more than {:g}", "gt"),
    "greater_than_equal": ("{:g} or more", "ge"),
    "less_than": ("less than {:g}", "lt"),
    "less_than_equal": ("{:g} at most", "le"),
    "string_too_long": ("text of {} letters at most", "max_length"),
}


def _shown(value: Any) -> str:
    """Return a value as a file would have it, cut short."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    text = f"'{value}'" if isinstance(value, str) else f"{value}"
    return text if len(text) <= 40 else f"{text[:37]}..."


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
