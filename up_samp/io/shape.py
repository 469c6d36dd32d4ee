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


def text(value: Any) -> str | None:
    """Check a name or another short text."""
    if not isinstance(value, str):
        return "a text"
    return (
        None if len(value) <= PRECISION.name else f"a text of at most {PRECISION.name} characters"
    )


def number(value: Any) -> str | None:
    """Check a finite number of a size that makes sense."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "a number"
    # comparing works for whole numbers of any size, converting does not
    return (
        None
        if -PRECISION.largest <= value <= PRECISION.largest
        else f"a number between -{PRECISION.largest:g} and {PRECISION.largest:g}"
    )


def truth(value: Any) -> str | None:
    """Check a truth value."""
    return None if isinstance(value, bool) else "true or false"


def positive(value: Any) -> str | None:
    """Check a number above zero."""
    return number(value) or (None if value > 0 else "a number above 0")


def distance(value: Any) -> str | None:
    """Check a number from zero."""
    return number(value) or (None if value >= 0 else "a number from 0")


def plain(value: Any) -> str | None:
    """Check a parameter's value."""
    if isinstance(value, bool):
        return None
    return None if number(value) is None or text(value) is None else "a truth value, number or name"


def optional(check: Check) -> Check:
    """Return a check that lets ``null`` pass."""

    def checked(value: Any) -> str | None:
        wanted = None if value is None else check(value)
        return wanted and f"{wanted} or null"

    return checked


def numbers(*lengths: int) -> Check:
    """Return a check for a list of numbers, of one of these lengths."""

    def checked(value: Any) -> str | None:
        wanted = f"a list of {' or '.join(map(str, lengths))} numbers"
        if not isinstance(value, list) or len(value) not in lengths:
            return wanted
        return wanted if any(number(v) for v in value) else None

    return checked


def corners(value: Any) -> str | None:
    """Check a footprint; an object with a mesh may have none."""
    pair = numbers(2)
    good = isinstance(value, list) and not any(pair(c) for c in value)
    return None if good and len(value) != 1 and len(value) != 2 else "a list of corners [x, y]"


def values(value: Any) -> str | None:
    """Check parameters by name."""
    good = isinstance(value, dict) and not any(text(k) or plain(v) for k, v in value.items())
    return None if good else "an object of names and plain values"


def index(value: Any) -> str | None:
    """Check the number of a map."""
    good = isinstance(value, int) and not isinstance(value, bool) and value >= 0
    return None if good else "a whole number from 0"


def model(value: Any) -> str | None:
    """Check a motion model's name."""
    names = [m.value for m in MotionModel]
    return None if isinstance(value, str) and value in names else f"one of {', '.join(names)}"


def table(value: Any) -> str | None:
    """Check an object."""
    return None if isinstance(value, dict) else "an object"


def several(value: Any) -> str | None:
    """Check a list."""
    return None if isinstance(value, list) else "a list"


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
        "initial": optional(numbers(3, 7)),
    },
    "activities": {"name": text, "start": number, "end": number},
    "motions": {"activity": text, "object": text, "samples": lambda v: None},
    "changes": {
        "activity": text,
        "object": text,
        "time": number,
        "configuration": numbers(3, 7),
    },
    "rides": {"activity": text, "object": text, "carrier": text, "offset": numbers(3)},
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
    "maps": {"frame": numbers(3), "height": number},
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
