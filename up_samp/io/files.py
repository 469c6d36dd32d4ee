"""Read and write plan files (JSON)."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from up_samp.io.floors import map_entries
from up_samp.io.plan_dict import FORMAT, VERSION, PlanDict
from up_samp.io.shape import check_shape
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
    minor = plan.get("minor", 0)
    if not isinstance(minor, int) or isinstance(minor, bool) or minor < 0:
        raise ProblemError(f"{label}: 'minor' must be a whole number, not {short(minor)}")
    if not isinstance(plan.get("dependencies", {}), dict):
        raise ProblemError(
            f"{label}: 'dependencies' must be an object, not {short(plan['dependencies'])}"
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
