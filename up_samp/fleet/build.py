"""Write the records of a fleet problem as an ordinary UP problem, in the form that is solved best.

- Each robot has a fluent for its place. Moves need it at their start and set it at their end; what
  is done at places needs it over ``(start, end]``, so that it may begin as a move ends.
- What one robot does takes the robot, a resource of one unit: linear in size, where pairs are not.
- Records say nothing in short here (:mod:`up_samp.fleet.spelled_out`).
- What can be done by several robots is one optional activity each, exactly one of them present.
"""

from __future__ import annotations

from pathlib import Path

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.shortcuts import MinimizeMakespan

from up_samp.fleet.drives import Drives
from up_samp.fleet.jobs import JobRules, add_loads
from up_samp.fleet.machines import add_buffers, add_setups
from up_samp.fleet.objective import add_objective
from up_samp.fleet.records import FleetRecords
from up_samp.fleet.site import Site
from up_samp.fleet.spelled_out import spelled_out
from up_samp.fleet.statements import Written, one_at_a_time
from up_samp.fleet.work import Work


def build_problem(records: FleetRecords, folder: Path) -> SchedulingMotionProblem:
    """Return the UP problem of ``records``, see :func:`write_problem`."""
    return write_problem(records, folder).problem


def write_problem(records: FleetRecords, folder: Path) -> Written:
    """Return the UP problem of ``records`` and what its activities stand for; their map is relative
    to ``folder``.

    :raises FleetError: where more robots start in a zone than it takes.
    :raises UnsupportedError: where something cannot be said to the engines.
    """
    records = spelled_out(records)
    site = Site(records, folder)
    work = Work(site)
    drives = Drives(site, work)
    for robot in records.robots:
        drives.add(robot)
        add_loads(site, work, robot)
    add_setups(site, work)
    add_buffers(site, work)
    JobRules(site, work).add()
    work.limit_shifts()
    for robot, activities in work.busy.items():
        one_at_a_time(site.problem, robot, activities)
    if records.weighed:
        add_objective(site, work)
    elif records.objective == "makespan":
        site.problem.add_quality_metric(MinimizeMakespan())
    return Written(site.problem, site.meanings)
