"""Benchmark families of scheduling and motion planning, built through Unified Planning's API.

>>> from up_samp.benchmarks import logistics
>>> logistics(robots=2, items=4, door="closed").name
'logistics-dc-all-r2-i4'
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from up_samp.benchmarks.instances import Instance, families, instance, instances

if TYPE_CHECKING:
    from up_samp.benchmarks.builders.building import building
    from up_samp.benchmarks.builders.door_sequence import door_sequence
    from up_samp.benchmarks.builders.jobshop import job_shop
    from up_samp.benchmarks.builders.kitting import kitting
    from up_samp.benchmarks.builders.logistics import logistics
    from up_samp.benchmarks.builders.navigation import navigation

__all__ = [
    "Instance",
    "building",
    "door_sequence",
    "families",
    "instance",
    "instances",
    "job_shop",
    "kitting",
    "logistics",
    "navigation",
]


def __getattr__(name: str) -> object:
    # who wants one family has no use for the others
    if name not in __all__:
        raise AttributeError(f"module 'up_samp.benchmarks' has no attribute '{name}'")
    module = "jobshop" if name == "job_shop" else name
    return getattr(importlib.import_module(f"up_samp.benchmarks.builders.{module}"), name)
