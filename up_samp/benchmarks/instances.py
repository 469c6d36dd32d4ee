"""Instances by name: the paper's 132, the larger ones beyond them, and any other size and seed.

A name says everything: ``logistics-dc-all-r2-i4`` (door closed or ``do``, open; all sides or
``oc``, corridor only; robots; items), ``jobshop-r2-j2-m4`` (robots, jobs, machines),
``-s7`` at the end asks for seed 7: another instance of these sizes, with places, orders, durations,
walls and robots' shapes drawn anew.
``warehouse-r5-o10`` (robots, orders), ``warehouse-compact-r5-o10``: empty moves start at a fluent.
``navigation-r4``, ``kitting-r2-k2-p3-d2`` (robots, kits, parts, doors; ``-op``: with an operator)
and ``doors-r3-d2`` (robots, doors) are published beside the paper's families.
``building-rooms-r3-o8`` (or ``aisles``; robots, orders; ``-c2``: two orders carried at once) is
stated by ``Fleet``.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, cast, get_args

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import ProblemError

Build = Callable[..., SchedulingMotionProblem]
"""``build(encoding="fluents", metric=True)`` makes a fresh problem."""


Encoding = Literal[
    "fluents",
    "no-fluents",
    "fluents-uses",
    "no-fluents-uses",
    "fluents-sequential",
    "no-fluents-sequential",
]
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)
"""The forms in which the authors publish their problems (:mod:`up_samp.benchmarks.published`)."""


def check_encoding(encoding: str, known: Sequence[str] = ENCODINGS) -> None:
    """Raise :class:`ProblemError` where there is no such encoding."""
    if encoding not in known:
        raise ProblemError(f"encoding must be one of {tuple(known)}, not {encoding!r}")


@dataclass(frozen=True)
class Instance:
    """A named benchmark instance.

    ``group`` is the paper's column: ``OC-DO``, ``OC-DC``, ``ALL-DO``, ``ALL-DC``, ``JSP``; or
    the family's name.
    """

    name: str
    family: str
    group: str
    build: Build


_FORMS = {
    "logistics": (r"-d(?P<door>[co])-(?P<sides>all|oc)-r\d+-i\d+", "logistics", "logistics"),
    "jobshop": (r"-r\d+-j\d+-m\d+", "jobshop", "job_shop"),
    "navigation": (r"-r\d+", "navigation", "navigation"),
    "kitting": (r"-r\d+-k\d+-p\d+-d\d+(?P<operator>-op)?", "kitting", "kitting"),
    "warehouse": (r"-(?P<encoding>compact-)?r\d+-o\d+", "warehouse", "warehouse"),
    "doors": (r"-r\d+-d\d+", "door_sequence", "door_sequence"),
    "building": (r"-(?P<kind>rooms|aisles)-r\d+-o\d+(-c\d+)?", "building", "building"),
}
"""How the names of each family go on (sizes in the builder's order), and the module and function
that build it: imported when one is built.
"""


def instance(name: str) -> Instance:
    """Return the instance of that name; its sizes are checked when it is built.

    :raises ProblemError: if the name is none.
    """
    family = name.partition("-")[0]
    form, module, builder = _FORMS.get(family, ("(?!)", "", ""))  # what nothing is like
    found = re.fullmatch(rf"{re.escape(family)}{form}(-s(?P<seed>\d+))?", name)
    if found is None:
        raise ProblemError(f"there is no instance {name!r}; `instances(family)` lists them")
    told = {key: _MEANINGS.get(key, {}).get(word, word) for key, word in found.groupdict().items()}
    options = {**told, "seed": int(found["seed"] or 0)}
    sizes = [int(size) for size in re.findall(r"-[a-rt-z](\d+)", name)]

    def build(encoding: Encoding = "fluents", metric: bool = True) -> SchedulingMotionProblem:
        form: dict[str, Any] = {"encoding": encoding}
        if family in ("warehouse", "building"):
            check_encoding(encoding, ("fluents",))  # where robots are is always one here
            form = {}
        make = getattr(importlib.import_module(f"up_samp.benchmarks.builders.{module}"), builder)
        return cast(SchedulingMotionProblem, make(*sizes, metric=metric, **form, **options))

    groups = {"logistics": f"{found[2]}-d{found[1]}".upper(), "jobshop": "JSP"}
    return Instance(name, family, groups.get(family, family), build)


_MEANINGS: dict[str, dict[str | None, Any]] = {
    "door": {"c": "closed", "o": "open"},
    "sides": {"all": "all", "oc": "corridor"},
    "operator": {"-op": True, None: False},
    "encoding": {"compact-": "compact", None: "moves"},
}
"""What a name says beside sizes, as its builder takes it."""


_NAMES: dict[str, list[str]] = {
    "logistics": [
        f"logistics-d{door}-{sides}-r{r}-i{i}"
        for sides, door, r, i in product(("oc", "all"), ("o", "c"), (1, 2, 3), range(1, 9))
    ],
    "jobshop": [
        f"jobshop-r{r}-j{j}-m{m}" for m, r, j in product((1, 2, 4, 6), (1, 2, 3), (1, 2, 3))
    ],
    "logistics-large": [
        f"logistics-dc-all-r{r}-i{i}" for r, i in product(range(4, 11), (8, 12, 16))
    ],
    "jobshop-large": [
        *("jobshop-r3-j4-m4", "jobshop-r3-j6-m4", "jobshop-r4-j4-m4"),
        *("jobshop-r4-j4-m6", "jobshop-r4-j6-m6", "jobshop-r5-j6-m6"),
    ],
    "navigation": [f"navigation-r{r}" for r in range(2, 11)],
    "kitting": [
        *("kitting-r1-k1-p2-d2", "kitting-r2-k1-p3-d2", "kitting-r2-k2-p2-d2"),
        *("kitting-r2-k2-p3-d2", "kitting-r2-k2-p4-d4", "kitting-r3-k3-p3-d4"),
    ],
    "doors": [f"doors-r{r}-d{d}" for d, r in product((1, 2, 3), (1, 2, 3))],
    "building": [
        f"building-{kind}-{sizes}{loads}"
        for kind, loads, sizes in product(
            ("rooms", "aisles"), ("", "-c2"), ("r1-o4", "r2-o6", "r3-o8", "r3-o12", "r5-o20")
        )
    ],
    "warehouse": [
        *("warehouse-r2-o3", "warehouse-r3-o5", "warehouse-r5-o10", "warehouse-r10-o30"),
        *("warehouse-r20-o60", "warehouse-r50-o150", "warehouse-r50-o200"),
    ],
}
"""The instances of each family, smallest settings first."""


def families() -> tuple[str, ...]:
    """Return the names of the families (``paper`` is ``logistics`` and ``jobshop``)."""
    return tuple(_NAMES)


def instances(family: str) -> list[Instance]:
    """Return the instances of a family, smallest settings first.

    ``logistics`` and ``jobshop`` are the paper's 96 and 36; ``paper`` is both.

    :raises ProblemError: for an unknown family.
    """
    if family == "paper":
        return [*instances("logistics"), *instances("jobshop")]
    if family not in _NAMES:
        known = ", ".join(("paper", *_NAMES))
        raise ProblemError(f"there is no family {family!r}; there are {known}")
    return [*map(instance, _NAMES[family])]
