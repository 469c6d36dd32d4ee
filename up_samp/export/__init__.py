"""Plans in other people's formats: tables (CSV), VDA 5050 orders, ROS 2 messages (MCAP), Nav2 legs,
states of an Open-RMF fleet.

All of them are made from the plan dictionary (docs/plan-format.md) alone.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from os import PathLike
from pathlib import Path

from up_samp.execution.files import check_motions
from up_samp.io import PlanDict
from up_samp.model import ProblemError

FORMATS = {
    "csv": ("tables", "export"),
    "vda5050": ("vda5050", "export"),
    "vda5050-3": ("vda5050", "export_later"),
    "mcap": ("mcap_file", "export"),
    "nav2": ("nav2", "export"),
    "rmf": ("tables", "export_states"),
}
"""Formats, and the modules and functions ``(plan, folder) -> files`` that write them."""


def export_plan(plan: PlanDict, to: str, folder: str | PathLike[str]) -> list[Path]:
    """Write a plan in the format ``to`` (one of :data:`FORMATS`) into a folder; return the files.

    Tables and recordings are in the world frame, the others in that of the map's file.

    Raises :class:`ProblemError` for a format that is not known, and
    :class:`~up_samp.model.UnsupportedError` for what a format cannot say.
    """
    if to not in FORMATS:
        raise ProblemError(f"there is no format '{to}'; known are {', '.join(FORMATS)}")
    module, function = FORMATS[to]
    export: Callable[[PlanDict, Path], list[Path]]
    export = getattr(importlib.import_module(f"up_samp.export.{module}"), function)
    check_motions(plan)
    home = Path(folder)
    if home.exists() and not home.is_dir():
        raise ProblemError(f"'{home}' is a file; name a folder to write into")
    home.mkdir(parents=True, exist_ok=True)
    return export(plan, home)


__all__ = ["FORMATS", "export_plan"]
