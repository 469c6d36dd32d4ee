"""Parts from outside the package: by entry points, or registered while a program runs.

A package that is installed beside this one names its parts in its ``pyproject.toml``, as UP's
engines are found by their module::

    [project.entry-points."up_samp.improvers"]
    nearest = "my_package.moves:nearest"

A program adds one for itself by :func:`extend`; it does not reach child processes (plans are made
better in this one, so that is no matter there). The package's own parts are tables of its rooms
(docs/architecture.md, "Where to add"), which ask here for more.
"""

from __future__ import annotations

import functools
import importlib.metadata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from up_samp.model.errors import ProblemError

KINDS: Mapping[str, str] = {
    "constraints": "ScheduleModel -> forms, stated in CP-SAT models beside the problem's own",
    "cuts": "(Failure, activity) -> refinements, told after a group of motions failed",
    "importers": "an up_samp.fleet.importers.Importer",
    "improvers": "(Search, stuck) -> better plans made of the best one, asked in every round",
    "objectives": "an up_samp.model.MetricMeaning",
    "planners": "a factory (scene, seed) -> motion planner",
    "rules": "(problem, plan) -> violations, asked by the validator",
    "statements": "Search -> refinements, told before the first schedule",
}
"""What may be added: the entry-point group is ``up_samp.`` and the name."""

_registered: dict[str, dict[str, Any]] = {kind: {} for kind in KINDS}


@functools.cache
def _installed(kind: str) -> Mapping[str, Any]:
    """Return what packages that are installed name, read once in a process.

    :raises ProblemError: that names an entry point which cannot be loaded.
    """
    found = {}
    for entry in importlib.metadata.entry_points(group=f"up_samp.{kind}"):
        try:
            found[entry.name] = entry.load()
        except Exception as error:
            raise ProblemError(
                f"the entry point '{entry.name}' of up_samp.{kind}: {error}"
            ) from error
    return found


def parts(kind: str) -> dict[str, Any]:
    """Return the parts of a kind (one of :data:`KINDS`) that come from outside, by name."""
    return {**_installed(kind), **_registered[kind]}


def extend(kind: str, name: str, part: Any) -> None:
    """Add a part, until it is withdrawn.

    :raises ProblemError: for a kind that is not known, or a name that is taken.
    """
    if kind not in KINDS:
        raise ProblemError(f"there is no kind of parts '{kind}'; known are {', '.join(KINDS)}")
    if name in parts(kind):
        raise ProblemError(f"there is a part '{name}' among the {kind} already")
    _registered[kind][name] = part


def withdraw(kind: str, name: str) -> None:
    """Take a part away that was added by :func:`extend`."""
    del _registered[kind][name]


@contextmanager
def extended(kind: str, name: str, part: Any) -> Iterator[None]:
    """Have a part added for as long as this lasts."""
    extend(kind, name, part)
    try:
        yield
    finally:
        withdraw(kind, name)
