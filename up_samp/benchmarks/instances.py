"""Instances by name: the paper's 132, the larger ones beyond them, and any other size and seed.

A name says everything: ``logistics-dc-all-r2-i4`` (door closed or ``do``, open; all sides or
``oc``, corridor only; robots; items), ``jobshop-r2-j2-m4`` (robots, jobs, machines),
``transport-dc-r2-j2-m2``, ``transport-ft06-do-r3``; ``-s7`` at the end asks for seed 7.
``warehouse-r5-o10`` (robots, orders), ``warehouse-compact-r5-o10``: empty moves start at a fluent.
``navigation-r4``, ``kitting-r2-k2-p3-d2`` (robots, kits, parts, doors; ``-op``: with an operator)
and ``doors-r3-d2`` (robots, doors) exist in published forms only: ``lean`` means ``fluents`` there.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.benchmarks import jobshop, logistics, transport
from up_samp.benchmarks.builder import Encoding, check_encoding
from up_samp.benchmarks.door_sequence import door_sequence
from up_samp.benchmarks.kitting import kitting
from up_samp.benchmarks.navigation import navigation
from up_samp.benchmarks.warehouse import WarehouseEncoding, warehouse
from up_samp.benchmarks.warehouse import instance_name as warehouse_name
from up_samp.model import ProblemError

Build = Callable[..., SchedulingMotionProblem]
"""``build(encoding="lean", metric=True)`` makes a fresh problem."""


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


_NAME = re.compile(
    r"(?:(?P<logistics>logistics)-d(?P<ldoor>[co])-(?P<sides>all|oc)-r(?P<lr>\d+)-i(?P<items>\d+)"
    r"|(?P<jobshop>jobshop)-r(?P<jr>\d+)-j(?P<jobs>\d+)-m(?P<machines>\d+)"
    r"|(?P<transport>transport)-(?:(?P<data>ft06)-)?d(?P<tdoor>[co])-r(?P<tr>\d+)"
    r"(?P<size>-j(?P<tjobs>\d+)-m(?P<tmachines>\d+))?"
    r"|(?P<navigation>navigation)-r(?P<nr>\d+)"
    r"|(?P<kitting>kitting)-r(?P<kr>\d+)-k(?P<kits>\d+)-p(?P<parts>\d+)-d(?P<kdoors>\d+)"
    r"(?P<operator>-op)?"
    r"|(?P<warehouse>warehouse)-(?P<compact>compact-)?r(?P<wr>\d+)-o(?P<orders>\d+)"
    r"|(?P<doors>doors)-r(?P<dr>\d+)-d(?P<ddoors>\d+))(?:-s(?P<seed>\d+))?"
)


def instance(name: str) -> Instance:
    """Return the instance of that name; its sizes are checked when it is built.

    :raises ProblemError: if the name is none.
    """
    found = _NAME.fullmatch(name)
    if found is None or (found["transport"] and bool(found["data"]) == bool(found["size"])):
        raise ProblemError(f"there is no instance {name!r}; `instances(family)` lists them")
    seed = int(found["seed"] or 0)
    if found["logistics"]:
        return _logistics(found, name, seed)
    if found["navigation"] or found["kitting"] or found["doors"]:
        return _published_only(found, name, seed)
    if found["warehouse"]:
        return _warehouse(found, name, seed)
    return _job_shop(found, name, seed) if found["jobshop"] else _transport(found, name, seed)


def _logistics(found: re.Match[str], name: str, seed: int) -> Instance:
    robots, items = int(found["lr"]), int(found["items"])
    door: logistics.DoorState = "closed" if found["ldoor"] == "c" else "open"
    sides: logistics.Sides = "all" if found["sides"] == "all" else "corridor"

    def build(encoding: Encoding = "lean", metric: bool = True) -> SchedulingMotionProblem:
        return logistics.logistics(
            robots,
            items,
            door=door,
            sides=sides,
            encoding=encoding,
            metric=metric,
            seed=seed,
            name=name,
        )

    group = f"{found['sides'].upper()}-D{found['ldoor'].upper()}"
    return Instance(name, "logistics", group, build)


def _job_shop(found: re.Match[str], name: str, seed: int) -> Instance:
    size = int(found["jr"]), int(found["jobs"]), int(found["machines"])

    def build(encoding: Encoding = "lean", metric: bool = True) -> SchedulingMotionProblem:
        return jobshop.job_shop(*size, encoding=encoding, metric=metric, seed=seed, name=name)

    return Instance(name, "jobshop", "JSP", build)


def _transport(found: re.Match[str], name: str, seed: int) -> Instance:
    size = int(found["tr"]), int(found["tjobs"] or 0), int(found["tmachines"] or 0)
    door: logistics.DoorState = "closed" if found["tdoor"] == "c" else "open"

    def build(encoding: Encoding = "lean", metric: bool = True) -> SchedulingMotionProblem:
        return transport.transport(
            *size,
            data=found["data"],
            door=door,
            encoding=encoding,
            metric=metric,
            seed=seed,
            name=name,
        )

    return Instance(name, "transport", "transport", build)


def _warehouse(found: re.Match[str], name: str, seed: int) -> Instance:
    size = int(found["wr"]), int(found["orders"])
    form: WarehouseEncoding = "compact" if found["compact"] else "moves"

    def build(encoding: Encoding = "lean", metric: bool = True) -> SchedulingMotionProblem:
        # where robots are is always a fluent here
        check_encoding(encoding, ("lean",))
        return warehouse(*size, encoding=form, metric=metric, seed=seed, name=name)

    return Instance(name, "warehouse", "warehouse", build)


def _published_only(found: re.Match[str], name: str, seed: int) -> Instance:
    """Return an instance of a family that is published beside the paper's."""
    make: Build
    if found["navigation"]:
        family, make = "navigation", functools.partial(navigation, int(found["nr"]))
    elif found["kitting"]:
        size = [int(found[key]) for key in ("kr", "kits", "parts", "kdoors")]
        family = "kitting"
        make = functools.partial(kitting, *size, operator=bool(found["operator"]))
    else:
        size = [int(found["dr"]), int(found["ddoors"])]
        family, make = "doors", functools.partial(door_sequence, *size, seed=seed)
    if seed and family != "doors":
        raise ProblemError(f"instance {name!r}: the family {family} has no seeds")

    def build(encoding: Encoding = "fluents", metric: bool = True) -> SchedulingMotionProblem:
        check_encoding(encoding)
        form = "fluents" if encoding == "lean" else encoding.removeprefix("lean-")
        return make(encoding=form, metric=metric, name=name)

    return Instance(name, family, family, build)


