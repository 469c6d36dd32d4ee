"""Plan files: read, written, and checked against their JSON Schema (``plan.schema.json``), and for
numbers, times and names that no schema tells apart.
"""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from up_samp.io.floors import map_entries
from up_samp.io.plan_dict import FORMAT, VERSION, PlanDict
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError
from up_samp.model.errors import short
from up_samp.system.files import write_whole


def write_plan(path: str | os.PathLike[str], plan: PlanDict) -> Path:
    """Write a plan dictionary to a file, one entry a line; equal plans give equal files."""
    check_plan(plan, "the plan")
    return write_whole(Path(path), dump_plan(plan))


def dump_plan(plan: PlanDict) -> str:
    """Return a plan dictionary as JSON text that people can read: one entry a line."""
    lines = []
    for key, value in plan.items():
        if isinstance(value, dict) and any(isinstance(v, list) for v in value.values()):
            inner = ",\n  ".join(f'"{k}": {_listed(v, "   ")}' for k, v in value.items())
            lines.append(f'"{key}": {{\n  {inner}\n }}')
        else:
            lines.append(f'"{key}": {_listed(value, "  ")}')
    return "{\n " + ",\n ".join(lines) + "\n}\n"


def _listed(value: Any, indent: str) -> str:
    """Return a value on a line, or a list with an entry a line."""
    if not isinstance(value, list) or not value:
        return _compact(value)
    entries = ",\n".join(f"{indent}{_compact(entry)}" for entry in value)
    return f"[\n{entries}\n{indent[:-1]}]"


def _compact(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def read_plan(path: str | os.PathLike[str]) -> PlanDict:
    """Read a plan file; raise :class:`ProblemError` naming the file and what is wrong with it.

    A relative path to the map is taken relative to the plan file's folder.
    """
    source = Path(path)
    try:
        plan = json.loads(source.read_text(encoding="utf-8"), parse_constant=_no_number)
    except OSError as error:
        raise ProblemError(f"plan file '{source}' cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, or absurdly so
        what = f"is not JSON: {short(str(error))}; 'up-samp solve PROBLEM --out DIR' writes one"
        raise ProblemError(f"plan file '{source}' {what}") from error
    check_plan(plan, f"plan file '{source}'")
    for entry in map_entries(plan):
        yaml = entry.get("yaml")
        if yaml is not None and not os.path.isabs(yaml):
            entry["yaml"] = str((source.parent / yaml).resolve())
    return dict(plan)


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no JSON number")


def check_plan(plan: Any, label: str) -> None:
    """Raise :class:`ProblemError` unless ``plan`` has the format of a plan file."""
    if not isinstance(plan, dict) or plan.get("format") != FORMAT:
        raise ProblemError(f"{label} is no plan: its 'format' must be '{FORMAT}'")
    version = plan.get("version")
    if version != VERSION or isinstance(version, bool):
        raise ProblemError(
            f"{label} has version {short(plan.get('version'))}; only {VERSION} is known"
        )
    check_shape(plan, label)
    _check_references(plan, label)


def _check_references(plan: PlanDict, label: str) -> None:
    objects = {o["name"] for o in plan["objects"]}
    activities = {a["name"] for a in plan["activities"]}
    driven = {(m["activity"], m["object"]) for m in plan["motions"]}
    for ride in plan.get("rides", ()):
        if (ride["activity"], ride["carrier"]) not in driven:
            raise ProblemError(
                f"{label}: '{short(ride['object'])}' rides in '{short(ride['activity'])}' on "
                f"'{short(ride['carrier'])}', which does not drive in it"
            )
    count = max(1, len(plan.get("maps", ())))
    for entry in (*plan["objects"], *plan["motions"], *plan["changes"]):
        if not 0 <= entry.get("map", 0) < count:
            raise ProblemError(f"{label} has no map {entry['map']}: there are {count} (from 0)")
    for entry in (*plan["motions"], *plan["changes"], *plan.get("rides", ())):
        if entry["object"] not in objects:
            raise ProblemError(
                f"{label} moves '{short(entry['object'])}', which is no object of it"
            )
        if entry["activity"] not in activities:
            raise ProblemError(
                f"{label} moves '{short(entry['object'])}' in '{short(entry['activity'])}', "
                "which is no activity of it"
            )


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
    """Return where a plan (or a ``part``, one of its fields) breaks the schema first, in words."""
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
