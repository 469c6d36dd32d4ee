"""Set a search up for a UP problem and run it: the entry from the engines."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Schedule

from up_samp.geometry import OccupancyGrid, lay_out
from up_samp.model import Body, Configuration, Deadline, PathReport, Placed, ProblemError, Refusal
from up_samp.model.snapshot import Snapshot
from up_samp.motion import MotionCache, MotionService
from up_samp.scheduling import Scheduler, open_scheduler
from up_samp.search.conclusion import SearchResult
from up_samp.search.context import Context, Incumbent
from up_samp.search.loop import solve
from up_samp.search.params import Parameters
from up_samp.search.prepare import check_geometry
from up_samp.search.tidy import tidied
from up_samp.upio import (
    Relaxation,
    SampSchedule,
    build_plan,
    read_problem,
    relax,
    trajectory_key,
)

ScheduleCheck = Callable[[Any, Schedule], list[str]]
PlanCheck = Callable[[SampSchedule], list[Refusal]]


def open_search(
    problem: SchedulingMotionProblem,
    engine: Any,
    params: Parameters,
    engine_params: Mapping[str, Any],
    deadline: Deadline,
    *,
    check_schedule: ScheduleCheck,
    check_plan: PlanCheck,
    native: bool,
) -> Context:
    """Read the problem, check its geometry, relax it and open a scheduler on the relaxation.

    Raises :class:`ProblemError` where the problem is wrong, before any search.
    """
    snapshot, grid = lay_out(read_problem(problem, params.seconds_per_unit))
    service = open_service(snapshot, grid, params)
    check_geometry(snapshot, service)

    def relax_anew() -> Relaxation:
        return relax(problem, snapshot, hold_static=native)

    def scheduler_for(relaxation: Relaxation) -> Scheduler:
        return open_scheduler(
            engine,
            relaxation.problem,
            params=engine_params,
            seed=params.seed,
            check=check_schedule,
            environment=problem.environment,
        )

    def validate(incumbent: Incumbent) -> list[Refusal]:
        return check_plan(to_plan(problem, snapshot, incumbent))

    relaxation = relax_anew()
    return Context(
        snapshot=snapshot,
        relaxation=relaxation,
        service=service,
        scheduler=scheduler_for(relaxation),
        params=params,
        deadline=deadline,
        query_seconds=params.query_seconds,
        relax=relax_anew,
        open_scheduler=scheduler_for,
        native=native,
        validate=validate,
    )


class WithoutProofs(MotionService):
    """A motion service that tells nothing impossible before it has searched for it."""

    def certificate(
        self, body: Body, poses: Sequence[Configuration], obstacles: Sequence[Placed]
    ) -> PathReport | None:
        """Return None: there is no proof."""
        return None


def open_service(
    snapshot: Snapshot, grid: OccupancyGrid | None, params: Parameters
) -> MotionService:
    """Return the motion service for a problem's map."""
    if grid is None and snapshot.tasks:
        raise ProblemError(f"problem '{snapshot.name}' has motions but no occupancy map")
    kind = MotionService if params.certificates else WithoutProofs
    return kind(
        grid,
        planner=params.path_planner,
        margin=params.margin,
        seed=params.seed,
        cache=MotionCache(params.cache),
    )


def to_plan(
    problem: SchedulingMotionProblem, snapshot: Snapshot, incumbent: Incumbent
) -> SampSchedule:
    """Return the UP plan of an incumbent; trajectories are in the world frame there."""
    trajectories = dict(incumbent.trajectories)
    for task in snapshot.tasks if snapshot.to_world else ():
        key = trajectory_key(task)
        if key in trajectories:
            own = trajectories[key]
            trajectories[key] = replace(own, poses=snapshot.to_world[task.map].out(own.poses))
    return build_plan(problem, snapshot, incumbent.schedule, trajectories)


def run(context: Context, *, optimal: bool) -> Generator[Incumbent, None, SearchResult]:
    """Run the search, and leave out of its best plan what is needless; the scheduler is closed
    whatever happens.
    """
    try:
        result = yield from solve(context, optimal=optimal)
        if context.incumbent is not None and context.params.tidy:
            context.report("tidy", "leaving out motions that nothing needs")
            context.incumbent = tidied(context, context.incumbent) or context.incumbent
        return result
    finally:
        context.scheduler.close()
