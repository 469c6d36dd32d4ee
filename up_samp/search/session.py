"""Set a search up for a UP problem and run it: the entry from the engines."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Plan, Schedule
from unified_planning.shortcuts import MinimizeMakespan

from up_samp.geometry import OccupancyGrid, lay_out
from up_samp.model import (
    CandidateSchedule,
    Configuration,
    Deadline,
    Placed,
    ProblemError,
    Trajectory,
    Violation,
    avoids,
)
from up_samp.model.snapshot import Snapshot
from up_samp.motion import MotionService
from up_samp.scheduling import Scheduler, open_scheduler
from up_samp.search.budget import Budget, Restarts
from up_samp.search.check import Checker
from up_samp.search.conclusion import SearchResult
from up_samp.search.events import Observer, ProgressObserver, State, Telling, TraceObserver
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import earlier_jobs, find_jobs
from up_samp.search.fleet.solve import LargeProblem, OpenThin, solve_large
from up_samp.search.fleet_bound.bound import state_bounds
from up_samp.search.knowledge import READING, Bounds, History, Incumbent, Knowledge, Stages
from up_samp.search.loop import solve
from up_samp.search.params import Parameters
from up_samp.search.presets import components_of
from up_samp.search.proof import Prover
from up_samp.search.resolve import start_of
from up_samp.search.search import Problem, Search, Statement
from up_samp.search.world import Motions
from up_samp.tuning import Tuning, tuning_of
from up_samp.upio import Relaxation, SampSchedule, build_plan, read_problem, relax, trajectory_key
from up_samp.upio.objective import Number, measure_of, only_makespan


def check_start_poses(snapshot: Snapshot, service: MotionService) -> None:
    """Raise :class:`ProblemError` where a robot starts in a wall or in another object."""
    for name in sorted(snapshot.by_object):
        body = snapshot.objects[name].body
        pose = snapshot.configurations[snapshot.initial[name]]
        in_wall, _ = service.pose_blockers(body, pose, ())
        if in_wall:
            raise ProblemError(
                f"object '{name}' starts at '{snapshot.initial[name]}' {_show(pose)}, which is in "
                f"a wall or outside the map '{snapshot.map_file}'"
            )
        heeded = _heeded(snapshot, name)
        others = tuple(
            Placed(o, snapshot.objects[o].body, snapshot.configurations[place])
            for o, place in snapshot.initial.items()
            if o != name and avoids(heeded, o)
        )
        _, hit = service.pose_blockers(body, pose, others)
        if hit:
            raise ProblemError(
                f"object '{name}' overlaps '{min(hit)}' at the start; move one of them "
                f"('{name}' starts at '{snapshot.initial[name]}' {_show(pose)})"
            )


def _show(pose: Configuration) -> str:
    return "(" + ", ".join(f"{v:g}" for v in pose) + ")"


def _heeded(snapshot: Snapshot, name: str) -> frozenset[str] | None:
    """Return the obstacles that all motions of ``name`` heed (None: all objects)."""
    told = [t.avoid for t in snapshot.by_object[name] if t.avoid is not None]
    return frozenset.intersection(*told) if told else None


_TOUR_ROUNDS = 10
"""A task, of annealing over tours of what was dealt out."""
NEEDED = ("lower bounds on motions", "proofs of unreachability")
"""What is stated before a plan of a thinned problem is sought."""
ScheduleCheck = Callable[[Any, Schedule], list[str]]
PlanCheck = Callable[[SampSchedule], list[Violation]]


@dataclass(frozen=True)
class Wrapped:
    """The engine that schedules, with its parameters and the judges of its schedules (``check``)
    and of plans made of them (``judge``).

    ``native``: it is our own. ``worth`` is what the problem's metric makes of a schedule, asked
    where that is another one than the makespan.
    """

    engine: Any
    params: Mapping[str, Any]
    check: ScheduleCheck
    judge: PlanCheck
    native: bool
    worth: Callable[[CandidateSchedule], Number] = operator.attrgetter("makespan")


def open_search(
    problem: SchedulingMotionProblem,
    wrapped: Wrapped,
    params: Parameters,
    deadline: Deadline,
    *,
    start: Plan | None = None,
    service: MotionService | None = None,
) -> Search:
    """Read the problem, check its geometry, relax it and open a scheduler on the relaxation.

    ``start`` is a plan to begin from, it need not be one of this problem; ``service``: who plans
    its motions, if that is not to be a new one.

    Raises :class:`ProblemError` where the problem is wrong, before any search.
    """
    stages = Stages()
    with stages.of(READING):
        snapshot, grid = lay_out(read_problem(problem, params.seconds_per_unit))
        service = service or open_service(snapshot, grid, params)
        check_start_poses(snapshot, service)

    asked = problem_of(problem, snapshot, wrapped, params, tuning_of(params.tuning))
    with stages.of(READING):
        search = assemble(asked, service, params, deadline)
        whole = params.components is not None or not only_makespan(problem)
        if "incumbents" not in params.without and not whole and start is None:
            inner = partial(open_thin, wrapped, params, service)
            _look_for_jobs(search, problem, snapshot, inner)
    search.history.stages = stages
    search.start = None if start is None else start_of(problem, start)
    if "incumbents" not in params.without and start is None and snapshot.tasks:
        search.easier = easier_of(problem, wrapped, params)
    return search


def _look_for_jobs(
    search: Search, problem: SchedulingMotionProblem, snapshot: Snapshot, inner: OpenThin
) -> None:
    """Find the jobs that robots may share: of a large problem, for plans in parts; of others, for
    a bound before the search, if robots drive in the midst of a job. (Of single tasks the scheduler
    knows more.)
    """
    jobs = find_jobs(problem, snapshot)
    if jobs is None:
        return
    large = sum(a.optional for a in problem.activities) >= search.tuning.large
    driving = any(mode.legs for mode in itertools.chain(*jobs.options))
    # of a job shop's tasks most wait for what others do: who deals out knows too little of that
    if large and (driving or 2 * len(earlier_jobs(problem, jobs)) <= len(jobs.options)):
        in_parts = LargeProblem(problem, snapshot, jobs, inner, search.tuning)
        search.in_parts = partial(solve_large, in_parts)
    elif driving:

        def bound(search: Search) -> tuple[()]:
            state_bounds(search, problem, jobs, relative=False)
            return ()

        told = (*search.components.statements, Statement("bound from all jobs", bound))
        search.components = replace(search.components, statements=told)


def easier_of(
    problem: SchedulingMotionProblem, wrapped: Wrapped, params: Parameters
) -> Callable[[Search], Generator[Incumbent, None, Any]] | None:
    """Return what yields plans of the problem with nothing but the makespan, if something else
    counts: by the makespan a scheduler is led to plans sooner.
    """
    if only_makespan(problem) or any(m.is_minimize_action_costs() for m in problem.quality_metrics):
        return None  # UP cannot copy problems of action costs
    soon = problem.clone()
    soon.clear_quality_metrics()
    soon.add_quality_metric(MinimizeMakespan())
    mine = replace(params, progress=None, trace=None, observers=(), stop=None, runtime=math.inf)

    def plans(search: Search) -> Generator[Incumbent, None, Any]:
        deadline, service = (
            search.budget.part("plans by an easier objective"),
            search.motions.service,
        )
        # its plans are judged as plans of the whole problem
        unjudged = replace(wrapped, judge=lambda plan: [])
        other = open_search(soon, unjudged, mine, deadline, service=service)
        return run(other, optimal=True, patience=Parameters.patience)

    return plans


def problem_of(
    problem: SchedulingMotionProblem,
    snapshot: Snapshot,
    wrapped: Wrapped,
    params: Parameters,
    tuning: Tuning,
) -> Problem:
    """Return what a search asks of a problem; ``tuning``: of our own engine. It
    draws what another one is handed over, but where the preset asks nothing of ours.
    """
    given = {**({"tuning": tuning} if wrapped.native else {}), **wrapped.params}

    def scheduler_for(relaxation: Relaxation, attempt: int) -> Scheduler:
        seed = params.seed + attempt
        scheduler: Any = open_scheduler(
            wrapped.engine,
            relaxation.problem,
            params=given,
            seed=seed,
            check=wrapped.check,
            environment=problem.environment,
        )
        if wrapped.native:
            scheduler.soon = True  # better schedules are driven before more is proven of them
        if wrapped.native or "incumbents" in params.without:
            return scheduler
        from up_samp.scheduling.thinned import ThinnedScheduler  # and all compilers

        return ThinnedScheduler(scheduler, relaxation, seed=seed, tuning=tuning)

    build = partial(to_plan, problem, snapshot, params.margin)
    native = wrapped.native or "incumbents" not in params.without
    relaxed = partial(relax, problem, snapshot)
    measure = measure_of(problem, wrapped.worth)
    return Problem(relaxed, scheduler_for, build, wrapped.judge, native, measure)


def open_thin(
    wrapped: Wrapped,
    params: Parameters,
    service: MotionService,
    problem: SchedulingMotionProblem,
    deadline: Deadline,
) -> Search:
    """Return a search on a problem with few alternatives, for some plan soon: little is stated
    before, motions are decided one after the other, and nobody is told. The plan is not judged.
    """
    hasty = replace(tuning_of(params.tuning), tour_rounds=_TOUR_ROUNDS, labels=0)
    mine = replace(params, tuning=hasty, progress=None, trace=None, observers=())
    usual = components_of(mine, native=True)
    components = replace(
        usual,
        statements=tuple(s for s in usual.statements if s.name in NEEDED),
        shapers=(),
        builders=(),
    )
    snapshot, _ = lay_out(read_problem(problem, params.seconds_per_unit))

    unjudged = replace(wrapped, judge=lambda plan: [])
    asked = problem_of(problem, snapshot, unjudged, params, hasty)
    return assemble(asked, service, replace(mine, components=components), deadline)


def assemble(
    problem: Problem,
    service: MotionService,
    params: Parameters,
    deadline: Deadline,
) -> Search:
    """Return a search of the components that the parameters ask for."""
    deadline = replace(deadline, at=min(deadline.at, deadline.started + params.runtime))
    relaxation = problem.relax()
    components = components_of(params, native=problem.native)
    tuning = tuning_of(params.tuning)
    facts = Facts(relaxation.snapshot, relaxation.choices)
    history, bounds = History(), Bounds.by(problem.measure)
    knowledge = Knowledge(relaxation, history)
    budget = Budget(deadline, params.query_seconds, history=history)
    motions = Motions(facts, service, budget)
    tell = Telling(observers_of(params), partial(state_of, history, bounds, deadline))
    return Search(
        problem=problem,
        facts=facts,
        knowledge=knowledge,
        budget=budget,
        bounds=bounds,
        motions=motions,
        checker=Checker(
            motions,
            knowledge,
            components.cuts,
            components.layers,
            tell,
            thorough=bool(components.repairs),
            seed=params.seed,
        ),
        prover=Prover(problem.relax, budget, params.seed, tuning),
        scheduler=problem.schedule(relaxation, 0),
        components=components,
        restarts=Restarts(params.max_restarts),
        tell=tell,
        stop=params.stop,
        relative=params.relative,
        seed=params.seed,
        tuning=tuning,
    )


def observers_of(params: Parameters) -> tuple[Observer, ...]:
    """Return who is told what happens: those given, and the writers of progress and trace."""
    found = list(params.observers)
    if params.progress is not None:
        found.append(ProgressObserver(params.progress))
    if params.trace is not None:
        found.append(TraceObserver(params.trace))
    return tuple(found)


def state_of(history: History, bounds: Bounds, deadline: Deadline) -> State:
    """Return where a search is."""
    return State(
        rounds=len(history.rounds),
        restarts=history.restarts,
        lower_bound=bounds.told_lower(),
        upper_bound=bounds.upper,
        measure=bounds.measure,
        elapsed=deadline.elapsed(),
        last_plan_at=history.last_plan_at,
        last_plan_round=history.last_plan_round,
    )


def open_service(
    snapshot: Snapshot, grid: OccupancyGrid | None, params: Parameters
) -> MotionService:
    """Return the motion service for a problem's map."""
    if grid is None and snapshot.tasks:
        raise ProblemError(f"problem '{snapshot.name}' has motions but no occupancy map")
    return MotionService(
        grid,
        planner=params.path_planner,
        margin=params.margin,
        seed=params.seed,
        cache=params.cache,
        tuning=tuning_of(params.tuning),
        proofs="certificates" not in params.without,
    )


