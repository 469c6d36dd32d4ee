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

import functools
import importlib
import itertools
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, cast

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.benchmarks.published import Encoding, check_encoding
from up_samp.model import ProblemError

Build = Callable[..., SchedulingMotionProblem]
"""``build(encoding="fluents", metric=True)`` makes a fresh problem."""


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
    form, module, builder = _FORMS.get(family, ("", "", ""))
    found = re.fullmatch(rf"{family}{form}(-s(?P<seed>\d+))?", name) if builder else None
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


def _listed(family: str) -> list[str]:
    """Return the names of a family's instances."""
    if family == "logistics":
        drawn = itertools.product(("oc", "all"), ("o", "c"), (1, 2, 3), range(1, 9))
        return [f"logistics-d{door}-{sides}-r{r}-i{i}" for sides, door, r, i in drawn]
    if family == "jobshop":
        sizes = itertools.product((1, 2, 4, 6), (1, 2, 3), (1, 2, 3))
        return [f"jobshop-r{r}-j{j}-m{m}" for m, r, j in sizes]
    return [form.format(*size) for form, sizes in _LISTS[family] for size in sizes]


_Sizes = Iterable[tuple[int, ...]]
_LISTS: dict[str, list[tuple[str, _Sizes]]] = {
    "logistics-large": [
        ("logistics-dc-all-r{}-i{}", [*itertools.product(range(4, 11), (8, 12, 16))])
    ],
    "jobshop-large": [
        (
            "jobshop-r{}-j{}-m{}",
            [(3, 4, 4), (3, 6, 4), (4, 4, 4), (4, 4, 6), (4, 6, 6), (5, 6, 6)],
        )
    ],
    "navigation": [("navigation-r{}", [(robots,) for robots in range(2, 11)])],
    "kitting": [
        (
            "kitting-r{}-k{}-p{}-d{}",
            [(1, 1, 2, 2), (2, 1, 3, 2), (2, 2, 2, 2), (2, 2, 3, 2), (2, 2, 4, 4), (3, 3, 3, 4)],
        )
    ],
    "doors": [("doors-r{1}-d{0}", [*itertools.product((1, 2, 3), (1, 2, 3))])],
    "building": [
        (f"building-{kind}-r{{}}-o{{}}{loads}", [(1, 4), (2, 6), (3, 8), (3, 12), (5, 20)])
        for kind, loads in itertools.product(("rooms", "aisles"), ("", "-c2"))
    ],
    "warehouse": [
        (
            "warehouse-r{}-o{}",
            [(2, 3), (3, 5), (5, 10), (10, 30), (20, 60), (50, 150), (50, 200)],
        )
    ],
}

_FAMILIES = ("logistics", "jobshop", *_LISTS)


def families() -> tuple[str, ...]:
    """Return the names of the families (``paper`` is ``logistics`` and ``jobshop``)."""
    return _FAMILIES


@functools.cache
def _instances(family: str) -> tuple[Instance, ...]:
    return tuple(map(instance, _listed(family)))


def instances(family: str) -> list[Instance]:
    """Return the instances of a family, smallest settings first.

    ``logistics`` and ``jobshop`` are the paper's 96 and 36; ``paper`` is both.

    :raises ProblemError: for an unknown family.
    """
    if family == "paper":
        return [*_instances("logistics"), *_instances("jobshop")]
    if family not in _FAMILIES:
        known = ", ".join(("paper", *_FAMILIES))
        raise ProblemError(f"there is no family {family!r}; there are {known}")
    return list(_instances(family))
