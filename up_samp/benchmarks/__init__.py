"""Benchmark families of scheduling and motion planning, built through Unified Planning's API.

>>> from up_samp.benchmarks import logistics
>>> logistics(robots=2, items=4, door="closed").name
'logistics-dc-all-r2-i4'
"""

from up_samp.benchmarks.building import building
from up_samp.benchmarks.door_sequence import door_sequence
from up_samp.benchmarks.instances import Instance, families, instance, instances
from up_samp.benchmarks.jobshop import job_shop
from up_samp.benchmarks.kitting import kitting
from up_samp.benchmarks.logistics import logistics
from up_samp.benchmarks.navigation import navigation

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
