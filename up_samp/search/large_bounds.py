"""The lower bound of a large problem, in the books of its search."""

from __future__ import annotations

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import OutOfTimeError
from up_samp.model.deadline import in_force
from up_samp.search.drives import Drives
from up_samp.search.jobs import Jobs
from up_samp.search.jobs_bound import JobsBound
from up_samp.search.search import Search


def state_bounds(
    search: Search, problem: SchedulingMotionProblem, jobs: Jobs, *, relative: bool
) -> None:
    """Raise the lower bound to what the jobs take at least, as far as there is time.

    :param relative: also by the planner's own durations, where that gives more.
    """
    bounds, tuning, service = search.bounds, search.tuning.large, search.motions.service
    try:
        deadline = search.budget.share(tuning.bounding, float("inf"))
        with in_force(deadline):
            bound = JobsBound(problem, search.facts, service, jobs)
            bounds.beside = max(bounds.beside, bound.absolute(deadline))
            bounds.raise_lower(bounds.beside, relative=False)
            if not relative:
                return
            with search.budget.motion_time():
                drives = Drives(service)
                for units in bound.relative(drives, tuning.drives, deadline):
                    bounds.beside = max(bounds.beside, units)
                    bounds.raise_lower(units, relative=True)
    except OutOfTimeError:
        return  # what was found holds
