"""Check that a plan dictionary has the types and sizes that docs/plan-format.md gives it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any

from up_samp.io.precision import PRECISION
from up_samp.model import MotionModel, ProblemError
from up_samp.model.errors import short

Check = Callable[[Any], str | None]
"""Returns what a value should be, if it is not that."""


def _is_number(value: Any) -> bool:
    # comparing works for whole numbers of any size, converting does not
    real = isinstance(value, int | float) and not isinstance(value, bool)
    return real and -PRECISION.largest <= value <= PRECISION.largest


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= PRECISION.name


def _is_numbers(value: Any, *lengths: int) -> bool:
    return isinstance(value, list) and len(value) in lengths and all(map(_is_number, value))


def _is_plain(value: Any) -> bool:
    return isinstance(value, bool) or _is_number(value) or _is_text(value)


def _check(good: Callable[[Any], bool], wanted: str) -> Check:
    return lambda value: None if good(value) else wanted


def optional(check: Check) -> Check:
    """Return a check that lets ``null`` pass."""

    def checked(value: Any) -> str | None:
        wanted = None if value is None else check(value)
        return wanted and f"{wanted} or null"

    return checked


_MODELS = [m.value for m in MotionModel]
text = _check(_is_text, f"a text of at most {PRECISION.name} characters")
number = _check(_is_number, f"a number between -{PRECISION.largest:g} and {PRECISION.largest:g}")
positive = _check(lambda v: _is_number(v) and v > 0, "a number above 0")
distance = _check(lambda v: _is_number(v) and v >= 0, "a number from 0")
truth = _check(lambda v: isinstance(v, bool), "true or false")
table = _check(lambda v: isinstance(v, dict), "an object")
several = _check(lambda v: isinstance(v, list), "a list")
offset = _check(lambda v: _is_numbers(v, 3), "a list of 3 numbers")
pose = _check(lambda v: _is_numbers(v, 3, 7), "a list of 3 or 7 numbers")
index = _check(lambda v: type(v) is int and v >= 0, "a whole number from 0")
model = _check(lambda v: v in _MODELS, f"one of {', '.join(_MODELS)}")
corners = _check(  # none, for an object with a mesh
    lambda v: isinstance(v, list) and len(v) not in (1, 2) and all(_is_numbers(c, 2) for c in v),
    "a list of corners [x, y]",
)
values = _check(
    lambda v: isinstance(v, dict) and all(_is_text(k) and _is_plain(x) for k, x in v.items()),
    "an object of names and plain values",
)

PLAN: Mapping[str, Check] = {
    "problem": text,
    "engine": text,
    "status": text,
    "makespan": number,
    "lower_bound": optional(number),
    "seconds_per_unit": positive,
    "map": table,
    "objects": several,
    "activities": several,
    "motions": several,
    "changes": several,
}
OPEN: Mapping[str, Check] = {
    "parameters": values,
    "margin": distance,
    "rides": several,
    "maps": several,
}
"""Fields that a plan need not have."""
ENTRIES: Mapping[str, Mapping[str, Check]] = {
    "objects": {
        "name": text,
        "type": text,
        "footprint": corners,
        "model": model,
        "initial": optional(pose),
    },
    "activities": {"name": text, "start": number, "end": number},
    "motions": {"activity": text, "object": text, "samples": lambda v: None},
    "changes": {
        "activity": text,
        "object": text,
        "time": number,
        "configuration": pose,
    },
    "rides": {"activity": text, "object": text, "carrier": text, "offset": offset},
    "maps": {"yaml": text},
}
MAYBE: Mapping[str, Mapping[str, Check]] = {
    "objects": {
        "turning_radius": number,
        "v_max": number,
        "a_max": number,
        "omega_max": number,
        "reverse": truth,
        "height": positive,
        "mesh": optional(text),
        "map": index,
    },
    "activities": {"parameters": values},
    "motions": {"map": index},
    "changes": {"map": index},
    "rides": {},
    "maps": {"frame": offset, "height": number},
}
"""Fields that an entry need not have."""


def check_shape(plan: Mapping[str, Any], label: str) -> None:
    """Raise :class:`ProblemError` that names the first field that is missing or of a wrong type."""
    for key, check in PLAN.items():
        _need(plan, key, check, label, "")
    for key, check in (("yaml", optional(text)), *MAYBE["maps"].items()):
        _maybe(plan["map"], key, check, label, "'map'")
    for key, check in OPEN.items():
        _maybe(plan, key, check, label, "")
    for key, checks in ENTRIES.items():
        for i, entry in enumerate(plan.get(key, ())):
            where = f"entry {i} of '{key}'"
            if not isinstance(entry, dict):
                _refuse(label, where, "an object", entry)
            for field, check in checks.items():
                _need(entry, field, check, label, where)
            for field, check in MAYBE[key].items():
                _maybe(entry, field, check, label, where)
    for motion in plan["motions"]:
        _check_samples(motion, label)


def _need(entry: Mapping[str, Any], key: str, check: Check, label: str, where: str) -> None:
    if key not in entry:
        raise ProblemError(f"{label}{where and ': '}{where} lacks '{key}'")
    _maybe(entry, key, check, label, where)


def _maybe(entry: Mapping[str, Any], key: str, check: Check, label: str, where: str) -> None:
    if key not in entry:
        return
    wanted = check(entry[key])
    if wanted is not None:
        _refuse(label, f"'{key}'{where and ' of '}{where}", wanted, entry[key])


def _refuse(label: str, field: str, wanted: str, value: Any) -> None:
    said = repr(short(value)) if isinstance(value, str) else short(value)
    raise ProblemError(f"{label}: {field} cannot be {said}: it must be {wanted}")


def _check_samples(motion: Mapping[str, Any], label: str) -> None:
    rows = motion["samples"]
    who, what = short(motion["object"]), short(motion["activity"])
    where = f"{label}: the samples of '{who}' in activity '{what}'"
    good = isinstance(rows, list) and rows and all(isinstance(r, list) for r in rows)
    if not good or len({len(r) for r in rows}) != 1 or len(rows[0]) not in (4, 8):
        raise ProblemError(f"{where} must be rows [t, x, y, theta]")
    wrong = next((v for r in rows for v in r if number(v)), None)
    if wrong is not None or any(v is None for r in rows for v in r):
        raise ProblemError(
            f"{where} must be finite numbers up to {PRECISION.largest:g}, not {short(wrong)}"
        )
    late = next((a[0] for a, b in itertools.pairwise(rows) if b[0] <= a[0]), None)
    if late is not None:
        raise ProblemError(f"{where} must have increasing times, not as after {late:g} s")
