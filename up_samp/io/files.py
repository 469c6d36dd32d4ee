"""Read and write plan files (JSON)."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from up_samp.io.plan_dict import FORMAT, VERSION, PlanDict
from up_samp.model import ProblemError

_KEYS: Mapping[str, type | tuple[type, ...]] = {
    "problem": str,
    "engine": str,
    "status": str,
    "makespan": (int, float),
    "lower_bound": (int, float, type(None)),
    "seconds_per_unit": (int, float),
    "map": dict,
    "objects": list,
    "activities": list,
    "motions": list,
    "changes": list,
}
_ENTRY_KEYS: Mapping[str, tuple[str, ...]] = {
    "objects": ("name", "type", "footprint", "model", "initial"),
    "activities": ("name", "start", "end"),
    "motions": ("activity", "object", "samples"),
    "changes": ("activity", "object", "time", "configuration"),
}


def write_plan(path: str | os.PathLike[str], plan: PlanDict) -> Path:
    """Write a plan dictionary to a file, one entry a line; equal plans give equal files."""
    check_plan(plan, "the plan")
    target = Path(path)
    target.write_text(dump_plan(plan), encoding="utf-8")
    return target


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
        plan = json.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise ProblemError(f"plan file '{source}' cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ProblemError(f"plan file '{source}' is not JSON: {error}") from error
    check_plan(plan, f"plan file '{source}'")
    yaml = plan["map"].get("yaml")
    if yaml is not None and not os.path.isabs(yaml):
        plan["map"]["yaml"] = str((source.parent / yaml).resolve())
    return dict(plan)


def check_plan(plan: Any, label: str) -> None:
    """Raise :class:`ProblemError` unless ``plan`` has the format of a plan file."""
    if not isinstance(plan, dict) or plan.get("format") != FORMAT:
        raise ProblemError(f"{label} is no plan: its 'format' must be '{FORMAT}'")
    if plan.get("version") != VERSION:
        raise ProblemError(f"{label} has version {plan.get('version')}; only {VERSION} is known")
    minor = plan.get("minor", 0)
    if not isinstance(minor, int) or isinstance(minor, bool) or minor < 0:
        raise ProblemError(f"{label}: 'minor' must be a whole number, not {minor!r}")
    if not isinstance(plan.get("dependencies", {}), dict):
        raise ProblemError(f"{label}: 'dependencies' cannot be {plan['dependencies']!r}")
    for key, kind in _KEYS.items():
        if key not in plan:
            raise ProblemError(f"{label} lacks '{key}'")
        if not isinstance(plan[key], kind):
            raise ProblemError(f"{label}: '{key}' cannot be {plan[key]!r}")
    for key, needed in _ENTRY_KEYS.items():
        for i, entry in enumerate(plan[key]):
            missing = [k for k in needed if not isinstance(entry, dict) or k not in entry]
            if missing:
                raise ProblemError(f"{label}: entry {i} of '{key}' lacks '{missing[0]}'")
    _check_references(plan, label)
    for motion in plan["motions"]:
        _check_samples(motion, label)


def _check_references(plan: PlanDict, label: str) -> None:
    objects = {o["name"] for o in plan["objects"]}
    activities = {a["name"] for a in plan["activities"]}
    for entry in (*plan["motions"], *plan["changes"]):
        if entry["object"] not in objects:
            raise ProblemError(f"{label} moves '{entry['object']}', which is no object of it")
        if entry["activity"] not in activities:
            raise ProblemError(
                f"{label} moves '{entry['object']}' in '{entry['activity']}', "
                "which is no activity of it"
            )


def _check_samples(motion: dict[str, Any], label: str) -> None:
    rows = motion["samples"]
    where = f"{label}: the samples of '{motion['activity']}'"
    good = isinstance(rows, list) and rows and all(isinstance(r, list) for r in rows)
    if not good or len({len(r) for r in rows}) != 1 or len(rows[0]) not in (4, 8):
        raise ProblemError(f"{where} must be rows [t, x, y, theta]")
    if not all(isinstance(v, int | float) and math.isfinite(v) for r in rows for v in r):
        raise ProblemError(f"{where} must be finite numbers")
    if any(b[0] <= a[0] for a, b in itertools.pairwise(rows)):
        raise ProblemError(f"{where} must have increasing times")