def _paper_logistics() -> list[str]:
    settings: list[tuple[logistics.Sides, logistics.DoorState]] = [
        ("corridor", "open"),
        ("corridor", "closed"),
        ("all", "open"),
        ("all", "closed"),
    ]
    return [
        logistics.instance_name(robots, items, door, sides)
        for sides, door in settings
        for robots in (1, 2, 3)
        for items in range(1, 9)
    ]


def _large_logistics() -> list[str]:
    sizes = itertools.product(range(4, 11), (8, 12, 16))
    return [logistics.instance_name(r, i, "closed", "all") for r, i in sizes]


def _paper_job_shops() -> list[str]:
    return [
        jobshop.instance_name(robots, jobs, machines)
        for machines in (1, 2, 4, 6)
        for robots in (1, 2, 3)
        for jobs in (1, 2, 3)
    ]


def _large_job_shops() -> list[str]:
    sizes = [(3, 4, 4), (3, 6, 4), (4, 4, 4), (4, 4, 6), (4, 6, 6), (5, 6, 6)]
    return [jobshop.instance_name(*size) for size in sizes]


def _transports() -> list[str]:
    sizes = [*itertools.product((1, 2), (1, 2), (1, 2)), (2, 3, 2), (3, 3, 2), (2, 2, 4)]
    names = [transport.instance_name(*size, "closed") for size in sizes]
    return [*names, "transport-ft06-do-r2", "transport-ft06-do-r3"]


def _navigations() -> list[str]:
    return [f"navigation-r{robots}" for robots in range(2, 11)]


def _kittings() -> list[str]:
    sizes = [(1, 1, 2, 2), (2, 1, 3, 2), (2, 2, 2, 2), (2, 2, 3, 2), (2, 2, 4, 4), (3, 3, 3, 4)]
    return [f"kitting-r{r}-k{k}-p{p}-d{d}" for r, k, p, d in sizes]


def _door_sequences() -> list[str]:
    return [f"doors-r{r}-d{d}" for d in (1, 2, 3) for r in (1, 2, 3)]


def _warehouses() -> list[str]:
    sizes = [(2, 3), (3, 5), (5, 10), (10, 30), (20, 60), (50, 150), (50, 200)]
    return [warehouse_name(*size) for size in sizes]


_FAMILIES: dict[str, Callable[[], list[str]]] = {
    "logistics": _paper_logistics,
    "jobshop": _paper_job_shops,
    "logistics-large": _large_logistics,
    "jobshop-large": _large_job_shops,
    "transport": _transports,
    "navigation": _navigations,
    "kitting": _kittings,
    "doors": _door_sequences,
    "warehouse": _warehouses,
}


def families() -> tuple[str, ...]:
    """Return the names of the families (``paper`` is ``logistics`` and ``jobshop``)."""
    return tuple(_FAMILIES)


@functools.cache
def _instances(family: str) -> tuple[Instance, ...]:
    return tuple(map(instance, _FAMILIES[family]()))


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