def to_plan(
    problem: SchedulingMotionProblem,
    snapshot: Snapshot,
    margin: float,
    schedule: CandidateSchedule,
    trajectories: Mapping[str, Trajectory],
) -> SampSchedule:
    """Return the UP plan of a schedule; trajectories are in the world frame there."""
    found = dict(trajectories)
    for task in snapshot.tasks if snapshot.to_world else ():
        key = trajectory_key(task.activity, task.index)
        if key in found:
            own = found[key]
            found[key] = replace(own, poses=snapshot.to_world[task.map].out(own.poses))
    return build_plan(problem, snapshot, schedule, found, margin)


def run(
    search: Search, *, optimal: bool, patience: float = math.inf
) -> Generator[Incumbent, None, SearchResult]:
    """Run the search, and leave out of its best plan what is needless; the scheduler is closed
    whatever happens. ``patience``: see :class:`Parameters`.
    """
    bounds = search.bounds
    search.budget.patience = patience
    try:
        if search.in_parts is None:
            result = yield from solve(search, optimal=optimal)
        else:
            result = yield from search.in_parts(search, optimal)
        # a large problem has too many motions for what is done about each of them in the end
        search.budget.end()
        for finish in search.components.finishers if search.in_parts is None else ():
            found = finish(search, bounds.incumbent) if bounds.incumbent is not None else None
            if found is not None and not search.judged(found.plan):
                bounds.incumbent = found
        return result
    finally:
        search.scheduler.close()
