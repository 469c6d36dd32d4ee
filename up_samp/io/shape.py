"""Plan dictionaries against the JSON Schema of plan files (``plan.schema.json``), and numbers and
times that no schema tells apart.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from typing import Any

from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError
from up_samp.model.errors import short


@cache
def _validator(part: str) -> Callable[[Any], Any]:
    """Return what raises where a value is not as a field of plans says (``""``: a plan itself, of
    whose samples and dependencies nothing is asked yet).
    """
    import fastjsonschema

    text = resources.files("up_samp.io").joinpath("plan.schema.json").read_text("utf-8")
    schema = json.loads(text)
    fields = schema["properties"]
    if part:
        schema = {**fields[part], "$schema": schema["$schema"], "$defs": schema["$defs"]}
    else:
        fields["dependencies"] = {"type": "object", "description": "an object"}
        motion = fields["motions"]["items"]["properties"]
        del motion["progress"], motion["avoid"]
        motion["samples"] = {}  # there are many: a tenth of the time without it
    checked: Callable[[Any], Any] = fastjsonschema.compile(schema, use_default=False)
    return checked


def shape_fault(value: Any, part: str = "") -> str:
    """Return, in words, where a plan (or one of its fields, a ``part``) is not as the schema says
    first (``""``: nowhere).
    """
    from fastjsonschema import JsonSchemaValueException

    try:
        _validator(part)(value)
    except JsonSchemaValueException as error:
        return _said(error, part)
    return ""


def _said(error: Any, part: str) -> str:
    """Return what is wrong, and where."""
    place = _place([part] * bool(part) + error.path[1:])
    if error.rule == "required":
        lost = next(key for key in error.definition["required"] if key not in error.value)
        return f"{place} lacks '{lost}'".strip()
    value = repr(short(error.value)) if isinstance(error.value, str) else short(error.value)
    wanted = error.definition.get("description") or error.message
    return f"{place} cannot be {value}: it must be {wanted}"


def _place(path: Iterable[str | int]) -> str:
    """Return a place in words, from the inside out."""
    steps = [f"entry {step}" if str(step).isdigit() else f"'{step}'" for step in path]
    return " of ".join(reversed(steps))


def _strange(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[str]:
    """Yield what no JSON can hold: numbers that are not finite, values of other types."""
    if isinstance(value, dict | list | tuple):
        keyed = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in keyed:
            yield from _strange(item, (*path, key))
    elif not (value is None or isinstance(value, str | int) or _is_finite(value)):
        yield f"{_place(path)} cannot be {short(value)}: it must be a finite number, or no number"


def _is_finite(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)


def check_shape(plan: Mapping[str, Any], label: str) -> None:
    """Raise :class:`ProblemError` that names the first field that is missing or of a wrong type."""
    try:
        json.dumps(plan, allow_nan=False)  # a schema's limits let NaN pass
        fault = shape_fault(plan)
    except (TypeError, ValueError):
        fault = next(_strange(plan))
    if fault:
        raise ProblemError(f"{label}{' ' if fault.startswith('lacks') else ': '}{fault}")
    for motion in plan["motions"]:
        _check_samples(motion, label)


def is_number(value: Any, least: float = -PRECISION.largest) -> bool:
    """Return whether a value is a number of plan files (m, s, rad), ``least`` or more."""
    # comparing works for whole numbers of any size, converting does not
    real = isinstance(value, int | float) and not isinstance(value, bool)
    return real and least <= value <= PRECISION.largest


def _check_samples(motion: Mapping[str, Any], label: str) -> None:
    rows = motion["samples"]
    who, what = short(motion["object"]), short(motion["activity"])
    where = f"{label}: the samples of '{who}' in activity '{what}'"
    good = isinstance(rows, list) and rows and all(isinstance(r, list) for r in rows)
    if not good or {len(r) for r in rows} not in ({4}, {8}):
        raise ProblemError(f"{where} must be rows [t, x, y, theta]")
    wrong = [v for r in rows for v in r if not is_number(v)]
    if wrong:
        most = f"{PRECISION.largest:g}"
        raise ProblemError(f"{where} must be finite numbers up to {most}, not {short(wrong[0])}")
    late = next((a[0] for a, b in itertools.pairwise(rows) if b[0] <= a[0]), None)
    if late is not None:
        raise ProblemError(f"{where} must have increasing times, not as after {late:g} s")
