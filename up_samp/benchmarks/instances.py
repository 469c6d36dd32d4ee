"""The paper's 132 instances by name, and the larger ones beyond them."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.benchmarks import jobshop, logistics, transport
from up_samp.benchmarks.builder import Encoding
from up_samp.model import ProblemError

Build = Callable[..., SchedulingMotionProblem]
"""``build(encoding="fluents", metric=True)`` makes a fresh problem."""


@dataclass(frozen=True)
class Instance:
    """A named benchmark instance. ``group`` is the paper's column: OC-DO, ..., ALL-DC, JSP."""

    name: str
    family: str
    group: str
    build: Build


def _logistics(
    robots: int, items: int, door: logistics.DoorState, sides: logistics.Sides, family: str
) -> Instance:
    def build(encoding: Encoding = "fluents", metric: bool = True) -> SchedulingMotionProblem:
        return logistics.logistics(
            robots, items, door=door, sides=sides, encoding=encoding, metric=metric
        )

    group = f"{'ALL' if sides == 'all' else 'OC'}-D{door[0].upper()}"
    return Instance(logistics.instance_name(robots, items, door, sides), family, group, build)


def _job_shop(robots: int, jobs: int, machines: int, family: str) -> Instance:
    def build(encoding: Encoding = "fluents", metric: bool = True) -> SchedulingMotionProblem:
        return jobshop.job_shop(robots, jobs, machines, encoding=encoding, metric=metric)

    return Instance(jobshop.instance_name(robots, jobs, machines), family, "JSP", build)


def _paper_logistics() -> list[Instance]:
    settings: list[tuple[logistics.Sides, logistics.DoorState]] = [
        ("corridor", "open"),
        ("corridor", "closed"),
        ("all", "open"),
        ("all", "closed"),
    ]
    return [
        _logistics(robots, items, door, sides, "logistics")
        for (sides, door) in settings
        for robots in (1, 2, 3)
        for items in range(1, 9)
    ]


def _large_logistics() -> list[Instance]:
    return [
        _logistics(robots, items, "closed", "all", "logistics-large")
        for robots in range(4, 11)
        for items in (8, 12, 16)
    ]


def _paper_job_shops() -> list[Instance]:
    return [
        _job_shop(robots, jobs, machines, "jobshop")
        for machines in (1, 2, 4, 6)
        for robots in (1, 2, 3)
        for jobs in (1, 2, 3)
    ]


def _large_job_shops() -> list[Instance]:
    sizes = itertools.chain([(3, 4, 4), (3, 6, 4), (4, 4, 4)], [(4, 4, 6), (4, 6, 6), (5, 6, 6)])
    return [_job_shop(r, j, m, "jobshop-large") for r, j, m in sizes]


def _transport() -> list[Instance]:
    sizes = [*itertools.product((1, 2), (1, 2), (1, 2)), (2, 3, 2), (3, 3, 2), (2, 2, 4)]

    def sized(r: int, j: int, m: int) -> Instance:
        def build(encoding: Encoding = "fluents", metric: bool = True) -> SchedulingMotionProblem:
            return transport.transport(r, j, m, encoding=encoding, metric=metric)

        return Instance(transport.instance_name(r, j, m, "closed"), "transport", "transport", build)

    def classic(r: int) -> Instance:
        def build(encoding: Encoding = "fluents", metric: bool = True) -> SchedulingMotionProblem:
            return transport.transport(
                r, data="ft06", door="open", encoding=encoding, metric=metric
            )

        return Instance(f"transport-ft06-do-r{r}", "transport", "transport", build)

    return [sized(*size) for size in sizes] + [classic(r) for r in (2, 3)]


_FAMILIES: dict[str, Callable[[], list[Instance]]] = {
    "logistics": _paper_logistics,
    "jobshop": _paper_job_shops,
    "logistics-large": _large_logistics,
    "jobshop-large": _large_job_shops,
    "transport": _transport,
}


def families() -> tuple[str, ...]:
    """Return the names of the families."""
    return tuple(_FAMILIES)


@functools.cache
def _instances(family: str) -> tuple[Instance, ...]:
    return tuple(_FAMILIES[family]())


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


def instance(name: str) -> Instance:
    """Return the instance of that name.

    :raises ProblemError: if no family has it.
    """
    for family in _FAMILIES:
        for candidate in _instances(family):
            if candidate.name == name:
                return candidate
    raise ProblemError(f"there is no instance {name!r}; `instances(family)` lists them")
